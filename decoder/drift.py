"""Whether the decoder still says what it said in its calibration, judged without the truth.

Online nobody knows which moves were errors, so log odds are compared with all mixtures of the held-out log odds of the
calibration's errors and correct moves. What no plausible share of errors explains is drift. A decoder that
merely stops to see errors isn't found out: its log odds are those of correct moves.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

N_WINDOW = 100
"""Newest log odds that are looked at: a third of an online run (decided)."""
LIMIT = 1.9
"""Scaled distance from the best mixture beyond which a decoder has drifted: warns of no more than 1 session in 50 that
doesn't drift (decided, measured by `benchmarks/decoder_reliability.py`; one look would take 1.63, a run has many)."""
SHARES = np.linspace(0.0, 0.6, 13)
"""Shares of errors that are tried: walking at random makes half of the moves errors, and no policy more (decided)."""


@dataclass(frozen=True)
class Drift:
    """How online log odds compare with the calibration's.

    Attributes
    ----------
    n : log odds looked at.
    distance : Kolmogorov and Smirnov's, the largest difference of the two cumulative distributions, at the share of
        errors that fits best; times the root of the harmonic number of log odds, n m / (n + m), with m of calibration.
    error_share : that share.
    shift : mean log odds less what the mixture lets expect, in the mixture's standard deviations.
    spread : standard deviation of the log odds over the mixture's.
    """

    n: int
    distance: float
    error_share: float
    shift: float
    spread: float

    @property
    def is_drift(self) -> bool:
        """Whether no plausible share of errors explains these log odds."""
        return self.distance > LIMIT

    @property
    def sentence(self) -> str:
        """What the experimenter is told of a drift."""
        return (
            f"The decoder seems to have drifted: no plausible share of errors explains its last {self.n} log odds. "
            f"They lie {self.shift:+.1f} standard deviations from the calibration's and spread {self.spread:.1f} times "
            "as much. Verdicts may be worth less than was measured. Look at the electrodes, or recalibrate after "
            "this run."
        )


class DriftWatch:
    """The newest log odds of a run beside the calibration's.

    Parameters
    ----------
    held_out_log_odds : float64, (n_epochs,), of the calibration, by classifiers that hadn't seen the epoch.
    error : bool, (n_epochs,), the truth; both classes occur.
    """

    def __init__(self, held_out_log_odds: Array, error: Labels) -> None:
        self._classes = (np.sort(held_out_log_odds[error]), np.sort(held_out_log_odds[~error]))
        self._newest: deque[float] = deque(maxlen=N_WINDOW)

    def hear(self, log_odds: float) -> Drift | None:
        """Take in a move's log odds; how they compare once there are enough."""
        self._newest.append(log_odds)
        if len(self._newest) < N_WINDOW:
            return None
        return compare(np.array(self._newest), *self._classes)


def compare(log_odds: Array, of_errors: Array, of_corrects: Array) -> Drift:
    """Compare log odds, (n,), with the best mixture of the calibration's, each (n_class,) and sorted."""
    n, m = len(log_odds), len(of_errors) + len(of_corrects)
    places = np.sort(np.concatenate((log_odds, of_errors, of_corrects)))
    found = np.searchsorted(np.sort(log_odds), places, side="right") / n
    by_class = [np.searchsorted(known, places, side="right") / len(known) for known in (of_errors, of_corrects)]
    expected = SHARES[:, None] * by_class[0] + (1 - SHARES[:, None]) * by_class[1]
    distances = np.abs(found - expected).max(axis=1)
    best = int(distances.argmin())
    share = float(SHARES[best])
    mean = share * of_errors.mean() + (1 - share) * of_corrects.mean()
    square = share * (of_errors**2).mean() + (1 - share) * (of_corrects**2).mean()
    spread = float(np.sqrt(square - mean**2))
    # Log odds that are all the same, as of a decoder without weights, have no spread to compare with.
    scale = spread if spread > 0 else 1.0
    return Drift(
        n,
        float(distances[best]) * float(np.sqrt(n * m / (n + m))),
        share,
        float(log_odds.mean() - mean) / scale,
        float(log_odds.std()) / scale,
    )
