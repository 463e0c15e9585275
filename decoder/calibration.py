"""From labelled features to a classifier and an honest account of how good it is (paper V.A.5)."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, rankdata

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.errors import SetupError
from decoder.classifier import LinearClassifier, fit

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]
Fold = tuple[NDArray[np.int64], NDArray[np.int64]]

Z95 = 1.959963984540054
"""97.5 % point of the normal distribution: half width of a 95 % interval in standard errors."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Scores:
    """How well held-out verdicts agree with the truth.

    Attributes
    ----------
    accuracy, hit_rate, correct_rejection_rate : shares of all, error and correct moves; Wilson intervals.
    balanced_accuracy : mean of the two rates; interval by MOVER from theirs (Zou & Donner 2008, doi:10.1002/sim.3095).
    auc : area under the ROC curve; DeLong interval (doi:10.2307/2531595).
    n_error, n_correct : epochs of each class.
    """

    accuracy: Estimate
    balanced_accuracy: Estimate
    auc: Estimate
    hit_rate: Estimate
    correct_rejection_rate: Estimate
    n_error: int
    n_correct: int

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration yields.

    Attributes
    ----------
    classifier : fitted on all epochs.
    tenfold, blocked : cross-validation over stratified shuffled folds, and over contiguous stretches of the recording.
        Neighbouring epochs resemble each other, so where the two differ believe the second.
    tenfold_log_odds, blocked_log_odds : float64, (n_epochs,), held-out, in the order of the epochs.
    """

    classifier: LinearClassifier
    tenfold: Scores
    blocked: Scores
    tenfold_log_odds: Array
    blocked_log_odds: Array


def calibrate(
    features: Array, error: Labels, config: ClassifierConfig, n_windows: int = ChainConfig().n_windows
) -> Calibration:
    """Cross-validate, then fit on all.

    Parameters
    ----------
    features : float64, (n_epochs, n_features), uV, in the order of recording.
    error : bool, (n_epochs,), True for error moves.
    n_windows : of each channel's features.

    Raises SetupError when a class has too few epochs.
    """
    check_counts(error, config)
    tenfold = held_out_log_odds(features, error, config, stratified_folds(error, config), n_windows)
    blocked = held_out_log_odds(features, error, config, contiguous_folds(error, config), n_windows)
    classifier = fit(features, error, config, n_windows)
    return Calibration(classifier, score(tenfold, error), score(blocked, error), tenfold, blocked)


def check_counts(error: Labels, config: ClassifierConfig) -> None:
    """Raises SetupError when a class has fewer epochs than the configuration, or the folds, ask for."""
    needed = max(config.min_per_class, config.n_folds)
    counts = {"error": int(error.sum()), "correct": int((~error).sum())}
    for name, found in counts.items():
        if found < needed:
            raise SetupError(
                f"A decoder needs at least {needed} {name} epochs; this calibration has {found} (of {len(error)}). "
                "Run more blocks, or look into why epochs were rejected."
            )


def stratified_folds(error: Labels, config: ClassifierConfig) -> list[Fold]:
    """Shuffled folds with the same share of errors: (training, test) indices."""
    from sklearn.model_selection import StratifiedKFold

    return list(StratifiedKFold(config.n_folds, shuffle=True, random_state=config.seed).split(error, error))


def contiguous_folds(error: Labels, config: ClassifierConfig) -> list[Fold]:
    """Contiguous stretches of the recording, nearly equally long: (training, test) indices."""
    everything = np.arange(len(error))
    folds = [(np.setdiff1d(everything, test), test) for test in np.array_split(everything, config.n_folds)]
    if any(min(error[train].sum(), (~error[train]).sum()) < 2 for train, _ in folds):
        raise SetupError(
            "All epochs of one class lie within one tenth of the recording, so contiguous folds can't be trained. "
            "Calibrate with errors spread over the blocks."
        )
    return folds


def held_out_log_odds(
    features: Array,
    error: Labels,
    config: ClassifierConfig,
    folds: Iterable[Fold],
    n_windows: int = ChainConfig().n_windows,
) -> Array:
    """Log odds of each epoch by a classifier that hasn't seen it; float64, (n_epochs,)."""
    log_odds = np.full(len(error), np.nan)
    for train, test in folds:
        classifier = fit(features[train], error[train], config, n_windows)
        log_odds[test] = [classifier.log_odds(row) for row in features[test]]
    return log_odds


def permuted_accuracies(
    features: Array,
    error: Labels,
    config: ClassifierConfig,
    n_permutations: int,
    rng: np.random.Generator,
    n_windows: int = ChainConfig().n_windows,
) -> Array:
    """Balanced accuracies of stratified cross-validation on shuffled labels: what chance looks like on these data."""
    accuracies = []
    for _ in range(n_permutations):
        shuffled = rng.permutation(error)
        log_odds = held_out_log_odds(features, shuffled, config, stratified_folds(shuffled, config), n_windows)
        accuracies.append(score(log_odds, shuffled).balanced_accuracy.value)
    return np.array(accuracies)


def score(log_odds: Array, error: Labels) -> Scores:
    """Compare verdicts (error where the log odds are above 0) with the truth."""
    said_error = log_odds > 0
    hit = wilson(int((said_error & error).sum()), int(error.sum()))
    rejection = wilson(int((~said_error & ~error).sum()), int((~error).sum()))
    return Scores(
        accuracy=wilson(int((said_error == error).sum()), len(error)),
        balanced_accuracy=_mean(hit, rejection),
        auc=auc(log_odds, error),
        hit_rate=hit,
        correct_rejection_rate=rejection,
        n_error=int(error.sum()),
        n_correct=int((~error).sum()),
    )


def wilson(k: int, n: int) -> Estimate:
    """A share k / n with Wilson's score interval (doi:10.1080/01621459.1927.10502953)."""
    low, high = binomtest(k, n).proportion_ci(method="wilson")
    return Estimate(k / n, float(low), float(high))


def auc(log_odds: Array, error: Labels) -> Estimate:
    """Area under the ROC curve, ties counted half, with DeLong's interval cut to [0, 1]."""
    of_errors, of_corrects = log_odds[error], log_odds[~error]
    m, n = len(of_errors), len(of_corrects)
    ranks = rankdata(np.concatenate((of_errors, of_corrects)))
    # Share of the other class that each epoch beats: its rank among all minus its rank among its own.
    beats = (ranks[:m] - rankdata(of_errors)) / n
    beaten = 1 - (ranks[m:] - rankdata(of_corrects)) / m
    value = float(beats.mean())
    half = Z95 * sqrt(beats.var(ddof=1) / m + beaten.var(ddof=1) / n)
    return Estimate(value, max(0.0, value - half), min(1.0, value + half))


def _mean(a: Estimate, b: Estimate) -> Estimate:
    value = (a.value + b.value) / 2
    below = sqrt((a.value - a.low) ** 2 + (b.value - b.low) ** 2) / 2
    above = sqrt((a.high - a.value) ** 2 + (b.high - b.value) ** 2) / 2
    return Estimate(value, value - below, value + above)
