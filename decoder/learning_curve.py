"""Whether more calibration would make a decoder better: its learning curve, from the labelled features so far."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bci_app.config import ClassifierConfig
from decoder.calibration import Z95, Estimate, contiguous_folds
from decoder.classifier import fit

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

EPOCHS = 100.0
"""Typical cost of learning the weights, in epochs: the constant of `separation_at`. Decoders of 20 simulated people on
120 to 600 moves fit it best with 50 (measured by `benchmarks/decoder_calibration_length.py`), the paper's shrinkage LDA
with 350; twice the former is taken, for real EEG is harder to learn than made-up EEG (decided)."""
LOG_SD = 0.8
"""How much a participant's own constant differs from the typical one: standard deviation of its natural log (decided).
"""
SCATTER = 0.01
"""How far the gain of a single decoder lies from that of its curve, standard deviation of balanced accuracy (decided:
0.9 points after 120 moves and 0.2 later, measured by `benchmarks/decoder_calibration_length.py`)."""
PARTS = (0.5, 1.0)
"""Shares of the training epochs that the curve is measured at (decided)."""
N_FOLDS = 5
"""Contiguous stretches, each left out once (decided: half of what the final figures take, for the person waits)."""


@dataclass(frozen=True)
class Point:
    """Held-out verdicts of decoders trained on `n_train` epochs.

    `separation` is the distance of the two classes' mean log odds in standard deviations within a class, `error` its
    standard error.
    """

    n_train: int
    separation: float
    error: float


@dataclass(frozen=True)
class Outlook:
    """What a decoder is worth now, and what more calibration would make of it.

    Attributes
    ----------
    n_epochs, balanced_accuracy : of a decoder fitted on all epochs so far.
    next_gain, total_gain : points of balanced accuracy (0.01 is one) gained by the next block, and by all that are
        left; 0 when none is.
    points : of the curve as measured.
    """

    n_epochs: int
    balanced_accuracy: Estimate
    next_gain: Estimate
    total_gain: Estimate
    points: tuple[Point, ...]

    def is_clear(self, worthwhile: float) -> bool:
        """Whether all remaining blocks together are expected to gain less than is worthwhile."""
        return self.total_gain.value < worthwhile

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


def measure(features: Array, error: Labels, config: ClassifierConfig, n_windows: int) -> tuple[Point, ...]:
    """Held-out separations at parts of the epochs so far.

    Parameters
    ----------
    features : float64, (n_epochs, n_features), uV, in the order of recording.
    error : bool, (n_epochs,), the truth. Raises SetupError where a class occurs in one stretch only.
    n_windows : of each channel's features.

    Notes
    -----
    Contiguous stretches are left out, as in `decoder.calibration.contiguous_folds`; of what is left, evenly spaced
    epochs of each class are trained on.
    """
    folds = contiguous_folds(error, config.model_copy(update={"n_folds": N_FOLDS}))
    points = []
    for part in PARTS:
        log_odds, n_train = np.empty(len(error)), 0
        for train, test in folds:
            chosen = _thinned(train, error, part)
            classifier = fit(features[chosen], error[chosen], config, n_windows)
            log_odds[test] = features[test] @ classifier.weights + classifier.bias
            n_train += len(chosen)
        points.append(point(log_odds, error, round(n_train / len(folds))))
    return tuple(points)


def point(log_odds: Array, error: Labels, n_train: int) -> Point:
    """Separation of held-out log odds (n_epochs,), with its standard error (Hedges & Olkin 1985, chapter 5)."""
    of_errors, of_corrects = log_odds[error], log_odds[~error]
    within = sqrt((of_errors.var(ddof=1) + of_corrects.var(ddof=1)) / 2)
    separation = float(of_errors.mean() - of_corrects.mean()) / within if within > 0 else 0.0
    m, n = len(of_errors), len(of_corrects)
    return Point(n_train, separation, sqrt((m + n) / (m * n) + separation**2 / (2 * (m + n))))


def separation_at(n_train: Array | float, limit: Array, epochs: Array | float) -> Array:
    r"""Separation of a linear decoder trained on `n_train` epochs, ``limit**2 / sqrt(limit**2 + epochs / n_train)``.

    Estimating the difference of the class means from n epochs adds chance to the weights, the more the more weights
    there are: that of Fisher's discriminant (Raudys & Young 2004, doi:10.1016/S0047-259X(03)00069-8). `limit` is the
    separation of endless training, `epochs` grows with the number of weights that shrinkage leaves free.
    """
    return np.asarray(limit**2 / np.sqrt(limit**2 + epochs / n_train))


def outlook(points: Sequence[Point], n_epochs: int, n_block: int, n_left: int) -> Outlook:
    """Weigh all learning curves by how well they fit, and look along them.

    Parameters
    ----------
    points : of `measure`.
    n_epochs : so far.
    n_block : epochs another block would bring.
    n_left : epochs all remaining blocks would bring; 0 after the last.

    Notes
    -----
    Bayes over a grid of limits (even) and of constants (log-normal about `EPOCHS`), points with normal errors. Balanced
    accuracy is the normal distribution function of half the separation. Intervals hold 95 %; those of gains allow for
    `SCATTER`, so they reach below 0: a decoder can lose by another block.
    """
    limits, epochs = np.meshgrid(np.linspace(0.05, 8, 320), EPOCHS * np.exp(LOG_SD * np.linspace(-3, 3, 25)))
    weight = -((np.log(epochs / EPOCHS) / LOG_SD) ** 2) / 2
    for known in points:
        weight -= ((known.separation - separation_at(known.n_train, limits, epochs)) / known.error) ** 2 / 2
    weight = np.exp(weight - weight.max())

    def accuracy(n: int) -> Array:
        return np.asarray(ndtr(separation_at(n, limits, epochs) / 2))

    now = accuracy(n_epochs)
    return Outlook(
        n_epochs,
        _estimate(now, weight),
        _gain(accuracy(n_epochs + min(n_block, n_left)) - now, weight, n_left),
        _gain(accuracy(n_epochs + n_left) - now, weight, n_left),
        tuple(points),
    )


def sentence(found: Outlook, worthwhile: float) -> str:
    """What the experimenter is told after a block."""
    accuracy, gain = found.balanced_accuracy, found.total_gain
    after = f"After {found.n_epochs} epochs expect a balanced accuracy of {accuracy.value:.1%} "
    after += f"({accuracy.low:.1%} to {accuracy.high:.1%})"
    if gain.low == gain.high == 0:
        return f"{after}."
    verdict = "more calibration is not worthwhile" if found.is_clear(worthwhile) else "go on"
    return (
        f"{after}; another block gains {100 * found.next_gain.value:.1f} points, all that are left "
        f"{100 * gain.value:.1f} ({100 * gain.low:.1f} to {100 * gain.high:.1f}): {verdict}."
    )


def _thinned(train: NDArray[np.int64], error: Labels, part: float) -> NDArray[np.int64]:
    """An evenly spaced part of each class's training epochs, two at least, in order."""
    kept = []
    for members in (train[error[train]], train[~error[train]]):
        n = max(2, round(part * len(members)))
        kept.append(members[np.floor(np.arange(n) * len(members) / n).astype(np.int64)])
    return np.sort(np.concatenate(kept))


def _gain(values: Array, weight: Array, n_left: int) -> Estimate:
    """A curve's gain, with the interval for a single decoder; nothing where nothing is left."""
    gain = _estimate(values, weight)
    if n_left == 0:
        return gain
    below, above = (hypot(Z95 * SCATTER, width) for width in (gain.value - gain.low, gain.high - gain.value))
    return Estimate(gain.value, gain.value - below, gain.value + above)


def _estimate(values: Array, weight: Array) -> Estimate:
    """Mean and 95 % interval of weighted values."""
    order = np.argsort(values, axis=None)
    sorted_values, share = values.ravel()[order], np.cumsum(weight.ravel()[order]) / weight.sum()
    low, high = sorted_values[np.searchsorted(share, (0.025, 0.975))].tolist()
    return Estimate(float((values * weight).sum() / weight.sum()), low, high)
