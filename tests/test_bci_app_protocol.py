"""Messages survive the wire to the bit, strangers are refused, and docs/protocol.md tells all of it."""

import json
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bci_app import protocol
from bci_app.protocol import AnyMessage, BadMessage, EpisodeEnd, MoveOnset, Verdict, decode, encode, marker_code

PAGE = (Path(__file__).parents[1] / "docs" / "protocol.md").read_text(encoding="utf-8")
floats = st.floats(allow_nan=False, allow_infinity=False)


@given(floats, floats, floats, st.integers(0, 10**6), st.integers(1, 60))
def test_floats_survive_to_the_bit(
    log_odds: float, evidence: float, first_time: float, episode: int, step: int
) -> None:
    verdict = Verdict(
        session="s",
        episode=episode,
        step=step,
        outcome="error",
        log_odds=log_odds,
        evidence=evidence,
        clock_offset=0.0,
        first_time=first_time,
    )
    again = decode(encode(verdict), "s")
    assert isinstance(again, Verdict)
    assert again == verdict
    assert (str(again.log_odds), str(again.evidence)) == (str(log_odds), str(evidence))  # tells -0.0 from 0.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("hello", "Invalid JSON"),
        (b"\xff\xfe\x00", "Invalid JSON"),
        (b'{"protocol": 5, "session": "\xff", "type": "Resume"}', "Invalid JSON"),
        ("[" * 100_000, "Invalid JSON"),
        ("{}", "type"),
        ('{"protocol": 6, "session": "s", "type": "Resume"}', "protocol"),
        ('{"protocol": 2, "session": "s", "type": "Resume", "extra": 1}', "extra"),
        ('{"protocol": 2, "session": "other", "type": "Resume"}', "session 'other'"),
        ('{"protocol": 2, "session": "s", "type": "Gossip"}', "type"),
        (
            '{"protocol": 2, "session": "s", "type": "Verdict", "episode": 0, "step": 1, "outcome": "error",'
            ' "clock_offset": NaN}',
            "clock_offset",
        ),
        (
            '{"protocol": 2, "session": "s", "type": "Verdict", "episode": 0, "step": 1, "outcome": "error",'
            ' "clock_offset": 0.0, "evidence": Infinity}',
            "evidence",
        ),
    ],
)
def test_what_is_no_message_of_this_session_is_refused(text: str | bytes, says: str) -> None:
    with pytest.raises(BadMessage) as error:
        decode(text, "s")
    assert says.lower() in str(error.value).lower()


def test_older_versions_are_read_and_the_newest_sent() -> None:
    """Calibrations recorded before verdicts had evidence can be fitted again."""
    message = {"protocol": 1, "session": "s", "type": "Verdict", "episode": 0, "step": 1, "outcome": "unjudged"}
    old = decode(json.dumps({**message, "clock_offset": 0.0}), "s")
    assert isinstance(old, Verdict)
    assert (old.protocol, old.evidence) == (1, None)
    assert json.loads(encode(protocol.Resume(session="s")))["protocol"] == protocol.PROTOCOL_VERSION == 5
    assert f"| `protocol` | integer | {protocol.PROTOCOL_VERSION}, the version of this page" in PAGE


@given(st.text())
def test_garbage_never_gets_through(text: str) -> None:
    with pytest.raises(BadMessage):
        decode(text, "s")


@pytest.mark.parametrize("model", get_args(AnyMessage))
def test_the_page_tells_every_message_and_field(model: type[protocol.Message]) -> None:
    assert f"`{model.__name__}`" in PAGE
    for field in set(model.model_fields) - {"protocol", "session", "type"}:
        assert f"`{field}`" in PAGE, f"{model.__name__}.{field} is missing from docs/protocol.md"


@pytest.mark.parametrize("spec", protocol.STREAMS)
def test_the_page_tells_every_stream(spec: protocol.StreamSpec) -> None:
    assert f"| `{spec.name}` | `{spec.kind}` |" in PAGE
    assert spec.source_id("SESSION") in PAGE


def test_markers_stand_for_messages_and_never_for_the_truth() -> None:
    move = MoveOnset(
        session="s", episode=0, step=1, action="west", position=(0, 0), sensed=(False, False, False, False, False)
    )
    assert marker_code(move) == 3
    assert marker_code(EpisodeEnd(session="s", episode=0, steps=3, reason="goal")) == 21
    truth = protocol.Truth(session="s", episode=0, step=1, error=True, distance=3)
    goal = protocol.EpisodeGoal(session="s", episode=0, goal=(1, 1), distance=3)
    assert marker_code(truth) is marker_code(goal) is None


def test_no_stimulus_message_can_carry_the_goal() -> None:
    told = {name for model in (protocol.EpisodeStart, MoveOnset, EpisodeEnd) for name in model.model_fields}
    assert not told & {"goal", "error", "distance"}
    assert "goal" in json.loads(encode(protocol.EpisodeGoal(session="s", episode=0, goal=(1, 1), distance=3)))
