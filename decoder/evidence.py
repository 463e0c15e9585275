"""What a verdict is worth: from log odds to calibrated evidence, and the rates and bits a policy can be told.

A classifier fitted on few epochs claims more than new epochs bear out. A line over its log odds, fitted on epochs it
hadn't seen, mends that (Platt 1999, in Advances in Large Margin Classifiers, 61-74).
"""

from dataclasses import dataclass
from math import log
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit

from bci_app.told import Told

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]
Rate = Annotated[float, Field(gt=0, lt=1)]

EVIDENCE_LIMIT = 10.0
"""Most a single verdict may say, natural log: a ratio of 22,000. Hundreds of epochs can't vouch for more (decided)."""
N_FOLDS = 10
"""Stretches of the calibration of which each is left out once to measure the information (decided)."""
SAME = 1e-12
"""Spread of log odds, relative to their size, below which they are one value and its rounding errors (decided)."""


@dataclass(frozen=True)
class Evidence:
    """What a decoder's verdicts are worth. The bounds are checked where a model file is read.

    Attributes
    ----------
    slope, intercept : natural log of P(log odds | error) / P(log odds | correct) is slope * log odds + intercept;
        slope >= 0, and both are 0 when the verdicts say nothing.
    hit : probability of the verdict `error` on an error move, inside (0, 1).
    correct_rejection : probability of the verdict `correct` on a correct move, inside (0, 1).
    information : bits a verdict tells about a move that is an error with probability 1/2, in [0, 1].
    """

    slope: Annotated[float, Field(ge=0)]
    intercept: float
    hit: Rate
    correct_rejection: Rate
    information: Annotated[float, Field(ge=0, le=1)]

    @property
    def told(self) -> Told:
        """What a policy is told of this decoder."""
        return Told(self.hit, self.correct_rejection, self.information)

    def of(self, log_odds: float) -> float:
        """The evidence of a verdict: natural log-likelihood ratio, within `EVIDENCE_LIMIT` of 0."""
        return max(-EVIDENCE_LIMIT, min(EVIDENCE_LIMIT, self.slope * log_odds + self.intercept))


def calibrate_evidence(held_out_log_odds: Array, error: Labels) -> Evidence:
    """Measure what verdicts are worth.

    Parameters
    ----------
    held_out_log_odds : float64, (n_epochs,), of classifiers that hadn't seen the epoch, in the order of recording.
    error : bool, (n_epochs,), the truth; two or more of each class.

    Notes
    -----
    ``information`` is 1 minus the cross-entropy of the truth given the evidence, each class weighing one half, where
    slope and intercept come from the other nine tenths. Where that is no gain over saying nothing, nothing is said.
    """
    slope, intercept = _line(held_out_log_odds, error)
    information = 1 - _cross_entropy(held_out_evidence(held_out_log_odds, error), error)
    if slope == 0 or information <= 0:
        slope, intercept, information = 0.0, 0.0, 0.0
    said_error = held_out_log_odds > 0
    return Evidence(slope, intercept, _rate(said_error[error]), _rate(~said_error[~error]), information)


def _line(log_odds: Array, error: Labels) -> tuple[float, float]:
    """Slope and intercept of a logistic regression in which each class weighs one half; (0, 0) unless it rises.

    Log odds at equal priors are the log-likelihood ratio. Platt's targets are a little inside 0 and 1, as if each
    class had one epoch more of either label, so separable classes give a finite slope too.
    """
    centre, spread = log_odds.mean(), log_odds.std()
    if spread <= SAME * np.abs(log_odds).max():
        return 0.0, 0.0
    n_error, n_correct = int(error.sum()), int((~error).sum())
    target = np.where(error, (n_error + 1) / (n_error + 2), 1 / (n_correct + 2))
    weight = np.where(error, 0.5 / n_error, 0.5 / n_correct)
    # Standardised, so that the solver sees the same problem whatever the scale of the log odds.
    x = np.stack(((log_odds - centre) / spread, np.ones(len(log_odds))))

    def loss(line: Array) -> float:
        z = line @ x
        return float(weight @ (np.logaddexp(0, z) - target * z))

    def gradient(line: Array) -> Array:
        return np.asarray(x @ (weight * (expit(line @ x) - target)))

    def hessian(line: Array) -> Array:
        p = expit(line @ x)
        return np.asarray((x * weight * p * (1 - p)) @ x.T)

    # Convex in two numbers: Newton's method within a trust region finds the one minimum from anywhere.
    found = minimize(loss, np.zeros(2), method="trust-exact", jac=gradient, hess=hessian, options={"gtol": 1e-10}).x
    slope = float(found[0] / spread)
    return (slope, float(found[1] - slope * centre)) if slope > 0 else (0.0, 0.0)


def held_out_evidence(log_odds: Array, error: Labels) -> Array:
    """Evidence (n_epochs,) by lines that haven't seen the epoch: contiguous tenths of each class are left out, for
    neighbouring epochs resemble each other."""
    fold, evidence = np.empty(len(error), dtype=np.int64), np.empty(len(error))
    for members in (error, ~error):
        n = int(members.sum())
        fold[members] = np.arange(n) * N_FOLDS // n
    for number in range(N_FOLDS):
        test = fold == number
        slope, intercept = _line(log_odds[~test], error[~test])
        evidence[test] = np.clip(slope * log_odds[test] + intercept, -EVIDENCE_LIMIT, EVIDENCE_LIMIT)
    return evidence


def _cross_entropy(evidence: Array, error: Labels) -> float:
    """Bits still missing about the truth, the mean of the two classes'; 1 when nothing is said."""
    missing = np.logaddexp(0, np.where(error, -evidence, evidence)) / log(2)
    return float((missing[error].mean() + missing[~error].mean()) / 2)


def _rate(right: Labels) -> float:
    """Share of True, as the mean of its posterior under Jeffreys' prior: never 0 or 1."""
    return (int(right.sum()) + 0.5) / (len(right) + 1)
