"""Drift: a shifted or shrunk decoder is found out without the truth, an unusual share of errors is none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decoder.drift import N_WINDOW, Drift, DriftWatch, compare

seeds = st.integers(0, 2**32 - 1)


def log_odds(n: int, share: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    error = rng.permutation(np.arange(n) < round(share * n))
    return rng.normal(np.where(error, 1.5, -1.5), 2), error


def last(values: np.ndarray, watch: DriftWatch) -> Drift:
    found = [watch.hear(value) for value in values.tolist()]
    assert found[-1] is not None
    return found[-1]


def test_no_share_of_errors_is_drift() -> None:
    """Of 1000 windows with shares from 2 to 60 %; in 8000 one was found, and a run has many looks (`LIMIT`)."""
    n_found = 0
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        share = rng.uniform(0.02, 0.6)
        watch = DriftWatch(*log_odds(600, 0.3, rng))
        found = last(log_odds(N_WINDOW, share, rng)[0], watch)
        n_found += found.is_drift
        assert abs(found.error_share - share) < 0.4
    assert n_found <= 2


@settings(max_examples=20, deadline=None)
@given(seeds, st.sampled_from([(-5.0, 1.0), (5.0, 1.0), (0.0, 0.25), (0.0, 4.0)]))
def test_shift_and_spread_are_found_out_and_told(seed: int, change: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    watch = DriftWatch(*log_odds(600, 0.3, rng))
    shift, factor = change
    found = last(shift + factor * log_odds(N_WINDOW, 0.3, rng)[0], watch)
    assert found.is_drift
    if shift:
        assert np.sign(found.shift) == np.sign(shift)
    else:
        assert (found.spread > 1) == (factor > 1)


def test_nothing_is_said_before_the_window_is_full_and_the_oldest_are_forgotten() -> None:
    rng = np.random.default_rng(1)
    watch = DriftWatch(*log_odds(600, 0.3, rng))
    strange = [watch.hear(20.0) for _ in range(N_WINDOW)]
    assert strange[:-1] == [None] * (N_WINDOW - 1)
    assert strange[-1] is not None
    assert strange[-1].is_drift
    assert not last(log_odds(N_WINDOW, 0.3, rng)[0], watch).is_drift


def test_by_hand() -> None:
    found = compare(np.array([1.5, 3.0]), np.array([1.0, 2.0]), np.array([-2.0, -1.0]))
    # The mixture of 0.6 errors has 0.7 at or below 1, where no log odds lie; its mean is 0.3, its mean square 2.5.
    assert (found.n, found.error_share) == (2, 0.6)
    assert found.distance == pytest.approx(0.7 * np.sqrt(2 * 4 / 6))
    assert found.shift == pytest.approx((2.25 - 0.3) / np.sqrt(2.5 - 0.09))
    assert found.spread == pytest.approx(0.75 / np.sqrt(2.5 - 0.09))
    assert "its last 2 log odds" in found.sentence
    assert "+1.3 standard deviations" in found.sentence


def test_a_decoder_that_always_says_the_same_has_not_drifted() -> None:
    watch = DriftWatch(np.zeros(600), np.arange(600) < 180)
    assert not last(np.zeros(N_WINDOW), watch).is_drift
