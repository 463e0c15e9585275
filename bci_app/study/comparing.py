"""Conditions against each other, each participant against themselves: steps, success, intervals and tests."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bci_app.report import FEWEST_PEOPLE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ratio:
    """How many more steps than another condition, as a share: -0.3 are 30 % fewer.

    Attributes
    ----------
    value, low, high : with its 95 % interval; None for the bounds where there are fewer than two pairs.
    p : of the paired t test on the pairs' differences, two-sided; None for fewer than two pairs.
    p_ranks : of Wilcoxon's signed-rank test on the same.
    n : pairs.
    """

    value: float
    low: float | None
    high: float | None
    p: float | None
    p_ranks: float | None
    n: int

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


def ratio(steps: Sequence[float], others: Sequence[float]) -> Ratio:
    """Mean steps over another condition's less 1, over pairs: participants, or one participant's episodes.

    The interval is Student's of the ratio estimator (Cochran, Sampling Techniques, 3rd ed. 1977, chapter 6): what a
    hard episode, or a slow participant, costs both doesn't widen it.
    """
    a, b = np.asarray(steps, dtype=float), np.asarray(others, dtype=float)
    if len(a) != len(b) or not len(a):
        raise ValueError(f"pairs need as many of one as of the other, and some; found {len(a)} and {len(b)}")
    value = float(a.mean() / b.mean())
    n = len(a)
    if n < 2:
        return Ratio(value - 1, None, None, None, None, n)
    left = a - value * b
    half = float(stats.t.ppf(0.975, n - 1) * left.std(ddof=1) / sqrt(n) / b.mean())
    return Ratio(value - 1, value - 1 - half, value - 1 + half, *paired_tests(a - b), n)


def paired_tests(differences: Array) -> tuple[float, float]:
    """p of the paired t test and of Wilcoxon's signed-rank test, two-sided; 1 where all differences are 0."""
    if not differences.any():
        return 1.0, 1.0
    if np.ptp(differences) == 0:  # a t of infinity
        return 0.0, float(stats.wilcoxon(differences).pvalue)
    return float(stats.ttest_1samp(differences, 0.0).pvalue), float(stats.wilcoxon(differences).pvalue)


def success(share: float, n: int) -> dict[str, float]:
    """Share of episodes that reached the goal, with Wilson's score interval (doi:10.1080/01621459.1927.10502953).

    Parameters
    ----------
    n : different episodes. Who plays the same ones, without verdicts even with the same moves, adds nothing to it.
    """
    z = float(stats.norm.ppf(0.975))
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * sqrt(share * (1 - share) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    return {"success": share, "success_low": max(0.0, middle - half), "success_high": min(1.0, middle + half)}


def share(right: Sequence[int], n: Sequence[int]) -> tuple[float, float | None, float | None]:
    """Share of right ones, of all participants together, with a 95 % interval over participants; None for the bounds
    where there are fewer than `FEWEST_PEOPLE`.

    Student's, of the ratio estimator as in `ratio`.
    """
    a, b = np.asarray(right, dtype=float), np.asarray(n, dtype=float)
    value = float(a.sum() / b.sum())
    if len(a) < FEWEST_PEOPLE:
        return value, None, None
    half = float(stats.t.ppf(0.975, len(a) - 1) * (a - value * b).std(ddof=1) / sqrt(len(a)) / b.mean())
    return value, max(0.0, value - half), min(1.0, value + half)


def mean(values: Sequence[float]) -> dict[str, float | None]:
    """Mean with Student's 95 % interval; without one for fewer than two."""
    x = np.asarray(values, dtype=float)
    middle = float(x.mean())
    if len(x) < 2:
        return {"mean_steps": middle, "mean_steps_low": None, "mean_steps_high": None}
    half = float(stats.t.ppf(0.975, len(x) - 1) * x.std(ddof=1) / sqrt(len(x)))
    return {"mean_steps": middle, "mean_steps_low": middle - half, "mean_steps_high": middle + half}
