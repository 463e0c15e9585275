"""Reliability: probabilities that are true are found true, and a session lies where it was said to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit, logit

from decoder.reliability import overdispersion, predict_session, reliability

seeds = st.integers(0, 2**32 - 1)


def moves(n: int, seed: int, share: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian evidence, true log-likelihood ratios: N(+-1, 2) in natural log."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n) < share * n)
    return rng.normal(np.where(error, 1.0, -1.0), np.sqrt(2)), error


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_true_log_likelihood_ratios_are_reliable_whatever_the_share_of_errors(share: float) -> None:
    found = reliability(*moves(20_000, 1, share))
    assert found.ece < 0.012
    assert found.ece < 3 * found.ece_by_chance
    assert found.brier < found.brier_uninformed == pytest.approx(share * (1 - share))


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_evidence_that_claims_too_much_or_too_little_is_not(factor: float) -> None:
    evidence, error = moves(20_000, 2)
    found = reliability(factor * evidence, error)
    assert found.ece > 0.05 > 3 * found.ece_by_chance
    assert found.brier > reliability(evidence, error).brier


def test_by_hand() -> None:
    probability = np.array([0.12, 0.18, 0.71, 0.79])
    error = np.array([False, True, True, False])
    found = reliability(logit(probability), error)  # half are errors, so evidence is the log odds
    assert [(round(point.said, 9), point.happened, point.n) for point in found.bins] == [(0.15, 0.5, 2), (0.75, 0.5, 2)]
    assert found.ece == pytest.approx((0.35 * 2 + 0.25 * 2) / 4)
    assert found.brier == pytest.approx(np.mean([0.12**2, 0.82**2, 0.29**2, 0.79**2]))


@given(st.lists(st.tuples(st.floats(-10, 10), st.booleans()), min_size=2, max_size=40))
def test_bins_hold_every_move_and_figures_are_shares(pairs: list[tuple[float, bool]]) -> None:
    evidence, error = np.array([value for value, _ in pairs]), np.array([wrong for _, wrong in pairs])
    error[:2] = True, False
    found = reliability(evidence, error)
    assert sum(point.n for point in found.bins) == len(error)
    assert sum(point.n * point.happened for point in found.bins) == pytest.approx(error.sum())
    assert [point.said for point in found.bins] == sorted(point.said for point in found.bins)
    assert 0 <= found.ece <= 1
    assert 0 <= found.brier <= 1


def test_chance_alone_gives_the_ece_that_is_said() -> None:
    """Labels drawn from the probabilities themselves: the ECE of few moves isn't 0, and that is told."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(100):
        evidence = rng.normal(0, 1.5, 200)
        error = rng.random(200) < expit(evidence)
        found.append(reliability(evidence - logit(error.mean()), error))
    measured, said = np.mean([one.ece for one in found]), np.mean([one.ece_by_chance for one in found])
    assert measured == pytest.approx(said, rel=0.08)


@pytest.mark.parametrize(("n", "m"), [(600, 200), (240, 400)])
def test_the_interval_holds_the_session_nineteen_times_in_twenty(n: int, m: int) -> None:
    rng = np.random.default_rng(4)
    covered, by_calibration_alone = np.zeros(2), 0
    for _ in range(300):
        truth, session = rng.random(n) < 0.3, rng.random(m) < 0.3
        right, later = rng.random(n) < np.where(truth, 0.68, 0.8), rng.random(m) < np.where(session, 0.68, 0.8)
        found = predict_session(right, truth, np.array_split(np.arange(n), 10), m, 0.3)
        balanced = (later[session].mean() + later[~session].mean()) / 2
        for place, (interval, value) in enumerate(
            ((found.accuracy, later.mean()), (found.balanced_accuracy, balanced))
        ):
            covered[place] += interval.low <= value <= interval.high
        half = 1.96 * np.sqrt(right.mean() * (1 - right.mean()) / n)
        by_calibration_alone += abs(later.mean() - right.mean()) < half
    assert (covered / 300 > 0.92).all()
    assert by_calibration_alone / 300 < 0.9  # why a prediction interval


def test_stretches_that_differ_widen_the_interval() -> None:
    rng = np.random.default_rng(5)
    error = np.tile(np.arange(10) < 3, 60)
    stretches = np.array_split(np.arange(600), 10)
    steady = rng.random(600) < 0.75
    wavering = rng.random(600) < np.repeat(np.tile([0.95, 0.55], 5), 60)
    assert overdispersion(wavering, error, stretches) > 5 > overdispersion(steady, error, stretches)
    widths = [
        found.high - found.low
        for found in (predict_session(right, error, stretches, 200, 0.3).accuracy for right in (steady, wavering))
    ]
    assert widths[1] > 2 * widths[0]


@settings(max_examples=50)
@given(seeds, st.floats(0, 1), st.integers(1, 1000), st.floats(0.01, 0.99))
def test_intervals_are_shares_around_their_value(seed: int, rate: float, n_moves: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    error = np.arange(60) % 3 == 0
    found = predict_session(rng.random(60) < rate, error, np.array_split(np.arange(60), 10), n_moves, share)
    for interval in (found.accuracy, found.balanced_accuracy):
        assert 0 <= interval.low < interval.value < interval.high <= 1
    assert found.spread >= 1
