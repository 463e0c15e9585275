"""What a fit tells beside cross-validation."""

import json
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from recorded_by_hand import Wish, without, write
from recorded_by_hand import recording as by_hand

from bci_app.config import Config, validated
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.fitting import Labelled, _by_block, _session, _used, fit, labelled
from bci_app.joining import joined, lacks
from bci_app.ocular import Learnt
from bci_app.protocol import Electrodes, MoveOnset, SessionEnd, Truth
from bci_app.recording import Recording, Stamped, read
from decoder.calibration import calibrate
from decoder.eyes import Eyes
from decoder.participant import Participant


@pytest.fixture
def config():
    return validated({"calibration": {"moves_per_block": 80, "n_blocks": 3}, "online": {"expected_moves": 100}}, "here")


@pytest.fixture
def epochs() -> Labelled:
    rng = np.random.default_rng(0)
    error = np.tile(np.arange(10) < 3, 20)
    features = rng.normal(0, 1, (200, 30)) + 0.4 * error[:, None]
    return Labelled([], Counter(), [], features, error, Learnt(None, "", None), np.empty(0), judge_of=None)


def test_a_session_is_predicted_for_the_moves_of_the_configuration(epochs: Labelled, config) -> None:
    result = calibrate(epochs.features, epochs.error, config.classifier, config.chain.n_windows)
    found = _session(result, epochs.error, config)
    assert (found["n_moves"], found["error_share"]) == (100, 0.3)
    assert found["accuracy"]["low"] < result.blocked.accuracy.value < found["accuracy"]["high"]
    assert found["accuracy"]["low"] < result.blocked.accuracy.low  # Wilson's knows nothing of the session's own chance


def test_the_learning_curve_goes_block_by_block_to_the_last_whole_one(epochs: Labelled, config) -> None:
    found = _by_block(epochs, config)
    assert list(found) == ["after_80", "after_160"]
    assert found["after_80"]["total_gain"]["value"] > found["after_160"]["total_gain"]["value"] > 0
    assert found["after_160"]["sentence"].startswith("After 160 epochs")


SFREQ = 250.0


def recorded(spoil: dict[str, slice], bad: dict[str, list[str]], extra: tuple[str, ...] = ()) -> Recording:
    """60 moves of a simulated person, one episode; these samples are no numbers, these channels were found bad."""
    person = Participant(1, SFREQ, 0.9)
    names = (*person.names, *extra)
    rng, messages = np.random.default_rng(2), []
    for step in range(1, 61):
        onset, error = 10.0 + 2 * step, bool(rng.random() < 0.4)
        person.respond(onset, error)
        where = {"session": "s", "episode": 0, "step": step}
        messages.append(Stamped(onset, MoveOnset(action="north", position=(0, 0), sensed=(False,) * 5, **where)))
        messages.append(Stamped(onset, Truth(error=error, distance=3, **where)))
    messages.append(Stamped(9.0, Electrodes(session="s", episode=0, bad=bad, last_time=9.0, n_samples=2000)))
    samples = person.render(0, round(134 * SFREQ)).astype(np.float32)
    samples = np.hstack((samples, rng.normal(0, 30, (len(samples), len(extra))).astype(np.float32)))
    for name, stretch in spoil.items():
        samples[stretch, names.index(name)] = np.nan
    n = len(names)
    eeg = EegDescription("Amp", "a", "h", names, ("uV",) * n, ("EEG",) * n, SFREQ)
    return Recording(Path("r.xdf"), eeg, samples, np.arange(len(samples)) / SFREQ, tuple(messages), ())


@pytest.mark.parametrize("channel", ["Cz", "Fp1"])
def test_a_channel_that_is_no_number_all_along_is_in_nobodys_way(channel: str) -> None:
    """Neither the features nor the eyes' nor what the eyes alone tell draw on it."""
    config = Config()
    found = labelled(recorded({channel: slice(None)}, {channel: ["not finite"]}), config)
    assert len(found.error) == len(found.moves) == 60
    assert not found.reasons
    assert np.isfinite(found.features).all()
    assert np.isfinite(found.ocular).all()
    assert len(found.ocular) == 60
    assert "see the brain too" in found.eyes.seen_by


def test_a_single_strange_sample_costs_the_epochs_that_hold_it_and_not_the_eyes() -> None:
    config = Config()
    plain, spoilt = (labelled(recorded(spoil, {}), config) for spoil in ({}, {"Cz": slice(6000, 6001)}))
    assert (plain.eyes.eyes is None) == (spoilt.eyes.eyes is None)
    assert sum(spoilt.reasons.values()) in (1, 2)
    assert all("finite" in reason for reason in spoilt.reasons)
    assert len(spoilt.error) == 60 - sum(spoilt.reasons.values())


def test_eog_channels_are_the_eyes_alone() -> None:
    found = labelled(recorded({}, {"VEOG": ["flat"]}, ("VEOG", "HEOG")), Config())
    assert found.eyes.seen_by == "EOG channels VEOG, HEOG"
    assert found.features.shape == (60, 64 * 15)
    assert found.ocular.shape == (60, 2 * 15)
    assert not found.ocular[:, :15].any()  # VEOG is bad, and nobody can repair it


def test_a_decoder_asks_for_eog_channels_only_where_it_uses_them() -> None:
    eyes = Eyes(np.zeros((1, 3)), np.zeros((3, 1)))
    assert _used(["Fz", "VEOG", "Cz"], None) == ["Fz", "Cz"]
    assert _used(["Fz", "VEOG", "Cz"], eyes) == ["Fz", "VEOG", "Cz"]


CALIBRATION = "sub-P001_ses-S001_task-calibration_run-{:03d}_eeg.xdf"


def quiet(_what: str, _done: int, _total: int) -> None:
    pass


def put(folder: Path, number: int, whole: Recording, **told: object) -> Path:
    """A run of a calibration that was to have 600 valid moves."""
    path = write(whole, folder / CALIBRATION.format(number))
    planned = {"calibration": {"n_blocks": 5, "moves_per_block": 120}}
    path.with_suffix(".json").write_text(json.dumps({"config": planned, **told}), encoding="utf-8")
    return path


def test_a_calibration_that_was_broken_off_says_what_it_lacks(tmp_path: Path) -> None:
    whole = by_hand(Wish())
    first = put(tmp_path, 1, without(whole, SessionEnd))
    fitted = fit([first], Config(), False, quiet)
    n = fitted["calibration"]["n_valid"]
    (said,) = fitted["notes"]
    assert f"was broken off: it holds {n} valid moves of the 600 that were planned" in said
    assert "--resume goes on with it" in said
    # Whoever has gone on with it is told of the other run, from either side.
    second = put(tmp_path, 2, whole, continues=[first.name], reason="complete")
    for path in (first, second):
        (said,) = lacks([path], read(path), 50)
        assert "a part of a calibration, 50 valid moves of the 600" in said
        assert said.endswith(f"Fit its runs together: bci-app fit {first} {second}")
    assert lacks([first, second], joined([read(first), read(second)]), 150) == []
    # One that was whole once, and one that lacks its last word only.
    (said,) = lacks([put(tmp_path / "cut", 1, without(whole, SessionEnd), reason="complete")], read(first), 50)
    assert "The end of the calibration is missing" in said
    assert lacks([put(tmp_path / "all", 1, without(whole, SessionEnd))], read(first), 600) == []


def test_a_folder_is_no_recording_and_its_calibrations_are_listed(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"is a folder; expected .*\(\.xdf\)\. There is no calibration in it"):
        fit([tmp_path], Config(), False, quiet)
    path = tmp_path / "sub-P001" / CALIBRATION.format(1)
    path.parent.mkdir()
    path.touch()
    with pytest.raises(SetupError, match=re.escape(f"In it are {path}: name one.")):
        fit([tmp_path], Config(), False, quiet)


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no folder that nobody may write into")
def test_a_folder_that_cant_be_written_is_told_before_anything_is_read() -> None:
    with pytest.raises(SetupError, match=r"Can't write a decoder into /proc: .* Unlock the folder"):
        fit([Path("/proc/version")], Config(), False, quiet)
