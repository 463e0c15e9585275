"""Gaps: found where a sample is lost, and not called where chunks come late and nothing is missing."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decoder.timeline import MAX_JITTER, find_gap

SECONDS = 4.2
DRIFTS = (-1e-4, 0.0, 1e-4)
RATES = (128.0, 250.0, 256.0, 500.0, 1000.0, 2048.0)
BLOCKS = (1, 2, 5, 10, 16, 25, 32, 64)
Lateness = Callable[[np.random.Generator, int], np.ndarray]
LATE: dict[str, Lateness] = {
    "U(0, 1 ms)": lambda rng, n: rng.uniform(0, 0.001, n),
    "U(0, 2 ms)": lambda rng, n: rng.uniform(0, 0.002, n),
    "U(0, 5 ms)": lambda rng, n: rng.uniform(0, 0.005, n),
    "exp(1 ms)": lambda rng, n: rng.exponential(0.001, n).clip(0, 0.04),
    "exp(3 ms)": lambda rng, n: rng.exponential(0.003, n).clip(0, 0.04),
    "exp(10 ms)": lambda rng, n: rng.exponential(0.010, n).clip(0, 0.04),
}


def even(sfreq: float, drift: float = 0.0) -> np.ndarray:
    return 7e5 + np.arange(round(SECONDS * sfreq)) / sfreq * (1 + drift)


def late_blocks(rng: np.random.Generator, sfreq: float, block: int, late: Lateness) -> np.ndarray:
    """Even stamps within blocks, each block shifted late."""
    n_blocks = int(SECONDS * sfreq / block)
    last = (np.arange(n_blocks) + 1) * block / sfreq * (1 + rng.choice(DRIFTS)) + late(rng, n_blocks)
    return 7e5 + (last[:, None] - np.arange(block)[::-1] / sfreq).ravel()


def arrivals(rng: np.random.Generator, sfreq: float) -> np.ndarray:
    """Every 35 ms, give or take 1 ms, all samples that are there, stamped 10 us apart."""
    index = np.arange(round(SECONDS * sfreq))
    chunk = np.ceil((index + 1) / sfreq / 0.035).astype(int)
    arrival = np.arange(chunk[-1] + 1) * 0.035 * (1 + rng.choice(DRIFTS)) + rng.uniform(-0.001, 0.001, chunk[-1] + 1)
    return 7e5 + arrival[chunk] + (index - np.searchsorted(chunk, chunk)) * 1e-5


def without(rng: np.random.Generator, times: np.ndarray, sfreq: float, lost: int) -> np.ndarray:
    """`lost` samples dropped, at least 0.4 s from both ends."""
    first = rng.integers(int(0.4 * sfreq) + 1, len(times) - lost - int(0.4 * sfreq) - 1)
    return np.delete(times, np.arange(first, first + lost))


@pytest.mark.parametrize("sfreq", RATES)
@pytest.mark.parametrize("late", LATE)
def test_late_blocks_are_no_gap_and_a_loss_is(sfreq: float, late: str) -> None:
    rng = np.random.default_rng(0)
    for block in BLOCKS:
        streams = [late_blocks(rng, sfreq, block, LATE[late]) for _ in range(100)]
        assert sum(find_gap(times, sfreq) is not None for times in streams) <= 1, f"blocks of {block}"
        lossy = [without(rng, times, sfreq, max(5, block)) for times in streams]
        assert sum(find_gap(times, sfreq) is None for times in lossy) <= 1, f"blocks of {block}"


@pytest.mark.parametrize("sfreq", RATES)
def test_stamps_of_arrival_are_no_gap_and_a_lost_chunk_is(sfreq: float) -> None:
    rng = np.random.default_rng(0)
    streams = [arrivals(rng, sfreq) for _ in range(200)]
    assert sum(find_gap(times, sfreq) is not None for times in streams) <= 1
    lossy = [without(rng, times, sfreq, max(5, round(0.035 * sfreq))) for times in streams]
    assert sum(find_gap(times, sfreq) is None for times in lossy) == 0


@pytest.mark.trouble("pyxdf #137: clocks that drift by 40 ms in half an hour")
@settings(max_examples=300, deadline=None)
@given(sfreq=st.floats(50, 4096), drift=st.floats(-1e-4, 1e-4), place=st.floats(0, 1), doubled=st.booleans())
def test_one_sample_of_even_stamps_is_always_found(sfreq: float, drift: float, place: float, doubled: bool) -> None:
    times = even(sfreq, drift)
    assert find_gap(times, sfreq) is None
    first = 1 + round(place * (len(times) - 3))
    found = find_gap(np.insert(times, first, times[first - 1]) if doubled else np.delete(times, first), sfreq)
    assert found is not None
    assert found[0] == first
    assert found[1] == pytest.approx(-1 if doubled else 1, abs=0.01)


@settings(max_examples=200, deadline=None)
@given(
    sfreq=st.sampled_from(RATES),
    drift=st.floats(-1e-4, 1e-4),
    first=st.floats(0, 2.9),
    long=st.floats(0.002, 0.5),
    late=st.floats(0.0005, 0.035),
)
def test_a_chunk_that_is_late_and_catches_up_is_no_gap(
    sfreq: float, drift: float, first: float, long: float, late: float
) -> None:
    times = even(sfreq, drift)
    chunk = slice(1 + int(first * sfreq), 2 + int((first + long) * sfreq))
    times[chunk] += late
    assert find_gap(times, sfreq) is None


@pytest.mark.parametrize("beyond", [-1.1, 1.1])
def test_a_stamp_beyond_any_jitter_is_a_gap(beyond: float) -> None:
    times = even(500.0)
    times[1000:1010] += beyond * MAX_JITTER
    found = find_gap(times, 500.0)
    assert found is not None
    assert found[0] in (1000, 1010)


@settings(max_examples=200, deadline=None)
@given(n_times=st.integers(4, 400), block=st.integers(1, 20), seed=st.integers(0, 99))
def test_short_stretches_have_an_answer(n_times: int, block: int, seed: int) -> None:
    times = late_blocks(np.random.default_rng(seed), 250.0, block, LATE["exp(3 ms)"])[:n_times]
    found = find_gap(times, 250.0)
    assert found is None or (0 < found[0] < n_times and np.isfinite(found[1]))
    first = max(1, n_times // 2)
    found = find_gap(np.delete(np.arange(n_times + 1) / 250.0, first), 250.0)
    assert found == (first, pytest.approx(1))
