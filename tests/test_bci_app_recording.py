"""Reading recordings: other people's, and broken ones. A broken one is said to be broken."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from xdf_files import write_xdf

from bci_app.errors import SetupError
from bci_app.protocol import (
    Action,
    Continued,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    Recall,
    Said,
    SessionStart,
)
from bci_app.recording import Stamped, _retold, read


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "is empty"), (b"PK\x03\x04 not ours", "not an XDF"), (b"XDF:" + b"\xff" * 50, "can't be read|exactly one")],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "x.xdf"
    path.write_bytes(content)
    with pytest.raises(SetupError, match=says):
        read(path)
    assert path.read_bytes() == content


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"Can't read the recording .*absent\.xdf"):
        read(tmp_path / "absent.xdf")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("minimal.xdf", "no messages of ours"),
        ("empty_streams.xdf", "exactly one EEG stream"),
        ("clock_resets.xdf", "no messages of ours"),
        ("sub-P001_ses-S001_task-P300Checkboard_run-001_eeg.xdf", "no messages of ours"),
    ],
)
def test_other_peoples_recordings_are_told_from_ours(data: Path, name: str, says: str) -> None:
    with pytest.raises(SetupError, match=says):
        read(data / "xdf" / name)


def test_a_cut_recording_is_said_to_be_cut(data: Path, tmp_path: Path) -> None:
    whole = data / "xdf" / "sub-P001_ses-S001_task-P300Checkboard_run-001_eeg.xdf"
    cut = tmp_path / "cut.xdf"
    shutil.copy(whole, cut)
    with cut.open("r+b") as file:
        file.truncate(whole.stat().st_size // 2)
    with pytest.raises(SetupError, match="damaged"):
        read(cut)


def test_what_is_said_as_a_stimulus_goes_on_is_not_void_whichever_stream_comes_first(tmp_path: Path) -> None:
    """It goes on with the end of an episode: all of that has one stamp, on two streams."""
    layout = ["...", "..."]
    opening = SessionStart(session="s", task="online", participant="P", map="open", layout=layout, n_episodes=2)
    starts = [
        EpisodeStart(session="s", episode=number, position=(0, 0), sensed=(False,) * 5, max_steps=60)
        for number in range(2)
    ]
    goals = [EpisodeGoal(session="s", episode=number, goal=(1, 2), distance=3) for number in range(2)]
    end = EpisodeEnd(session="s", episode=0, steps=2, reason="goal")
    here = Continued(session="s", episode=0, step=2)
    said: dict[str, list[tuple[float, Message]]] = {
        "bci-truth": [(2.0, goals[0]), (9.0, goals[1])],
        "bci-stimulus": [(1.0, opening), (2.0, starts[0]), (9.0, here), (9.0, end), (9.0, starts[1])],
    }
    channels, samples = [("Fz", "EEG", "microvolts")], np.zeros((1000, 1), np.float32)
    for number, order in enumerate((list(said), list(reversed(said)))):
        path = tmp_path / f"{number}.xdf"
        write_xdf(path, samples, np.arange(1000) / 100, channels, 100.0, {name: said[name] for name in order})
        assert [goal for _, goal in read(path, allow_damage=True).of(EpisodeGoal)] == goals


def test_what_only_a_recall_kept_is_read_as_said() -> None:
    """A policy that is killed right after an action: the stimulus has it, the recorder hasn't."""
    action = Action.model_validate(
        {"session": "s", "episode": 0, "step": 1, "action": "east", "probabilities": (0, 0, 0, 1), "verdict": "missing"}
    )
    start = SessionStart(session="s", task="online", participant="P", map="open", layout=["..."])
    told = Recall(session="s", role="policy", said=(Said(stamp=1.0, message=start), Said(stamp=2.0, message=action)))
    found = [Stamped(1.0, start), Stamped(3.0, told), Stamped(3.5, told)]
    assert _retold(found) == [Stamped(2.0, action)]
    assert _retold([*found, Stamped(2.0, action)]) == []
