"""Evidence: what theory says of Gaussian log odds is found, and what says nothing counts for nothing."""

from math import isfinite, log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm
from sklearn.linear_model import LogisticRegression

from decoder.evidence import EVIDENCE_LIMIT, Evidence, calibrate_evidence

seeds = st.integers(0, 2**32 - 1)


def gaussian(d: float, n_error: int, n_correct: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Log odds N(d/2, 1) on errors, N(-d/2, 1) on correct moves, in random order; the evidence in x is d * x."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n_error + n_correct) < n_error)
    return rng.normal(np.where(error, d / 2, -d / 2), 1), error


def information(d: float) -> float:
    """Bits one N(+-d/2, 1) observation tells about an even choice: 1 - E log2(1 + e^-L), L ~ N(d^2/2, d^2)."""
    return 1 - quad(lambda x: norm.pdf(x, d / 2) * np.logaddexp(0, -d * x) / log(2), d / 2 - 10, d / 2 + 10)[0]


@pytest.mark.parametrize("share", [0.5, 0.3, 0.7])
@pytest.mark.parametrize("d", [0.5, 1.0, 1.5, 2.5])
def test_gaussian_log_odds_give_the_slope_information_and_rates_of_theory(d: float, share: float) -> None:
    """Also with 3 errors to 7 correct moves: how often errors are is the policy's to know, not the verdict's."""
    n = 20_000
    found = calibrate_evidence(*gaussian(d, round(share * n), round((1 - share) * n), seed=1))
    assert found.slope == pytest.approx(d, rel=0.08)
    assert found.intercept == pytest.approx(0, abs=0.08)
    assert found.information == pytest.approx(information(d), abs=0.02)
    assert found.hit == pytest.approx(norm.cdf(d / 2), abs=0.02)
    assert found.correct_rejection == pytest.approx(norm.cdf(d / 2), abs=0.02)


def test_a_calibration_of_600_moves_comes_close_to_theory_without_bias() -> None:
    found = [calibrate_evidence(*gaussian(1.4, 180, 420, seed)) for seed in range(40)]
    assert np.mean([evidence.slope for evidence in found]) == pytest.approx(1.4, abs=0.08)
    assert np.mean([evidence.intercept for evidence in found]) == pytest.approx(0, abs=0.06)
    assert np.mean([evidence.information for evidence in found]) == pytest.approx(information(1.4), abs=0.02)


def test_the_line_is_scikit_learns() -> None:
    log_odds, error = gaussian(1.5, 60, 140, seed=2)
    weight, target = np.where(error, 0.5 / 60, 0.5 / 140), np.where(error, 61 / 62, 1 / 142)
    regression = LogisticRegression(C=np.inf, tol=1e-10, max_iter=1000)
    labels = np.repeat([True, False], len(error))
    weights = np.concatenate((weight * target, weight * (1 - target))) * len(error)
    regression.fit(np.tile(log_odds, 2)[:, None], labels, weights)
    found = calibrate_evidence(log_odds, error)
    assert found.slope == pytest.approx(regression.coef_.item(), rel=1e-5)
    assert found.intercept == pytest.approx(regression.intercept_.item(), abs=1e-5)


@settings(max_examples=30, deadline=None)
@given(seeds, st.floats(-6, 6), st.floats(-100, 100))
def test_neither_scale_nor_offset_of_the_log_odds_matters(seed: int, exponent: float, offset: float) -> None:
    log_odds, error = gaussian(1.5, 60, 140, seed)
    scale = 10**exponent
    there, here = calibrate_evidence(scale * (log_odds + offset), error), calibrate_evidence(log_odds, error)
    evidence = [here.of(value) for value in log_odds.tolist()]
    assert [there.of(scale * (value + offset)) for value in log_odds.tolist()] == pytest.approx(evidence, abs=1e-6)
    assert there.information == pytest.approx(here.information, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_shuffled_labels_tell_next_to_nothing(seed: int) -> None:
    log_odds, error = gaussian(2.0, 180, 420, seed)
    assert calibrate_evidence(log_odds, np.random.default_rng(seed).permutation(error)).information < 0.04


def test_at_chance_most_decoders_say_nothing_at_all() -> None:
    found = [calibrate_evidence(*gaussian(0.0, 180, 420, seed)) for seed in range(40)]
    assert np.mean([evidence.slope == 0 for evidence in found]) > 0.7
    assert all((evidence.slope == 0) == (evidence.information == 0) for evidence in found)


@settings(max_examples=30, deadline=None)
@given(seeds, st.floats(0.5, 4))
def test_anti_correlated_log_odds_say_nothing(seed: int, d: float) -> None:
    log_odds, error = gaussian(-d, 60, 140, seed)
    found = calibrate_evidence(log_odds, error)
    assert (found.slope, found.intercept, found.information) == (0, 0, 0)


@given(st.floats(-1e6, 1e6), st.integers(2, 200), st.integers(2, 200))
def test_a_dead_decoder_says_nothing(log_odds: float, n_error: int, n_correct: int) -> None:
    error = np.arange(n_error + n_correct) < n_error
    found = calibrate_evidence(np.full(len(error), log_odds), error)
    assert (found.slope, found.intercept, found.information) == (0, 0, 0)
    assert found.of(log_odds) == 0


@settings(max_examples=30, deadline=None)
@given(seeds, st.floats(0.01, 1e6))
def test_separable_log_odds_say_much_but_not_everything(seed: int, gap: float) -> None:
    log_odds, error = gaussian(0.0, 180, 420, seed)
    log_odds = np.where(error, gap + abs(log_odds), -gap - abs(log_odds))
    found = calibrate_evidence(log_odds, error)
    assert 0 < found.slope < 1e4
    assert 0.9 < found.information <= 1
    assert (found.hit, found.correct_rejection) == (180.5 / 181, 420.5 / 421)
    assert max(abs(found.of(value)) for value in log_odds.tolist()) <= EVIDENCE_LIMIT


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20), st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20))
def test_whatever_the_log_odds_evidence_is_finite_bounded_and_rises(errors: list[float], corrects: list[float]) -> None:
    error = np.arange(len(errors) + len(corrects)) < len(errors)
    found = calibrate_evidence(np.array(errors + corrects), error)
    assert isfinite(found.slope)
    assert isfinite(found.intercept)
    assert found.slope >= 0
    assert 0 <= found.information <= 1
    assert 0 < found.hit < 1
    assert 0 < found.correct_rejection < 1
    evidence = [found.of(value) for value in sorted(errors + corrects)]
    assert evidence == sorted(evidence)
    assert max(map(abs, evidence)) <= EVIDENCE_LIMIT


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_no_log_odds_say_more_than_the_limit(log_odds: float) -> None:
    assert abs(Evidence(2.0, 0.5, 0.7, 0.7, 0.2).of(log_odds)) <= EVIDENCE_LIMIT
