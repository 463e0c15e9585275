"""What is heard becomes what is shown: figures as `bci_app.metrics` has them, and nothing that doesn't count."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app import metrics
from bci_app.config import Config
from bci_app.console.state import State
from bci_app.eeg import EegDescription
from bci_app.protocol import (
    Action,
    AnyMessage,
    Belief,
    BlockEnd,
    BlockStart,
    Command,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    LateFrame,
    Link,
    MoveOnset,
    Note,
    Pause,
    Resume,
    Screen,
    SessionEnd,
    SessionStart,
    Status,
    Truth,
    Verdict,
)
from bci_app.recording import Recording, Stamped
from bci_app.said import Memory, without_void

NOTHING = (False,) * 5
EEG = EegDescription("Amp", "amp", "host", ("Fz", "Cz", "Pz"), ("uV",) * 3, ("EEG",) * 3, 500.0)
STREAM = {"Truth": "bci-truth", "EpisodeGoal": "bci-truth", "Verdict": "bci-verdicts", "Electrodes": "bci-verdicts"}
STREAM |= {"Action": "bci-actions", "Belief": "bci-actions", "Command": "bci-session", "Link": "bci-session"}


def fresh(speed: float = 1.0) -> State:
    state = State("s", Config(), speed)
    for name in ("bci-stimulus", "bci-truth", "bci-verdicts", "bci-actions", "bci-session"):
        state.links.opened(name, 0.0, speaks=name != "bci-truth")
    return state


def tell(state: State, stamp: float, *messages: AnyMessage) -> dict[str, Any]:
    """Let messages be heard, and look; what is shown must be JSON."""
    for message in messages:
        state.take(STREAM.get(type(message).__name__, "bci-stimulus"), stamp, message, stamp)
    shown = state.snapshot(stamp, stamp)
    assert json.loads(json.dumps(shown)) is not None
    return shown


def opening(task: str = "online") -> SessionStart:
    counts = {"n_episodes": 4} if task == "online" else {"n_blocks": 2, "n_moves": 8}
    return SessionStart.model_validate(
        {"session": "s", "task": task, "participant": "P", "map": "open", "layout": ["...."] * 4, **counts}
    )


def start(episode: int) -> EpisodeStart:
    return EpisodeStart(session="s", episode=episode, position=(0, 0), sensed=NOTHING, max_steps=60)


def goal(episode: int) -> EpisodeGoal:
    return EpisodeGoal(session="s", episode=episode, goal=(3, 3), distance=6)


def move(episode: int, step: int) -> MoveOnset:
    return MoveOnset(session="s", episode=episode, step=step, action="east", position=(0, step % 4), sensed=NOTHING)


def truth(episode: int, step: int, error: bool) -> Truth:
    return Truth(session="s", episode=episode, step=step, error=error, distance=3)


def verdict(episode: int, step: int, outcome: str, latency: float = 1.0) -> Verdict:
    fields = {"episode": episode, "step": step, "outcome": outcome, "latency_ms": latency, "clock_offset": 0.0}
    return Verdict.model_validate({"session": "s", **fields})


def chosen(episode: int, step: int) -> Action:
    fields = {"episode": episode, "step": step, "action": "east", "probabilities": (0, 0, 0, 1), "verdict": "error"}
    return Action.model_validate({"session": "s", **fields})


def end(episode: int, steps: int, reason: str = "goal") -> EpisodeEnd:
    return EpisodeEnd.model_validate({"session": "s", "episode": episode, "steps": steps, "reason": reason})


def status(role: str, state: str = "running") -> Status:
    return Status.model_validate({"session": "s", "role": role, "state": state})


OUTCOMES = st.sampled_from(["error", "correct", "rejected", "unjudged"])
MOVE = st.tuples(st.booleans(), OUTCOMES, st.floats(0.1, 9.0), st.floats(0.001, 0.1), st.booleans())


@given(
    st.lists(st.lists(MOVE, min_size=1, max_size=6), min_size=1, max_size=4), st.sampled_from([1.0, 20.0]), st.data()
)
@settings(max_examples=40, deadline=None)
def test_figures_are_those_of_the_recording(episodes: list[list[Any]], speed: float, data: st.DataObject) -> None:
    """Whatever was judged how, also where the stimulus was started again and a move made void."""
    said: list[Stamped] = [Stamped(0.0, opening())]
    now = 1.0
    for number, moves in enumerate(episodes):
        said += [Stamped(now, start(number)), Stamped(now, goal(number))]
        for step, (error, outcome, latency, after, is_twice) in enumerate(moves, start=1):
            now += 3.0
            said += [Stamped(now, truth(number, step, error)), Stamped(now, move(number, step))]
            said.append(Stamped(now + 0.6, verdict(number, step, outcome, latency)))
            if is_twice:
                said.append(Stamped(now + 0.61, verdict(number, step, "error", 50.0)))
            said.append(Stamped(now + 0.6 + after, chosen(number, step + 1)))
        if data.draw(st.booleans()):
            kept = data.draw(st.integers(0, len(moves)))
            said.append(Stamped(now + 1.5, Continued(session="s", episode=number, step=kept)))
        now += 2.0
        said.append(Stamped(now, end(number, len(moves), data.draw(st.sampled_from(["goal", "limit", "block"])))))
    state = fresh(speed)
    for item in said:
        tell(state, item.stamp, item.message)  # type: ignore[arg-type]
    messages = tuple(without_void(said, lambda item: item.message))
    recording = Recording(Path("x.xdf"), EEG, np.empty((0, 3)), np.empty(0), messages, ())
    shown, figures = state.snapshot(now, now), metrics.online([recording])
    assert shown["verdicts"]["accuracy"] == figures["verdict_accuracy"]
    assert shown["verdicts"]["balanced_accuracy"] == figures["verdict_balanced_accuracy"]
    assert shown["episodes"]["success"] == figures["success"]
    assert shown["episodes"]["mean_steps"] == figures["mean_steps"]
    assert shown["progress"]["moves"] <= figures["n_moves"] + sum(map(len, episodes))
    found = metrics.latencies([recording], speed)
    for name in ("verdict", "action"):
        assert shown["latency"][name]["p50_ms"] == pytest.approx(found[f"{name}_p50_ms"])
        assert shown["latency"][name]["p99_ms"] == pytest.approx(found[f"{name}_p99_ms"])


def test_a_calibration_counts_moves_that_are_valid_and_tells_how_long_it_takes() -> None:
    state = fresh()
    shown = tell(state, 0.0, opening("calibration"), BlockStart(session="s", block=0, n_moves=4), start(0))
    assert shown["progress"]["to_go_s"] is None
    for step in (1, 2):
        shown = tell(state, 3.0 * step, move(0, step), verdict(0, step, "unjudged"))
    assert (shown["progress"]["done"], shown["progress"]["total"], shown["progress"]["to_go_s"]) == (2, 8, 18.0)
    shown = tell(state, 9.0, move(0, 3), verdict(0, 3, "rejected"))
    assert (shown["progress"]["done"], shown["progress"]["moves"]) == (2, 3)
    shown = tell(state, 9.0, Command(session="s", command="finish", by_person=True))
    assert shown["progress"]["to_go_s"] == 6.0  # two more of this block
    assert shown["session"]["is_last"]
    shown = tell(state, 12.0, BlockEnd(session="s", block=0, n_moves=4))
    assert shown["progress"]["to_go_s"] == 0.0


def test_instructions_before_the_first_block_tell_nothing_of_how_long_moves_take() -> None:
    state = fresh()
    tell(state, 0.0, opening("calibration"))
    tell(state, 300.0, BlockStart(session="s", block=0, n_moves=4), start(0))
    tell(state, 302.0, Pause(session="s", reason="why", by_person=True))
    tell(state, 402.0, Resume(session="s"))
    shown = tell(state, 403.0, move(0, 1), verdict(0, 1, "unjudged"))
    assert shown["progress"]["to_go_s"] == 7 * 3.0


def test_the_last_block_of_a_calibration_that_goes_on_is_as_long_as_is_left_of_it() -> None:
    state = fresh()
    tell(state, 0.0, opening("calibration"), BlockStart(session="s", block=1, n_moves=1), start(0))
    tell(state, 3.0, move(0, 1), verdict(0, 1, "unjudged"), BlockEnd(session="s", block=1, n_moves=1))
    tell(state, 3.0, BlockStart(session="s", block=2, n_moves=4))
    tell(state, 6.0, move(0, 2), verdict(0, 2, "unjudged"))
    shown = tell(state, 6.0, Command(session="s", command="finish", by_person=True))
    assert shown["progress"]["to_go_s"] == 3 * 3.0


def test_online_a_pause_in_an_episode_is_left_out() -> None:
    state = fresh()
    tell(state, 0.0, opening(), start(0), goal(0))
    tell(state, 3.0, Pause(session="s", reason="why", by_person=True))
    tell(state, 603.0, Resume(session="s"))
    shown = tell(state, 610.0, end(0, 1), start(1))
    assert shown["progress"]["to_go_s"] == 30.0
    tell(state, 611.0, Pause(session="s", reason="why", by_person=True))
    assert tell(state, 900.0)["progress"]["to_go_s"] == 29.0


def test_online_the_time_to_go_by_the_mean_of_the_episodes() -> None:
    state = fresh()
    tell(state, 0.0, opening(), start(0), goal(0))
    tell(state, 3.0, move(0, 1))
    shown = tell(state, 10.0, end(0, 1), start(1))
    assert shown["progress"]["to_go_s"] == 30.0
    assert tell(state, 15.0)["progress"]["to_go_s"] == 25.0
    assert shown["episode"]["goal"] is None
    shown = tell(state, 15.0, SessionEnd(session="s", reason="complete"))
    assert shown["progress"]["to_go_s"] is None


def test_buttons_can_be_pressed_when_somebody_follows_and_there_is_something_to_do() -> None:
    state = fresh()
    assert not any(tell(state, 0.0, opening())["session"]["can"].values())  # nobody leads
    shown = tell(state, 0.0, status("session"))
    state.take("bci-session", 0.0, status("session"), 0.0)
    assert tell(state, 0.1)["session"]["can"] == {"pause": True, "resume": False, "finish": True, "note": True}
    shown = tell(state, 0.5, Command(session="s", command="pause", by_person=True))["session"]
    assert (shown["phase"], shown["asked"], shown["can"]["pause"], shown["can"]["resume"]) == (
        "running",
        "pause",
        False,
        True,
    )
    shown = tell(state, 1.0, Pause(session="s", reason="why", by_person=True))["session"]
    assert (shown["phase"], shown["pause"], shown["asked"], shown["can"]["resume"]) == ("paused", "why", None, True)
    shown = tell(state, 1.2, Command(session="s", command="resume", by_person=True))["session"]
    assert shown["asked"] == "resume"
    shown = tell(state, 1.3, Screen(session="s", name="break"), Command(session="s", command="finish", by_person=True))
    assert (shown["session"]["asked"], shown["session"]["screen"], shown["session"]["is_last"]) == (
        "resume",
        "break",
        True,
    )
    shown = tell(state, 1.5, Resume(session="s"), start(0))["session"]
    assert (shown["asked"], shown["screen"], shown["can"]["finish"]) == (None, None, False)
    assert (shown["phase"], shown["can"]["pause"], shown["can"]["resume"]) == ("running", True, False)
    state.take("bci-session", 9.0, status("session"), 9.0)
    shown = tell(state, 9.0, SessionEnd(session="s", reason="interrupted", text="why"))["session"]
    assert (shown["phase"], shown["end"]) == ("ended", "interrupted. why")
    assert not any(shown["can"].values())


def test_a_pause_that_is_technical_is_not_ended_by_a_person() -> None:
    state = fresh()
    tell(state, 0.0, opening())
    state.take("bci-session", 0.0, status("session"), 0.0)
    shown = tell(state, 0.0, Pause(session="s", reason="The EEG is gone."))["session"]
    assert shown["can"] == {"pause": True, "resume": False, "finish": True, "note": True}


def test_the_belief_is_that_of_the_episode_under_way() -> None:
    state = fresh()
    goals = (0.25,) * 4
    tell(state, 0.0, opening(), start(0), Belief(session="s", episode=0, step=1, goal=goals))
    shown = tell(state, 0.0)
    assert shown["episode"]["belief"] == {"step": 1, "goal": goals, "exact": False}
    assert tell(state, 5.0, start(1))["episode"]["belief"] is None


def test_links_are_shown_as_they_are_told_and_silence_is_seen() -> None:
    state = fresh()
    link = Link(session="s", role="decoder", stream="Amp", age_s=0.1, rate_hz=499.9, gaps=2, offset_s=0.01)
    shown = tell(state, 1.0, link, LateFrame(session="s", episode=0, step=1, late_ms=7.5))
    rows = {row["stream"]: row for row in shown["streams"]}
    assert rows["Amp"]["heard_by"][0]["rate_hz"] == 499.9
    assert rows["Amp"]["age_s"] is None  # the console itself doesn't hear it
    assert rows["Amp"]["state"] == "ok"
    assert shown["latency"]["late_frames"] == 1
    rows = {row["stream"]: row for row in state.snapshot(60.0, 60.0)["streams"]}
    assert rows["bci-stimulus"]["state"] == "quiet"
    assert rows["bci-truth"]["state"] == "ok"  # it speaks only when there is something to tell
    late = link.model_copy(update={"age_s": 30.0})
    assert {row["stream"]: row["state"] for row in tell(state, 61.0, late)["streams"]}["Amp"] == "quiet"


def test_who_comes_late_is_told_how_far_the_run_is_and_says_so() -> None:
    memory, early, late = Memory("s"), fresh(), fresh()
    story: list[AnyMessage] = [opening(), start(0), move(0, 1), verdict(0, 1, "error"), end(0, 1), start(1)]
    story += [move(1, 1), verdict(1, 1, "error"), Electrodes(session="s", episode=1, bad={"Cz": ["flat"]})]
    for stamp, message in enumerate(story):
        memory.take(stamp, message)
        tell(early, stamp, message)
    tell(late, 9.0, move(1, 2))  # heard before the answer comes
    tell(early, 9.0, move(1, 2))
    shown, whole = tell(late, 9.0, memory.recall("console")), tell(early, 9.0)
    assert shown["session"]["is_late"]
    assert not whole["session"]["is_late"]
    for section in ("progress", "episode", "world", "head"):
        assert shown[section] == whole[section]
    assert shown["verdicts"]["recent"] == whole["verdicts"]["recent"][1:]


def test_the_log_keeps_notes_and_what_changes_and_not_for_ever() -> None:
    state = fresh()
    tell(state, 10.0, opening())
    note = Note(session="s", role="console", level="info", text="hello")
    shown = tell(state, 12.5, note, status("decoder"), status("decoder"))["log"]
    assert [(line["t"], line["role"], line["text"]) for line in shown] == [
        (0.0, "stimulus", "The run began on map open"),
        (2.5, "console", "hello"),
        (2.5, "decoder", "running"),
    ]
    for _ in range(400):
        tell(state, 13.0, note)
    assert len(state.snapshot(0.0, 0.0)["log"]) == 300


def test_moves_come_into_the_average_once_verdict_and_truth_are_known() -> None:
    state = fresh()
    state.begin_eeg(EEG, 0.0)
    tell(state, 0.0, opening(), start(0))
    times = np.arange(0, 12, 1 / 500)
    samples = np.random.default_rng(0).normal(0, 5, (len(times), 3))
    for step, (onset, outcome) in enumerate([(6.0, "error"), (8.0, "unjudged"), (10.0, "rejected")], start=1):
        tell(state, onset, move(0, step), verdict(0, step, outcome), truth(0, step, step == 1))
    for piece in np.array_split(np.arange(len(times)), 40):
        state.take_eeg(samples[piece], times[piece], float(times[piece[-1]]))
    shown = state.snapshot(12.0, 12.0)
    assert shown["average"]["n"] == {"correct": 1, "error": 1}
    rows = {row["stream"]: row for row in shown["streams"]}
    assert rows["Amp"]["rate_hz"] == pytest.approx(500.0)
    tell(state, 12.0, Continued(session="s", episode=0, step=1), move(0, 2), truth(0, 2, False))
    assert tell(state, 12.0, verdict(0, 2, "error"))["average"]["n"]["correct"] == 1
    stamps = np.arange(12, 14, 1 / 500)
    state.take_eeg(samples[: len(stamps)], stamps, 14.0)
    assert state.snapshot(14.0, 14.0)["average"]["n"] == {"correct": 2, "error": 1}
