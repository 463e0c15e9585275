"""What a fit tells beside cross-validation."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bci_app.config import Config, validated
from bci_app.eeg import EegDescription
from bci_app.fitting import Labelled, _by_block, _session, _used, labelled
from bci_app.ocular import Learnt
from bci_app.protocol import Electrodes, MoveOnset, Truth
from bci_app.recording import Recording, Stamped
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
