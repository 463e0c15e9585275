"""Classifier, cross-validation and its intervals."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.metrics import balanced_accuracy_score, roc_auc_score

from bci_app.config import ClassifierConfig
from bci_app.errors import SetupError
from decoder.calibration import auc, calibrate, contiguous_folds, permuted_accuracies, score, stratified_folds, wilson
from decoder.classifier import LinearClassifier, fit

CONFIG = ClassifierConfig(covariance="ledoit-wolf")


def two_classes(n: int = 300, n_features: int = 40, distance: float = 1.5, seed: int = 0):
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n) < 0.3 * n)
    features = rng.normal(0, 5, (n, n_features)) @ rng.normal(0, 1, (n_features, n_features))
    features += np.outer(error, features.std(axis=0) * distance * rng.normal(0, 1, n_features) / np.sqrt(n_features))
    return features, error


@pytest.mark.parametrize(("n", "n_features"), [(300, 40), (120, 200)])  # fewer epochs than features, as here, too
def test_weights_and_bias_are_scikit_learns(n: int, n_features: int) -> None:
    features, error = two_classes(n, n_features)
    features[:, 3] = 7.0  # a channel that never changes
    lda = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto", priors=[0.5, 0.5]).fit(features, error)
    classifier = fit(features, error, CONFIG)
    found = [classifier.log_odds(row) for row in features]
    np.testing.assert_allclose(found, lda.decision_function(features), rtol=1e-9, atol=1e-9)
    probability = lda.predict_proba(features)[:, 1]
    np.testing.assert_allclose(1 / (1 + np.exp(-np.array(found))), probability, atol=1e-9)


def test_a_prior_moves_only_the_balance_of_the_classes() -> None:
    features, error = two_classes()
    configs = [ClassifierConfig(covariance="ledoit-wolf", prior_error=prior) for prior in (0.1, 0.5, 0.9)]
    classifiers = [fit(features, error, config) for config in configs]
    flagged = [np.mean([classifier.log_odds(row) > 0 for row in features]) for classifier in classifiers]
    assert flagged == sorted(flagged)
    assert flagged[0] < flagged[2]


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3)), min_size=1, max_size=30), st.floats(-10, 10))
def test_log_odds_are_rounded_once(pairs: list[tuple[float, float]], bias: float) -> None:
    weights, values = np.array(pairs).T
    exact = sum((Fraction(product) for product in (weights * values).tolist()), Fraction(bias))
    assert LinearClassifier(weights, bias).log_odds(values) == float(exact)
    backwards = LinearClassifier(weights[::-1].copy(), bias).log_odds(values[::-1].copy())
    assert backwards == LinearClassifier(weights, bias).log_odds(values)


def test_scores_are_scikit_learns() -> None:
    rng = np.random.default_rng(1)
    error = rng.random(200) < 0.3
    log_odds = np.round(rng.normal(error * 1.0, 1), 1)  # rounded: ties
    scores = score(log_odds, error)
    assert scores.balanced_accuracy.value == pytest.approx(balanced_accuracy_score(error, log_odds > 0))
    assert scores.auc.value == pytest.approx(roc_auc_score(error, log_odds))
    assert scores.accuracy.value == pytest.approx(np.mean((log_odds > 0) == error))
    assert scores.n_error + scores.n_correct == 200
    for estimate in (scores.accuracy, scores.balanced_accuracy, scores.auc, scores.hit_rate):
        assert 0 <= estimate.low < estimate.value < estimate.high <= 1


def test_wilson_by_the_book() -> None:
    """Newcombe 1998 (Stat Med 17:857), table I: 81 of 263 and 0 of 20."""
    estimate = wilson(81, 263)
    assert (round(estimate.low, 4), round(estimate.high, 4)) == (0.2553, 0.3662)
    assert round(wilson(0, 20).high, 4) == 0.1611


def test_intervals_cover_the_truth() -> None:
    rng = np.random.default_rng(2)
    error = np.arange(200) < 60
    covered = np.zeros(2)
    for _ in range(400):
        log_odds = rng.normal(np.where(error, 0.7, -0.7), 1)
        area, balanced = auc(log_odds, error), score(log_odds, error).balanced_accuracy
        covered += [area.low < norm.cdf(1.4 / np.sqrt(2)) < area.high, balanced.low < norm.cdf(0.7) < balanced.high]
    assert (covered / 400 > 0.91).all()


def test_held_out_scores_are_honest_and_both_kinds_of_folds_cover_everything() -> None:
    features, error = two_classes(distance=2.0)
    calibration = calibrate(features, error, CONFIG)
    assert np.isfinite(calibration.tenfold_log_odds).all()
    assert np.isfinite(calibration.blocked_log_odds).all()
    assert calibration.tenfold.auc.value > 0.7
    for folds in (stratified_folds(error, CONFIG), contiguous_folds(error, CONFIG)):
        tested = np.concatenate([test for _, test in folds])
        np.testing.assert_array_equal(np.sort(tested), np.arange(len(error)))
        assert all(not np.intersect1d(train, test).size for train, test in folds)
    assert all(np.ptp(test) == len(test) - 1 for _, test in contiguous_folds(error, CONFIG))
    assert all(17 <= 0.3 * len(test) * 2 <= 19 for _, test in stratified_folds(error, CONFIG))


def test_no_features_no_verdicts() -> None:
    features, error = two_classes(distance=0.0)
    low, high = calibrate(features, error, CONFIG).tenfold.auc.low, calibrate(features, error, CONFIG).tenfold.auc.high
    assert low < 0.5 < high


def test_permuted_labels_are_at_chance() -> None:
    features, error = two_classes(distance=3.0)
    accuracies = permuted_accuracies(features, error, CONFIG, 10, np.random.default_rng(3))
    assert abs(accuracies.mean() - 0.5) < 0.04


def test_slow_drift_fools_shuffled_folds_but_not_contiguous_ones() -> None:
    """The reason for two kinds of folds: labels that come in runs, and features that merely drift."""
    rng = np.random.default_rng(4)
    error = np.repeat(rng.permutation(np.arange(30) < 10), 10)
    features = rng.normal(0, 1, (300, 20)).cumsum(axis=0)
    calibration = calibrate(features, error, CONFIG)
    assert calibration.tenfold.auc.value > calibration.blocked.auc.value + 0.1


def test_too_few_epochs_are_refused() -> None:
    features, error = two_classes(n=50)
    with pytest.raises(SetupError, match="at least 20 error epochs; this calibration has 15"):
        calibrate(features, error, CONFIG)
    with pytest.raises(SetupError, match="at least 10"):
        calibrate(features[:20], np.arange(20) < 5, ClassifierConfig(min_per_class=2))
    with pytest.raises(SetupError, match="one tenth of the recording"):
        contiguous_folds(np.arange(1000) < 50, CONFIG)
