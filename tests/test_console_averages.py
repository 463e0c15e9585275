"""The averages are the decoder's chain, and the head is where the electrodes are."""

import numpy as np
import pytest

from bci_app.config import Config
from bci_app.console.averages import N_WINDOWS, START_MS, WINDOW_MS, Averages
from bci_app.console.heads import amplitudes, head, places
from decoder.chain import design, reference_features
from decoder.epochs import Epoch, Shape, cut_recording

CHANNELS = ["Fz", "Cz", "Pz", "O1", "EOG1"]
ONSETS = {(0, 1): (6.0, True), (0, 2): (9.0, False), (0, 3): (12.0, True), (0, 4): (15.0, False)}


@pytest.fixture(scope="module")
def eeg() -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0, 20, 1 / 250)
    return np.random.default_rng(1).normal(0, 8, (len(times), len(CHANNELS))), times


def averaged(eeg: tuple[np.ndarray, np.ndarray], bad: frozenset[str] = frozenset(), step: int = 100) -> Averages:
    samples, times = eeg
    averages = Averages(CHANNELS, 250.0, Config().chain, Config().eeg)
    for begin in range(0, len(times), step):
        averages.push(samples[begin : begin + step], times[begin : begin + step])
        for key, (onset, error) in ONSETS.items():
            if times[begin] >= onset:
                averages.expect(key, onset, error, bad)
    return averages


def test_the_averages_are_those_of_the_readable_chain(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    windows = {"start_ms": START_MS, "window_ms": WINDOW_MS, "n_windows": N_WINDOWS}
    chain = design(Config().chain.model_copy(update=windows), 250.0)
    good = [0, 1, 3]  # Pz is bad, the last is no EEG
    epochs = cut_recording(
        eeg[0], eeg[1], [onset for onset, _ in ONSETS.values()], Shape(250.0, chain.n_before, chain.n_after)
    )
    responses = np.array(
        [reference_features(epoch.data[:, good], chain) for epoch in epochs if isinstance(epoch, Epoch)]
    )
    error = np.array([error for _, error in ONSETS.values()])
    averages = averaged(eeg, frozenset({"Pz"}))
    assert averages.counts() == {"correct": 2, "error": 2}
    found = averages.at("Cz")
    expected = responses[error, 1].mean(axis=0)
    np.testing.assert_allclose(found["error"], expected - expected[:30].mean(), atol=1e-3)
    np.testing.assert_allclose(np.subtract(found["error"], found["correct"]), found["difference"], atol=2e-3)
    assert found["times_ms"][0] == -295.0
    assert averages.at("Pz")["n"] == {"correct": 0, "error": 0}
    assert averages.at("Pz")["error"] is None
    assert averages.at("EOG1")["error"] is None
    with pytest.raises(KeyError):
        averages.at("Oz")


def test_it_does_not_matter_how_the_eeg_came(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    one, other = averaged(eeg, step=7).at("Fz"), averaged(eeg, step=333).at("Fz")
    assert one == other


def test_what_is_no_eeg_is_left_out(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    samples = eeg[0].copy()
    samples[1500:1520, 0] = 1e5
    samples[1650, 1] = np.nan
    averages = averaged((samples, eeg[1]))
    assert averages.n_left_out == 2
    assert sum(averages.counts().values()) == 2


def test_electrodes_are_seen_from_above() -> None:
    where = dict(zip(CHANNELS, places(CHANNELS), strict=True))
    assert where["EOG1"] is None
    assert where["Cz"] == pytest.approx((0, 0), abs=0.06)
    assert where["Fz"] is not None
    assert where["Fz"][1] > 0.3
    assert where["O1"] is not None
    assert where["O1"][0] < 0
    assert where["O1"][1] < -0.7
    assert places(["Nowhere"]) == [None]


def test_amplitudes_are_of_what_moves() -> None:
    times = np.arange(1000) / 500
    wave = 10 * np.sqrt(2) * np.sin(2 * np.pi * 10 * times)
    samples = np.stack([wave + 4000 + 50 * times, np.zeros(1000), np.full(1000, np.nan)], axis=1)
    assert amplitudes(samples) == [pytest.approx(10, abs=0.1), 0.0, None]
    assert amplitudes(samples[:1]) == [None, None, None]
    rows = head(["Fz", "Cz"], [(0, 0.4), None], [1.0, None], {"Cz": ["flat"]})
    assert rows[1] == {"name": "Cz", "place": None, "uv": None, "faults": ["flat"]}
