"""The reference chain, and that one matrix is the same chain."""

from typing import Literal

import mne
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import ChainConfig, load
from bci_app.errors import SetupError
from decoder.chain import design, look_back_s, reference_features
from decoder.operator import chain_operator, digest, features
from decoder.spatial import common_average

RATES = (128, 160, 250, 256, 300, 500, 512, 1000)


def raw_eeg(n_raw: int, n_channels: int, seed: int, offset_uv: float = 50_000.0) -> np.ndarray:
    """A random walk on electrode offsets of tens of millivolts."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 5, (n_raw, n_channels)).cumsum(axis=0) + rng.normal(0, offset_uv, n_channels)


def through_mne(raw: np.ndarray, sfreq: float, config: ChainConfig, windows: tuple[slice, ...]) -> np.ndarray:
    """MNE's own resampling and filtering of the same stretch; "zero" is its linear, delay taken back."""
    grid = raw.T
    if sfreq != config.sfreq:
        ratio = {"up": config.sfreq / sfreq, "down": 1.0}
        grid = mne.filter.resample(grid, **ratio, method="polyphase", pad="line", verbose="error")
    phase = "minimum" if config.phase == "minimum" else "zero"
    grid = mne.filter.filter_data(grid, config.sfreq, config.low_hz, config.high_hz, phase=phase, verbose="error")
    grid = grid - grid.mean(axis=0)
    return np.stack([grid[:, window].mean(axis=1) for window in windows], axis=1)


@settings(max_examples=40, deadline=None)
@given(
    low=st.sampled_from([0.1, 0.3, 0.5, 1.0, 1.7, 2.5, 4.0, 8.0]),
    high=st.sampled_from([12.0, 20.0, 45.0, 50.0, 60.0]),
    rate=st.sampled_from([128.0, 200.0, 250.0, 256.0]),
    phase=st.sampled_from(["minimum", "linear"]),
    sfreq=st.sampled_from(RATES),
)
def test_how_far_it_looks_back_is_known_without_designing_it(
    low: float, high: float, rate: float, phase: Literal["minimum", "linear"], sfreq: float
) -> None:
    config = ChainConfig(low_hz=low, high_hz=high, sfreq=rate, phase=phase)
    assert look_back_s(config, sfreq) == design(config, sfreq).n_before / sfreq


@pytest.mark.parametrize("phase", ["minimum", "linear"])
@pytest.mark.parametrize("sfreq", RATES)
def test_same_features_as_mne_on_the_same_stretch(sfreq: float, phase: str) -> None:
    config = ChainConfig(phase=phase)
    chain = design(config, sfreq)
    raw = raw_eeg(chain.n_raw, 8, seed=1)
    expected = through_mne(raw - raw.mean(axis=0), sfreq, config, chain.windows)
    found = features(raw, chain_operator(chain), common_average(8)).reshape(8, 15)
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


@settings(max_examples=25, deadline=None)
@given(
    sfreq=st.one_of(st.integers(110, 700), st.sampled_from([128.0, 250.0, 499.7, 512.0, 600.6])),
    n_channels=st.integers(2, 70),
    phase=st.sampled_from(["minimum", "linear"]),
    seed=st.integers(0, 1000),
)
def test_operator_is_the_reference_chain(sfreq: float, n_channels: int, phase: str, seed: int) -> None:
    chain = design(ChainConfig(phase=phase), float(sfreq))
    raw = raw_eeg(chain.n_raw, n_channels, seed)
    expected = reference_features(raw, chain)
    found = features(raw, chain_operator(chain), common_average(n_channels)).reshape(n_channels, 15)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("sfreq", RATES)
def test_an_electrodes_offset_leaves_no_trace(sfreq: float) -> None:
    chain = design(ChainConfig(), sfreq)
    raw = raw_eeg(chain.n_raw, 8, seed=2)
    operator, spatial = chain_operator(chain), np.eye(8)
    offsets = np.linspace(-50_000.0, 50_000.0, 8)  # uV: electrodes reach tens of millivolts
    without, with_them = features(raw, operator, spatial), features(raw + offsets, operator, spatial)
    assert np.abs(with_them - without).max() < 1e-6


def test_minimum_phase_ends_with_the_last_window_and_linear_waits() -> None:
    assert design(ChainConfig(), 500.0).n_after == 300
    assert design(ChainConfig(phase="linear"), 500.0).n_after > 300 + 800


def test_the_stretch_holds_the_whole_filter() -> None:
    """More EEG before the stretch changes nothing: the grid and everything the filter reaches are the same."""
    chain = design(ChainConfig(), 512.0)  # two raw samples a grid sample: a longer stretch has the same grid
    longer = raw_eeg(chain.n_raw + 512, 4, seed=2, offset_uv=0)
    longer -= longer[512:].mean(axis=0)
    grid = mne.filter.resample(longer.T, up=0.5, method="polyphase", pad="line", verbose="error")
    grid = mne.filter.filter_data(grid, 256.0, 1.0, 50.0, phase="minimum", verbose="error")
    grid = grid - grid.mean(axis=0)
    expected = np.stack([grid[:, w.start + 256 : w.stop + 256].mean(axis=1) for w in chain.windows], axis=1)
    # Only the line that the padded end goes on along knows of the stretch's first sample.
    np.testing.assert_allclose(reference_features(longer[512:], chain)[:, :13], expected[:, :13], atol=1e-6)


def test_windows_are_half_open_on_the_grid() -> None:
    chain = design(ChainConfig(), 256.0)
    times = (np.arange(chain.n_raw) - chain.n_before) / 256
    for number, window in enumerate(chain.windows):
        inside = np.flatnonzero((times >= 0.150 + 0.030 * number - 1e-9) & (times < 0.180 + 0.030 * number - 1e-9))
        assert (window.start, window.stop) == (inside[0], inside[-1] + 1)
    assert chain.windows[-1].stop == chain.n_raw


def test_offsets_and_a_common_signal_leave_no_trace() -> None:
    chain = design(ChainConfig(), 500.0)
    operator = chain_operator(chain)
    rng = np.random.default_rng(3)
    raw = rng.normal(0, 10, (chain.n_raw, 16))
    common = rng.normal(0, 1000, (chain.n_raw, 1))
    average = common_average(16)
    np.testing.assert_allclose(features(raw + common, operator, average), features(raw, operator, average), atol=1e-8)
    offset = features(np.tile(rng.normal(0, 1e5, 16), (chain.n_raw, 1)), operator, average)
    assert np.abs(offset).max() < 1e5 * 1e-3 * 3  # the filter's gain at 0 Hz is 2e-4


def test_a_features_bits_dont_depend_on_type_or_layout() -> None:
    chain = design(ChainConfig(), 500.0)
    operator = chain_operator(chain)
    epoch = np.random.default_rng(4).normal(0, 10, (chain.n_raw, 64)).astype(np.float32)
    fingerprints = {
        digest(features(variant, operator, common_average(64)))
        for variant in (epoch, epoch.astype(np.float64), np.asfortranarray(epoch), np.repeat(epoch, 2, axis=0)[::2])
    }
    assert len(fingerprints) == 1


@pytest.mark.parametrize("n_channels", [2, 31, 64, 129])
def test_a_features_bits_dont_depend_on_where_the_samples_lie_in_memory(n_channels: int) -> None:
    operator = np.random.default_rng(6).normal(size=(1000, 15))
    memory = np.empty(1000 * n_channels + 16)
    epoch = np.random.default_rng(7).normal(0, 10, (1000, n_channels))
    fingerprints = set()
    for shift in range(16):
        moved = memory[shift : shift + epoch.size].reshape(epoch.shape)
        moved[:] = epoch
        fingerprints.add(digest(features(moved, operator, common_average(n_channels))))
    assert len(fingerprints) == 1


def test_features_come_channel_by_channel() -> None:
    chain = design(ChainConfig(), 256.0)
    operator = chain_operator(chain)
    raw = np.zeros((chain.n_raw, 4))
    raw[:, 2] = np.random.default_rng(5).normal(0, 10, chain.n_raw)
    by_channel = features(raw, operator, common_average(4)).reshape(4, 15)
    np.testing.assert_allclose(by_channel[2], -3 * by_channel[0], rtol=1e-9)


@pytest.mark.parametrize("settings_", [{"high_hz": 130.0}, {"low_hz": 60.0}, {"window_ms": 1.0}])
def test_impossible_settings_are_refused(settings_: dict[str, float]) -> None:
    with pytest.raises(SetupError):
        design(load(overrides={"chain": settings_}).chain, 500.0)


def test_a_rate_too_slow_for_the_band_is_refused() -> None:
    with pytest.raises(SetupError, match="100 Hz"):
        design(ChainConfig(), 100.0)
