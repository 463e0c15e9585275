"""What acts across channels: repair, ocular correction and common average, exact against MNE and the readable order."""

import os
import subprocess
import sys
from pathlib import Path

import mne
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import ChainConfig
from bci_app.errors import SetupError
from decoder import chain as readable
from decoder.background import SyntheticBackground, bump
from decoder.eyes import eeg_outputs, learn_eyes, ocular_sources
from decoder.montage import MONTAGE_64, directions, template
from decoder.operator import chain_operator, digest, features
from decoder.spatial import MAX_BAD_SHARE, common_average, compose, interpolation, ocular

ROOT = Path(__file__).parents[1]
N = len(MONTAGE_64)
CHAIN = readable.design(ChainConfig(), 500.0)
OPERATOR = chain_operator(CHAIN)


def as_raw(samples: np.ndarray, names: tuple[str, ...] = MONTAGE_64) -> mne.io.RawArray:
    raw = mne.io.RawArray(samples.T * 1e-6, mne.create_info(list(names), 160.0, "eeg"), verbose="error")
    return raw.set_montage(template(), verbose="error")


def real_eeg(data: Path) -> mne.io.BaseRaw:
    raw = mne.io.read_raw(data / "eegmmidb_s001" / "S001R03.edf", preload=True, verbose="error").crop(0, 20)
    mne.datasets.eegbci.standardize(raw)
    return raw.set_montage(template(), match_case=False, verbose="error")


def test_repaired_and_averaged_as_by_mne_on_real_eeg(data: Path) -> None:
    raw = real_eeg(data)
    samples, names = raw.get_data().T * 1e6, raw.ch_names
    raw.info["bads"] = ["Fp1", "T7", "CPz", "O2"]
    matrix = compose(N, range(N), repair=interpolation([f"EEG {name.upper()}." for name in names], raw.info["bads"]))
    raw.interpolate_bads(verbose="error").set_eeg_reference("average", verbose="error")
    expected = raw.get_data().T * 1e6
    np.testing.assert_allclose(samples @ matrix.T, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(st.lists(st.sampled_from(MONTAGE_64), min_size=1, max_size=int(MAX_BAD_SHARE * N), unique=True))
def test_any_quarter_of_the_channels_is_repaired_from_the_others_as_by_mne(bad: list[str]) -> None:
    matrix = interpolation(MONTAGE_64, bad)
    good = [index for index, name in enumerate(MONTAGE_64) if name not in bad]
    worse = [MONTAGE_64.index(name) for name in bad]
    np.testing.assert_array_equal(matrix[good], np.eye(N)[good])
    assert not matrix[:, worse].any()
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-4)  # a shift of the reference stays one
    samples = np.random.default_rng(0).normal(0, 20, (50, N))
    raw = as_raw(samples)
    raw.info["bads"] = bad
    expected = raw.interpolate_bads(verbose="error").get_data().T * 1e6
    np.testing.assert_allclose(samples @ matrix.T, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_channels_of_unknown_place_are_left_alone() -> None:
    names = (*MONTAGE_64, "VEOG", "X7")
    matrix = interpolation(names, ["Cz"])
    np.testing.assert_array_equal(matrix[:N, :N], interpolation(MONTAGE_64, ["Cz"]))
    np.testing.assert_array_equal(matrix[N:], np.eye(N + 2)[N:])
    assert not matrix[:N, N:].any()


def test_nothing_bad_nothing_changed() -> None:
    np.testing.assert_array_equal(interpolation(("X1", "X2"), []), np.eye(2))


@pytest.mark.parametrize(
    ("channels", "bad", "message"),
    [
        ((*MONTAGE_64, "X7"), ["X7"], "X7 have no place in the 10-05 system"),
        (MONTAGE_64, MONTAGE_64[:17], "17 of 64 channels are bad"),
        (MONTAGE_64, ["Cz", "A1"], "A1 are not among the 64"),
        (("Fz", "Cz", "Pz", "Oz", "X1", "X2"), ["Cz"], "takes 4 good channels with 10-05 names; there are 3"),
    ],
)
def test_what_cant_be_repaired_is_said(channels: tuple[str, ...], bad: list[str], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        interpolation(channels, bad)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), bad=st.sets(st.sampled_from(MONTAGE_64), max_size=6), extra=st.integers(0, 4))
def test_one_matrix_is_the_readable_order(seed: int, bad: set[str], extra: int) -> None:
    """Choice, repair, ocular correction, average, one after the other on every sample; then the rest of the chain."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(0, 20, (CHAIN.n_raw, N + extra)) + rng.normal(0, 100, N + extra)
    order = rng.permutation(N + extra)[:N]
    sources, weights = rng.normal(0, 0.1, (3, N)), rng.normal(0, 0.1, (N, 3))
    repair = interpolation(MONTAGE_64, sorted(bad))
    spatial = compose(N + extra, order, repair=repair, eyes=ocular(weights, sources))
    repaired = raw[:, order] @ repair.T
    clean = readable.common_average(repaired - repaired @ sources.T @ weights.T)
    expected = readable.reference_features(clean, CHAIN)  # averages once more, which changes nothing
    found = features(raw, OPERATOR, spatial).reshape(N, -1)
    by_product = (spatial @ (raw.T @ OPERATOR)).reshape(-1)
    # Against the same numbers multiplied plainly; the readable chain's own filtering (FFT) rounds a little more.
    np.testing.assert_allclose(found.reshape(-1), by_product, rtol=0, atol=1e-11 * np.abs(by_product).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    assert spatial.flags.c_contiguous
    assert spatial.dtype == np.float64


def test_eog_channels_correct_but_are_no_output() -> None:
    names = (*MONTAGE_64, "VEOG", "HEOG")
    _, sources = ocular_sources(names)
    np.testing.assert_array_equal(sources, np.eye(N + 2)[N:])
    weights = np.random.default_rng(1).normal(0, 0.3, (N + 2, 2))
    matrix = compose(N + 2, range(N + 2), eyes=ocular(weights, sources), outputs=eeg_outputs(names))
    samples = np.random.default_rng(2).normal(0, 20, (10, N + 2))
    expected = readable.common_average(samples[:, :N] - samples[:, N:] @ weights[:N].T)
    np.testing.assert_allclose(samples @ matrix.T, expected, atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_what_an_unused_channel_delivers_leaves_no_trace(value: float) -> None:
    epoch = np.random.default_rng(3).normal(0, 20, (CHAIN.n_raw, N))
    spatial = compose(N, range(N), repair=interpolation(MONTAGE_64, ["Cz"]))
    clean = digest(features(epoch, OPERATOR, spatial))
    epoch[100:, MONTAGE_64.index("Cz")] = value
    with np.errstate(invalid="ignore"):
        assert digest(features(epoch, OPERATOR, spatial)) == clean


def test_features_bits_dont_depend_on_the_number_of_threads() -> None:
    """Every size that a matrix library treats differently: vectors, small and large products, few and many outputs."""
    script = (
        "import numpy as np; from decoder.operator import digest, features; r = np.random.default_rng(0);"
        "print([digest(features(r.normal(size=(k, n)), r.normal(size=(k, w)), r.normal(size=(m, n)))) for k, n, w, m in"
        " [(2000, 64, 15, 64), (7625, 256, 15, 256), (2001, 31, 15, 31), (2000, 64, 1, 64), (9999, 1, 15, 1),"
        " (5000, 300, 1, 300), (2000, 64, 15, 2), (1999, 8, 40, 8), (3, 64, 15, 64)]])"
    )
    outputs = set()
    for n_threads in ("1", "2", "4"):
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": n_threads, "OMP_NUM_THREADS": n_threads}
        result = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, cwd=ROOT)
        assert result.returncode == 0, result.stderr.decode()
        outputs.add(result.stdout)
    assert len(outputs) == 1


@settings(max_examples=40, deadline=None)
@given(
    n_raw=st.integers(1, 3000),
    n_channels=st.integers(1, 260),
    n_windows=st.integers(1, 20),
    n_outputs=st.integers(1, 260),
)
def test_features_are_the_plain_products_at_any_size(
    n_raw: int, n_channels: int, n_windows: int, n_outputs: int
) -> None:
    rng = np.random.default_rng(n_raw)
    epoch, operator = rng.normal(size=(n_raw, n_channels)), rng.normal(size=(n_raw, n_windows))
    spatial = rng.normal(size=(n_outputs, n_channels))
    expected = (spatial @ (epoch.T @ operator)).reshape(-1)
    found = features(epoch, operator, spatial)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def moving_eyes(seconds: int, seed: int, offset_uv: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Synthetic EEG with a blink and a look aside every three seconds, and the two patterns, (64, 2)."""
    rng = np.random.default_rng(seed)
    where = directions(MONTAGE_64)
    aside = bump(where, (-0.7, 1.0, -0.4), 0.45) - bump(where, (0.7, 1.0, -0.4), 0.45)
    maps = np.stack([bump(where, (0.0, 1.0, -0.3), 0.6), aside], axis=1)
    samples = SyntheticBackground(seed).samples(0, seconds * 500)
    course = np.zeros((len(samples), 2))
    for begin in range(500, len(samples) - 1500, 1500):
        course[begin : begin + 150, 0] += rng.gamma(9, 11) * np.hanning(150)
        course[begin + 400 : begin + 700, 1] += rng.choice([-1, 1]) * rng.gamma(9, 5)
    return samples + course @ maps.T + offset_uv, maps


def test_eye_movements_are_taken_out() -> None:
    samples, maps = moving_eyes(120, seed=1)
    eyes = learn_eyes(samples, 500.0, MONTAGE_64)
    spatial = compose(N, range(N), eyes=ocular(eyes.weights, eyes.sources))
    assert np.abs(spatial @ maps).max() < 0.05
    assert np.abs(common_average(N) @ maps).max() > 0.5
    np.testing.assert_allclose(eyes.sources @ eyes.weights, np.eye(len(eyes.sources)), atol=1e-9)
    assert len(eyes.sources) in (2, 3)
    assert eyes.seconds > 10


def test_the_correction_does_not_depend_on_the_amplifiers_reference() -> None:
    samples, _ = moving_eyes(60, seed=2)
    shifted = samples - samples[:, [MONTAGE_64.index("Pz")]]
    corrected = []
    for variant in (samples, shifted):
        eyes = learn_eyes(variant, 500.0, MONTAGE_64)
        corrected.append(variant @ compose(N, range(N), eyes=ocular(eyes.weights, eyes.sources)).T)
    np.testing.assert_allclose(corrected[0], corrected[1], atol=1e-6)


def test_an_electrode_that_pops_is_not_learnt_from() -> None:
    samples, maps = moving_eyes(120, seed=3)
    samples[20_000:20_200, 5] += 50_000
    eyes = learn_eyes(samples, 500.0, MONTAGE_64)
    assert np.abs(compose(N, range(N), eyes=ocular(eyes.weights, eyes.sources)) @ maps).max() < 0.06


def test_eyes_at_rest_and_channels_that_dont_see_them_are_refused() -> None:
    rest = np.random.default_rng(4).normal(0, 10, (30_000, N))
    with pytest.raises(SetupError, match=r"0\.\d s of eye movements"):
        learn_eyes(rest, 500.0, MONTAGE_64)
    with pytest.raises(SetupError, match="EOG channels or from Fp1 and Fp2"):
        learn_eyes(rest[:, :3], 500.0, ("Cz", "Pz", "Oz"))
