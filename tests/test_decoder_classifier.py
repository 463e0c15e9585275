"""The separable discriminant against brute force, and estimators of one's own."""

import sys
from types import ModuleType

import numpy as np
import pytest
from scipy import linalg
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.linear_model import LinearRegression, LogisticRegression, RidgeClassifier
from sklearn.svm import SVC

from bci_app.config import ClassifierConfig
from bci_app.errors import SetupError
from decoder.calibration import contiguous_folds, held_out_log_odds, score
from decoder.classifier import fit
from decoder.separable import SHRINKAGE, separable_covariance, separable_weights, without_chance

PAPER = ClassifierConfig(covariance="ledoit-wolf")
SEPARABLE = ClassifierConfig(covariance="separable")


def separable_noise(n: int, n_channels: int, n_windows: int, seed: int = 0):
    """Epochs, and the covariances over channels and windows that they have."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(0, 1, (n_channels, n_channels))
    slow = linalg.toeplitz(0.8 ** np.arange(n_windows))
    epochs = mixing @ rng.normal(0, 1, (n, n_channels, n_windows)) @ np.linalg.cholesky(slow).T
    return epochs, mixing @ mixing.T, slow


def two_classes(n: int = 200, n_channels: int = 16, n_windows: int = 15, seed: int = 1, size: float = 1.5):
    epochs, _, _ = separable_noise(n, n_channels, n_windows, seed)
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n) < 0.3 * n)
    epochs += error[:, None, None] * np.outer(rng.normal(0, size, n_channels), np.hanning(n_windows))
    return epochs.reshape(n, -1), error


def shrunk(covariance):
    mean_variance = np.trace(covariance) / len(covariance)
    return (1 - SHRINKAGE) * covariance + SHRINKAGE * mean_variance * np.eye(len(covariance))


def test_covariance_is_the_brute_force_one() -> None:
    epochs, _, _ = separable_noise(40, 5, 4)
    of_windows = np.eye(4)
    for _ in range(3):
        inverse = np.linalg.inv(of_windows)
        of_channels = shrunk(sum(epoch @ inverse @ epoch.T for epoch in epochs) / (40 * 4))
        inverse = np.linalg.inv(of_channels)
        of_windows = shrunk(sum(epoch.T @ inverse @ epoch for epoch in epochs) / (40 * 5))
        of_windows *= 4 / np.trace(of_windows)
    found = separable_covariance(epochs)
    np.testing.assert_allclose(found[0], of_channels, rtol=1e-10)
    np.testing.assert_allclose(found[1], of_windows, rtol=1e-10)


def test_covariance_finds_the_truth() -> None:
    epochs, of_channels, of_windows = separable_noise(5000, 5, 4)
    found = np.kron(*separable_covariance(epochs))
    truth = np.kron(of_channels, of_windows)
    assert np.abs(found - truth).max() < 0.05 * np.abs(truth).max()


def test_weights_are_those_of_the_whole_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the means' difference left as it is, LDA by the book: inverse covariance times difference."""
    monkeypatch.setattr("decoder.separable.without_chance", lambda matrix, noise: matrix)
    features, error = two_classes(n_channels=5, n_windows=4)
    means = features[~error].mean(axis=0), features[error].mean(axis=0)
    residuals = np.concatenate([features[~error] - means[0], features[error] - means[1]]).reshape(-1, 5, 4)
    weights = np.linalg.solve(np.kron(*separable_covariance(residuals)), means[1] - means[0])
    np.testing.assert_allclose(separable_weights(features[~error], features[error], 4), weights, rtol=1e-9)
    classifier = fit(features, error, ClassifierConfig(covariance="separable", prior_error=0.2), 4)
    assert classifier.bias == pytest.approx(-weights @ (means[0] + means[1]) / 2 + np.log(0.2 / 0.8))


@pytest.mark.parametrize("shape", [(64, 15), (3, 15)])
def test_chance_is_taken_out_of_means(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    truth = 3 * np.outer(rng.normal(0, 1, shape[0]), rng.normal(0, 1, shape[1]))
    seen = truth + rng.normal(0, 1, shape)
    found = without_chance(seen, 1.0)
    assert np.linalg.matrix_rank(found) == 1
    assert np.square(found - truth).sum() < 0.5 * np.square(seen - truth).sum()


def test_means_of_nothing_but_chance_stay() -> None:
    noise = np.random.default_rng(0).normal(0, 0.8, (64, 15))
    assert without_chance(noise, 1.0) is noise


def test_few_epochs_suffice_where_noise_is_separable() -> None:
    features, error = two_classes(n=120, size=0.4)
    accuracy = {}
    for config in (SEPARABLE, PAPER):
        log_odds = held_out_log_odds(features, error, config, contiguous_folds(error, config), 15)
        accuracy[config.covariance] = score(log_odds, error).balanced_accuracy.value
    assert accuracy["separable"] > accuracy["ledoit-wolf"] + 0.05


def test_dead_channels_and_common_averages_are_survived() -> None:
    features, error = two_classes()
    grid = features.reshape(-1, 16, 15)
    grid[:, 3] = 0.0
    grid -= grid.mean(axis=1, keepdims=True)
    assert np.isfinite(fit(features, error, SEPARABLE, 15).weights).all()
    assert not fit(np.zeros_like(features), error, SEPARABLE, 15).weights.any()


def test_the_same_epochs_give_the_same_bits() -> None:
    features, error = two_classes()
    first, second = fit(features, error, SEPARABLE, 15), fit(features.copy(), error.copy(), SEPARABLE, 15)
    assert first.weights.tobytes() == second.weights.tobytes()
    assert first.bias == second.bias


def test_features_that_are_no_windows_of_channels_are_refused() -> None:
    features, error = two_classes()
    with pytest.raises(SetupError, match="7 windows of each channel, found 240"):
        fit(features, error, SEPARABLE, 7)
    fit(features, error, PAPER, 7)


class Squared(ClassifierMixin, BaseEstimator):
    """A classifier of more weights than features."""

    def fit(self, features, error):
        fitted = LogisticRegression(C=1e-6).fit(np.hstack([features, features**2]), error)
        self.coef_, self.intercept_ = fitted.coef_, fitted.intercept_
        return self


class Endless(ClassifierMixin, BaseEstimator):
    """A classifier that fails."""

    def fit(self, features, error):
        self.coef_, self.intercept_ = np.full((1, features.shape[1]), np.nan), np.zeros(1)
        return self


@pytest.fixture
def laboratory(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("laboratory")
    module.logistic = lambda: LogisticRegression(C=0.01, class_weight="balanced", max_iter=500)
    module.ridge, module.squared, module.endless, module.svm = RidgeClassifier, Squared, Endless, SVC
    module.regression = LinearRegression
    module.number, module.nothing, module.needs = 5, dict, lambda strength: LogisticRegression(C=strength)
    monkeypatch.setitem(sys.modules, "laboratory", module)


@pytest.mark.usefixtures("laboratory")
def test_an_estimator_of_ones_own_is_fitted_and_cross_validated() -> None:
    features, error = two_classes()
    config = ClassifierConfig(estimator="laboratory:logistic")
    classifier = fit(features, error, config)
    direct = LogisticRegression(C=0.01, class_weight="balanced", max_iter=500).fit(features, error)
    found = [classifier.log_odds(row) for row in features]
    np.testing.assert_allclose(found, direct.decision_function(features), rtol=1e-9, atol=1e-12)
    log_odds = held_out_log_odds(features, error, config, contiguous_folds(error, config))
    assert score(log_odds, error).auc.value > 0.7
    assert fit(features, error, ClassifierConfig(estimator="laboratory:ridge")).weights.shape == (240,)


@pytest.mark.usefixtures("laboratory")
@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("laboratory", "should be module:factory"),
        ("laboratory:", "should be module:factory"),
        ("laboratorium:logistic", "Can't import the module"),
        ("laboratory:logistics", "has no 'logistics'"),
        ("laboratory:number", "can't be made by a call without arguments"),
        ("laboratory:needs", "can't be made by a call without arguments"),
        ("laboratory:nothing", "gives a dict, which has no fit"),
        ("laboratory:regression", "a LinearRegression, which is no classifier"),
        ("laboratory:svm", "a SVC without coef_ and intercept_"),
        ("laboratory:squared", r"one weight for each of 240 features .* \(1, 480\)"),
        ("laboratory:endless", "not finite"),
    ],
)
def test_what_is_no_linear_estimator_is_refused(name: str, complaint: str) -> None:
    features, error = two_classes()
    with pytest.raises(SetupError, match=complaint):
        fit(features, error, ClassifierConfig(estimator=name))
