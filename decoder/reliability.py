"""How far a decoder's figures can be trusted: its probabilities, and what its accuracy means for a coming session."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from decoder.calibration import Z95, Estimate

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

N_BINS = 10
"""Equally wide bins of probability (Niculescu-Mizil & Caruana 2005, doi:10.1145/1102351.1102430)."""


@dataclass(frozen=True)
class Bin:
    """One point of a reliability diagram: `n` moves, said to be errors with probability `said`, of which a share
    `happened` were."""

    said: float
    happened: float
    n: int


@dataclass(frozen=True)
class Reliability:
    """Whether what is said to happen with 70 % happens 7 times in 10.

    Attributes
    ----------
    brier : mean squared difference of probability and truth (Brier 1950); `brier_uninformed` of saying the share of
        errors every time.
    ece : expected calibration error, the mean over moves of \\|said - happened\\| in their bin (Naeini et al. 2015,
        AAAI 29:2901).
    ece_by_chance : what it would be on average if all probabilities were true, for bins of few moves scatter.
    bins : of the reliability diagram, those that hold moves, from low to high probability.
    """

    brier: float
    brier_uninformed: float
    ece: float
    ece_by_chance: float
    bins: tuple[Bin, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


def reliability(evidence: Array, error: Labels, n_bins: int = N_BINS) -> Reliability:
    """Compare evidence with the truth.

    Parameters
    ----------
    evidence : float64, (n_moves,), natural log-likelihood ratios of error to correct, of moves that neither the
        classifier nor its calibration has seen.
    error : bool, (n_moves,), the truth; both classes occur.

    Notes
    -----
    Evidence tells by how much a verdict moves the odds. They start from the share of errors among these moves.
    """
    share = float(error.mean())
    probability = expit(evidence + log(share / (1 - share)))
    place = np.minimum((probability * n_bins).astype(int), n_bins - 1)
    bins, off, by_chance = [], 0.0, 0.0
    for number in np.unique(place).tolist():
        said, happened = probability[place == number], error[place == number]
        bins.append(Bin(float(said.mean()), float(happened.mean()), len(said)))
        off += abs(float(said.sum() - happened.sum()))
        # Mean of a normal deviate's size; the sum over a bin is nearly normal.
        by_chance += sqrt(2 / np.pi * float((said * (1 - said)).sum()))
    return Reliability(
        brier=float(((probability - error) ** 2).mean()),
        brier_uninformed=share * (1 - share),
        ece=off / len(error),
        ece_by_chance=by_chance / len(error),
        bins=tuple(bins),
    )


@dataclass(frozen=True)
class Prediction:
    """Where a coming session's accuracies will lie, 19 times in 20.

    Attributes
    ----------
    accuracy, balanced_accuracy : of the session's verdicts, as they will be counted on its moves.
    n_moves : how many moves with verdicts the session is assumed to have.
    error_share : the assumed share of errors among them.
    spread : how much more than chance the calibration's stretches differ in accuracy, a ratio of variances, 1 or more.
    """

    accuracy: Estimate
    balanced_accuracy: Estimate
    n_moves: int
    error_share: float
    spread: float

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


def predict_session(
    right: Labels, error: Labels, stretches: Sequence[NDArray[np.int64]], n_moves: int, error_share: float
) -> Prediction:
    """From contiguous-block cross-validation to an interval for a session.

    Parameters
    ----------
    right : bool, (n_epochs,), whether each held-out verdict was right.
    error : bool, (n_epochs,), the truth; both classes occur.
    stretches : indices of the epochs of each left-out stretch.
    n_moves, error_share : of the session.

    Notes
    -----
    Wilson's interval tells how well the calibration knows the accuracy; a session of N moves scatters about it as well.
    For a rate r of a class with n epochs in the calibration and m moves in the session both variances add up to
    ``r (1 - r) (1 / n + 1 / m)``. Where the stretches of the calibration differ by more than chance (Pearson's
    chi-squared over its degrees of freedom), so will the session: both are multiplied by that. The rates are means
    under Jeffreys' prior, so that 0 errors in 20 isn't taken for never.
    """
    spread = overdispersion(right, error, stretches)
    shares = np.array([error_share, 1 - error_share])
    rates, variances = np.empty(2), np.empty(2)
    for number, members in enumerate((error, ~error)):
        n = int(members.sum())
        rates[number] = (int(right[members].sum()) + 0.5) / (n + 1)
        expected = max(1.0, shares[number] * n_moves)
        variances[number] = spread * rates[number] * (1 - rates[number]) * (1 / n + 1 / expected)
    return Prediction(
        _normal(rates, variances, shares), _normal(rates, variances, np.full(2, 0.5)), n_moves, error_share, spread
    )


def overdispersion(right: Labels, error: Labels, stretches: Sequence[NDArray[np.int64]]) -> float:
    """How much more than chance the stretches' counts of right verdicts differ: a ratio of variances, 1 or more.

    Each class has its own rate; a stretch's count is compared with what its mix of the classes lets expect.
    """
    rate = np.where(error, right[error].mean(), right[~error].mean())
    differences = [float((right[stretch] - rate[stretch]).sum()) for stretch in stretches]
    variances = [float((rate[stretch] * (1 - rate[stretch])).sum()) for stretch in stretches]
    squared = [d * d / v for d, v in zip(differences, variances, strict=True) if v > 0]
    return max(1.0, sum(squared) / (len(squared) - 1)) if len(squared) > 1 else 1.0


def _normal(rates: Array, variances: Array, shares: Array) -> Estimate:
    value = float(shares @ rates)
    half = Z95 * sqrt(float(shares**2 @ variances))
    return Estimate(value, max(0.0, value - half), min(1.0, value + half))
