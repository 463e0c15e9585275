"""What a replay says of a recording that isn't whole."""

import json
from pathlib import Path
from typing import Any

import pytest
from recorded_by_hand import Wish, recording, write

from bci_app.errors import SetupError
from bci_app.replay import replay


def quiet(_what: str, _done: int, _total: int) -> None:
    pass


def half_of(path: Path, wish: Wish) -> Path:
    """A recording of which the second half is lost."""
    write(recording(wish), path)
    contents = path.read_bytes()
    path.write_bytes(contents[: len(contents) // 2])
    return path


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return half_of(tmp_path_factory.mktemp("cut") / "calibration_eeg.xdf", Wish(n_episodes=4))


@pytest.mark.parametrize(
    ("sidecar", "says"),
    [
        ({"verdicts": {"unjudged": 30, "rejected": 4}, "actions": 0}, "{n} of its 34 verdicts and 0 of its 0 actions"),
        ({"state": "recording"}, "{n} verdicts and 0 actions were replayed. How many there were isn't known"),
        (None, "How many there were isn't known"),
    ],
)
def test_what_a_damaged_recording_lost_is_said(cut: Path, sidecar: dict[str, Any] | None, says: str) -> None:
    path = cut.with_suffix(".json")
    path.unlink(missing_ok=True)
    if sidecar is not None:
        path.write_text(json.dumps(sidecar), encoding="utf-8")
    found = replay(cut, None, None, True, quiet)
    assert 0 < found["replay"]["verdicts"] < 30
    assert says.format(n=found["replay"]["verdicts"]) in found["notes"][0]


def test_a_missing_sidecar_and_one_without_a_policy_are_told_apart(tmp_path: Path) -> None:
    path = half_of(tmp_path / "online_eeg.xdf", Wish("online", n_episodes=2))
    with pytest.raises(SetupError, match=r"There is no sidecar .*online_eeg\.json that names the policy\. .*--policy"):
        replay(path, None, None, True, quiet)
    path.with_suffix(".json").write_text('{"task": "online"}', encoding="utf-8")
    with pytest.raises(SetupError, match=r"The sidecar .*online_eeg\.json names no policy"):
        replay(path, None, None, True, quiet)
