"""Going on with a run that was broken off: where, with what, and the runs together as one."""

from pathlib import Path

import numpy as np
import pytest
from test_bci_app_said import end, move, opening, start, verdict
from xdf_files import write_xdf

from bci_app.config import Config, changed
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.joining import BETWEEN_S, joined
from bci_app.protocol import BlockEnd, BlockStart, Electrodes, Message, MoveOnset, SessionStart, Verdict
from bci_app.recording import Recording, Stamped
from bci_app.resuming import find, first_unfinished, in_block
from bci_app.runs import new_run, write_sidecar

NAMES = ("Fz", "Cz")


def recording(*messages: Message, first: float = 100.0, names: tuple[str, ...] = NAMES) -> Recording:
    """Ten seconds of EEG at 10 Hz, and a message a second."""
    eeg = EegDescription("Amp", "amp", "here", names, ("uV",) * len(names), ("EEG",) * len(names), 10.0)
    stamped = tuple(Stamped(first + number, message) for number, message in enumerate(messages))
    times = first + np.arange(100) / 10
    return Recording(Path("x.xdf"), eeg, np.zeros((100, len(names)), np.float32), times, stamped, ())


def block(number: int, n_moves: int) -> BlockStart:
    return BlockStart(session="s", block=number, n_moves=n_moves)


def block_end(number: int) -> BlockEnd:
    return BlockEnd(session="s", block=number, n_moves=3)


def rejected(episode: int, step: int) -> Verdict:
    return Verdict(session="s", episode=episode, step=step, outcome="rejected", clock_offset=0.0)


def test_an_online_run_goes_on_with_the_first_episode_without_an_end() -> None:
    assert first_unfinished(recording(opening()), 0) == 0
    assert first_unfinished(recording(opening(), start(0), move(0, 1)), 0) == 0
    assert first_unfinished(recording(start(0), end(0), start(1), end(1), start(2), move(2, 1)), 0) == 2
    assert first_unfinished(recording(start(7), move(7, 1)), 7) == 7
    aborted = end(1).model_copy(update={"reason": "aborted"})
    assert first_unfinished(recording(start(0), end(0), start(1), aborted), 0) == 1


@pytest.mark.parametrize(
    ("messages", "begun", "expected"),
    [
        ([], (0, 0), (0, 0)),
        ([], (2, 5), (2, 5)),
        ([block(0, 3), start(0)], (0, 0), (0, 0)),
        ([block(0, 3), start(0), move(0, 1), verdict(0, 1), move(0, 2), verdict(0, 2)], (0, 0), (0, 2)),
        ([block(0, 3), start(0), move(0, 1), verdict(0, 1), move(0, 2)], (0, 0), (0, 1)),  # no verdict came
        ([block(0, 3), start(0), move(0, 1), rejected(0, 1), move(0, 2), verdict(0, 2)], (0, 0), (0, 1)),
        ([block(0, 3), start(0), move(0, 1), verdict(0, 1), block_end(0)], (0, 0), (1, 0)),
        (
            [block(0, 3), move(0, 1), verdict(0, 1), block_end(0), block(1, 3), move(1, 1), verdict(1, 1)],
            (0, 0),
            (1, 1),
        ),
        ([block(1, 1), start(0), move(0, 1), verdict(0, 1)], (1, 2), (1, 3)),
    ],
)
def test_a_calibration_goes_on_in_its_block(
    messages: list[Message], begun: tuple[int, int], expected: tuple[int, int]
) -> None:
    assert in_block(recording(*messages), begun, per_block=3) == expected


def test_what_cannot_be_gone_on_with_is_said(tmp_path: Path) -> None:
    config = Config(recordings=str(tmp_path))
    with pytest.raises(SetupError, match="no calibration run of participant P1"):
        find(config, "P1", "S001", "calibration", "open", True)
    run = new_run(tmp_path, "P1", "S001", "calibration")
    write_sidecar(run.sidecar, {"state": "starting", "config": config.model_dump(mode="json")})
    with pytest.raises(SetupError, match="no calibration run of participant P1"):  # it ended before it was recorded
        find(config, "P1", "S001", "calibration", "open", True)


def test_a_false_start_is_not_gone_on_with(tmp_path: Path) -> None:
    """The run before it is: of the false one nothing but the headers is in the file."""
    config = Config(recordings=str(tmp_path))
    begun = SessionStart(session="s", task="online", participant="P1", map="open", layout=["..."], n_episodes=2)
    channels, sidecar = [("Fz", "EEG", "microvolts")], {"config": config.model_dump(mode="json")}
    for number, n_samples in ((1, 500), (2, 0)):
        run = new_run(tmp_path, "P1", "S001", "online")
        samples, times = np.zeros((n_samples, 1), np.float32), np.arange(n_samples) / 100
        said = {"bci-stimulus": [(1.0, begun)] if n_samples else []}
        write_xdf(run.xdf, samples, times, channels, 100.0, said)
        write_sidecar(run.sidecar, sidecar)
        assert run.number == number
    found = find(config, "P1", "S001", "online", "open", True)
    assert [path.name for path in found.recordings] == ["sub-P1_ses-S001_task-online_run-001_eeg.xdf"]


def test_it_is_the_last_run_on_that_map_and_of_that_person(tmp_path: Path) -> None:
    def config(seed: int) -> Config:
        return changed(Config(recordings=str(tmp_path)), {"simulation": {"seed": seed}})

    channels = [("Fz", "EEG", "microvolts")]
    for map_name in ("open", "obstacles"):
        run = new_run(tmp_path, "P1", "S001", "online")
        begun = SessionStart(session="s", task="online", participant="P1", map=map_name, layout=["..."], n_episodes=2)
        said = {"bci-stimulus": [(1.0, begun)]}
        write_xdf(run.xdf, np.zeros((500, 1), np.float32), np.arange(500) / 100, channels, 100.0, said)
        sidecar = {"map": map_name, "simulated": True, "config": config(2).model_dump(mode="json")}
        write_sidecar(run.sidecar, sidecar)
    found = find(config(2), "P1", "S001", "online", "open", True)
    assert found.recordings[0].name == "sub-P1_ses-S001_task-online_run-001_eeg.xdf"
    with pytest.raises(SetupError, match=r"no online run .* on map mine"):
        find(config(2), "P1", "S001", "online", "mine", True)
    with pytest.raises(SetupError, match=r"simulation.seed was 2, and now it is 1.*--participant-seed"):
        find(config(1), "P1", "S001", "online", "open", True)
    with pytest.raises(SetupError, match="of a simulated participant, and a real one can't go on"):
        find(config(2), "P1", "S001", "online", "open", False)


def test_runs_are_joined_in_time_and_number() -> None:
    first = recording(opening(), start(0), move(0, 1), verdict(0, 1))
    looked = Electrodes(session="s", episode=0, last_time=3.0, n_samples=9)
    judged = verdict(0, 1).model_copy(update={"first_time": 2.0})
    second = recording(opening(), start(0), looked, move(0, 1), judged, first=2.0)  # the computer was started anew
    both = joined([first, second])
    shift = 109.9 + BETWEEN_S - 2.0
    assert np.all(np.diff(both.times) > 0)
    assert both.times[100] == pytest.approx(2.0 + shift)
    assert len(both.samples) == len(both.times) == 200
    assert [(onset.episode, onset.step) for _, onset in both.of(MoveOnset)] == [(0, 1), (1, 1)]
    assert [stamp for stamp, _ in both.of(MoveOnset)] == pytest.approx([102.0, 5.0 + shift])
    ((_, electrodes),) = both.of(Electrodes)
    assert electrodes.last_time == pytest.approx(3.0 + shift)
    assert both.of(Verdict)[1][1].first_time == pytest.approx(2.0 + shift)
    assert joined([first]) is first
    with pytest.raises(SetupError, match="other channels"):
        joined([first, recording(opening(), names=("Fz", "Pz"))])
