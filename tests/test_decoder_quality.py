"""Faults of channels are found and named; what is the person's or the room's is nobody's fault."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyxdf
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d

from bci_app.errors import SetupError
from decoder.background import SyntheticBackground, bump, read_background
from decoder.montage import MONTAGE_64, directions
from decoder.quality import Inspector

SFREQ = 250.0
SECONDS = np.arange(2500) / SFREQ
FZ, CZ, T8, PZ, OZ = (MONTAGE_64.index(name) for name in ("Fz", "Cz", "T8", "Pz", "Oz"))


@pytest.fixture(scope="module")
def head() -> np.ndarray:
    """Ten seconds of 64 good channels."""
    return SyntheticBackground(7, SFREQ).samples(1000, 2500)


@pytest.fixture(scope="module")
def inspector() -> Inspector:
    return Inspector(MONTAGE_64, SFREQ)


def bad(inspector: Inspector, samples: np.ndarray) -> dict[str, tuple[str, ...]]:
    return {quality.name: quality.faults for quality in inspector.inspect(samples) if quality.is_bad}


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(2500)


def pops(x: np.ndarray) -> np.ndarray:
    return x + 300 * (SECONDS > 2.3) - 250 * (SECONDS > 6.1) * np.exp(-(SECONDS - 6.1))


def now_and_then(x: np.ndarray, value: float, n_samples: int) -> np.ndarray:
    x = x.copy()
    for first in (300, 1200, 2100):
        x[first : first + n_samples] = value
    return x


KINDS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "flat": ("flat", lambda x: np.full_like(x, x[0])),
    "amplifier noise": ("flat", lambda x: x[0] + 0.4 * noise()),
    "off for 3 s": ("flat", lambda x: np.where((SECONDS >= 3) & (SECONDS < 6), x[0], x)),
    "railed": ("railed", lambda x: np.full_like(x, 187_500.0)),
    "railed now and then": ("railed", lambda x: now_and_then(x, 2000.0 + x.max(), 40)),
    "clipped at the middle of its range": ("railed", lambda x: np.clip(x, *np.quantile(x, (0.1, 0.9)))),
    "one NaN": ("not finite", lambda x: np.where(SECONDS == 4, np.nan, x)),
    "infinite": ("not finite", lambda x: now_and_then(x, -np.inf, 2)),
    "infinite both ways": ("not finite", lambda x: now_and_then(now_and_then(x, -np.inf, 2), np.inf, 1)),
    "no voltage": ("too large", lambda x: x + 1e30),
    "drift": ("drifting", lambda x: x + 60 * SECONDS),
    "pops": ("jumping", pops),
    "line noise": ("line noise", lambda x: x + 40 * np.sin(2 * np.pi * 50.05 * SECONDS)),
    "line noise overseas": ("line noise", lambda x: x + 40 * np.sin(2 * np.pi * 59.95 * SECONDS)),
    "a harmonic": ("line noise", lambda x: x + 40 * np.sin(2 * np.pi * 100 * SECONDS)),
    "broadband noise": ("noisy", lambda x: x + 10 * noise()),
    "floating": ("unrelated", lambda x: x[0] + np.fft.irfft(np.fft.rfft(10 * noise()) / np.r_[1:1252] ** 0.3, 2500)),
    "ten times": ("too large", lambda x: 10 * x),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("channel", [CZ, T8, OZ])
def test_a_fault_is_found_by_name_in_its_channel_only(
    inspector: Inspector, head: np.ndarray, kind: str, channel: int
) -> None:
    fault, put = KINDS[kind]
    samples = head.copy()
    samples[:, channel] = put(head[:, channel])
    found = bad(inspector, samples)
    assert set(found) == {MONTAGE_64[channel]}
    assert fault in found[MONTAGE_64[channel]]


def test_a_tenth_of_the_gain_is_too_little(inspector: Inspector, head: np.ndarray) -> None:
    # A tenth of this quiet person's EEG would be less than an amplifier's noise; six times its drifts would be faults.
    samples = 6 * (head - uniform_filter1d(head, 250, axis=0))
    samples[:, CZ] /= 10
    assert bad(inspector, samples) == {"Cz": ("too small",)}


def test_good_channels_are_good(inspector: Inspector, head: np.ndarray) -> None:
    qualities = inspector.inspect(head)
    assert not any(quality.is_bad for quality in qualities)
    assert [quality.name for quality in qualities] == list(MONTAGE_64)
    assert all(quality.ratio and 0.5 < quality.ratio < 2 for quality in qualities)


def test_what_a_person_and_a_room_do_is_nobodys_fault(inspector: Inspector, head: np.ndarray) -> None:
    """Blinks of 300 uV, alpha of 30 uV, a jaw on one side, 15 uV of 60 Hz everywhere, a reference that is pulled."""
    where, rng = directions(MONTAGE_64), np.random.default_rng(1)
    blinks = sum(np.exp(-(((SECONDS - at) / 0.08) ** 2)) for at in (1.2, 3.3, 3.9, 8.0))
    samples = head + 300 * blinks[:, None] * bump(where, (0, 1, -0.3), 0.6)
    samples += 30 * np.sqrt(2) * np.sin(2 * np.pi * 10 * SECONDS)[:, None] * bump(where, (0, -1, 0.3), 0.5)
    samples += 8 * noise()[:, None] * bump(where, (1, 0.2, 0), 0.5)
    samples += rng.uniform(5, 25, 64) * np.sqrt(2) * np.sin(2 * np.pi * 60 * SECONDS)[:, None]
    samples += 400 * (SECONDS > 5)[:, None]
    assert not bad(inspector, samples)


def test_a_bad_channel_is_no_measure_for_its_neighbours(inspector: Inspector, head: np.ndarray) -> None:
    """Five around Cz with all kinds of faults: they are found, and Cz stays good."""
    samples = head.copy()
    around = [MONTAGE_64.index(name) for name in ("FCz", "C1", "C2", "CPz", "FC1")]
    kinds = ("flat", "ten times", "broadband noise", "one NaN", "line noise")
    for channel, kind in zip(around, kinds, strict=True):
        samples[:, channel] = KINDS[kind][1](head[:, channel])
    assert set(bad(inspector, samples)) == {MONTAGE_64[channel] for channel in around}


@pytest.mark.parametrize("kind", ["flat", "railed", "one NaN", "no voltage"])
def test_all_channels_may_be_bad(inspector: Inspector, head: np.ndarray, kind: str) -> None:
    fault, put = KINDS[kind]
    qualities = inspector.inspect(np.stack([put(course) for course in head.T], axis=1))
    assert all(quality.faults == (fault,) for quality in qualities)
    assert all(quality.ratio is None for quality in qualities)


def test_a_fault_of_all_channels_is_the_rooms_unless_no_eeg_can_be_so(inspector: Inspector, head: np.ndarray) -> None:
    line = np.sin(2 * np.pi * 50 * SECONDS)[:, None]
    assert not bad(inspector, head + 60 * line)
    assert set(bad(inspector, head + 200 * line)) == set(MONTAGE_64)


def test_places_may_be_unknown(head: np.ndarray) -> None:
    samples = head.copy()
    samples[:, CZ] = KINDS["floating"][1](head[:, CZ])
    samples[:, PZ] = KINDS["broadband noise"][1](head[:, PZ])
    nameless = Inspector([f"E{number}" for number in range(64)], SFREQ)
    assert set(bad(nameless, samples)) == {f"E{CZ}", f"E{PZ}"}
    some = Inspector([name if number % 3 else f"E{number}" for number, name in enumerate(MONTAGE_64)], SFREQ)
    assert len(bad(some, samples)) == 2


@pytest.mark.parametrize("n_channels", [1, 3, 4, 8, 9, 16])
def test_few_channels(head: np.ndarray, n_channels: int) -> None:
    picks = np.linspace(0, 63, n_channels).astype(int)
    inspector = Inspector([MONTAGE_64[pick] for pick in picks], SFREQ)
    samples = head[:, picks].copy()
    assert not bad(inspector, samples)
    samples[:, 0] = samples[0, 0]
    assert set(bad(inspector, samples)) == {inspector.channels[0]}


@settings(max_examples=25, deadline=None)
@given(
    sfreq=st.sampled_from([128.0, 160.0, 250.0, 256.0, 499.7, 500.0, 512.0, 1000.0, 2000.0, 2048.0]),
    seconds=st.floats(4.2, 14),
    single=st.booleans(),
    kind=st.sampled_from(["flat", "nan", "noise", "none"]),
)
def test_any_rate_and_length(sfreq: float, seconds: float, single: bool, kind: str) -> None:
    n_times = int(seconds * sfreq)
    rng = np.random.default_rng(n_times)
    # Twelve mixtures of three sources, offsets of millivolts.
    sources = np.cumsum(rng.standard_normal((n_times, 3)), axis=0) * 50 / np.sqrt(sfreq)
    mixing = 0.8 + 0.4 * rng.random((3, 12))
    samples = sources @ mixing + rng.normal(0, 5000, 12) + 0.3 * rng.standard_normal((n_times, 12))
    if kind == "flat":
        samples[:, 4] = 12.5
    elif kind == "nan":
        samples[n_times - 17, 4] = np.nan
    elif kind == "noise":
        samples[:, 4] += 8 * np.sqrt(sfreq) * rng.standard_normal(n_times)
    inspector = Inspector([f"E{number}" for number in range(12)], sfreq)
    given_samples = samples.astype(np.float32) if single else samples
    before = given_samples.copy()
    first, again = inspector.inspect(given_samples), inspector.inspect(given_samples)
    assert first == again
    np.testing.assert_array_equal(given_samples, before)
    assert {quality.name for quality in first if quality.is_bad} == (set() if kind == "none" else {"E4"})


def test_what_is_asked_wrongly_is_refused(inspector: Inspector, head: np.ndarray) -> None:
    assert inspector.n_least == 1000
    inspector.inspect(head[:1000])
    with pytest.raises(SetupError, match=r"1000 samples \(4 s\), found 999"):
        inspector.inspect(head[:999])
    with pytest.raises(SetupError, match="64 channels"):
        inspector.inspect(head[:, :63])
    with pytest.raises(SetupError, match="90 Hz"):
        Inspector(MONTAGE_64, 90.0)


def test_only_the_newest_whole_seconds_count(inspector: Inspector, head: np.ndarray) -> None:
    longer = np.concatenate([np.full((100, 64), np.nan), head])
    assert inspector.inspect(longer) == inspector.inspect(head)


def test_real_eeg_is_good_and_a_floating_channel_in_it_is_not(data: Path) -> None:
    background = read_background(data / "eegmmidb_s001" / "S001R04.edf", SFREQ)
    inspector = Inspector(background.names, SFREQ)
    samples = background.samples(5000, 2500)
    assert not bad(inspector, samples)
    samples[:, 10] = 30 * noise()
    assert set(bad(inspector, samples)) == {background.names[10]}


def test_line_noise_that_others_recorded_without_knowing(data: Path) -> None:
    """In two recordings of bci-essentials FC3, C3 and F4 carry 20 to 90 uV of 60 Hz; the others have 2."""
    for name in ("sub-P001_ses-S001_task-P300Checkboard_run-001_eeg.xdf", "switch_example.xdf"):
        streams, _ = pyxdf.load_xdf(data / "xdf" / name)
        eeg = next(stream for stream in streams if stream["info"]["type"][0] == "EEG")
        names = [channel["label"][0] for channel in eeg["info"]["desc"][0]["channels"][0]["channel"]]
        found = bad(Inspector(names, 256.0), eeg["time_series"][2560:5120])
        assert found == dict.fromkeys(("F4", "FC3", "C3"), ("line noise",))
