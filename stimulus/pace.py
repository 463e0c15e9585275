"""Frames: how far apart the screen's flips are, at which of them the next picture comes, and which came late.

All times are real seconds of one clock, handed in: it reads none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

PLAUSIBLE_S = (1 / 400, 1 / 20)
"""Shortest and longest time between two refreshes of a screen (decided)."""
REFRESH_TOLERANCE = 0.1
"""Largest relative difference of the measured interval from the one the system tells (decided)."""
ALIKE = 0.2
"""Relative difference of intervals that are taken for one frame each (decided)."""
LATE = 1.5
"""Frames between two flips, of pictures that follow each other, from which on one was left out."""
IN_TIME = 0.1
"""Part of a frame that must be left to draw in, for the next flip to be the one that is aimed at."""


@dataclass(frozen=True)
class Flips:
    """How flips that follow each other at once are spaced. All in ms.

    Attributes
    ----------
    interval_ms, sd_ms : of one frame, and the standard deviation of what isn't late.
    longest_ms : the longest of all.
    n, n_late : intervals, and how many of them are over one and a half frames.
    paced : whether the screen, and not the program's speed, sets the interval.
    """

    interval_ms: float
    sd_ms: float
    longest_ms: float
    n: int
    n_late: int
    paced: bool


def flips(times: Sequence[float], may_be_paced: bool, refresh_hz: float | None) -> Flips:
    """Figures of flips that returned at `times`, in s.

    ``may_be_paced``: whether vsync was granted; ``refresh_hz`` of the screen as the system tells it. Flips that are
    granted vsync and don't wait, or wait for something else, are seen by their interval.
    """
    gaps = np.diff(np.asarray(times, dtype=np.float64))
    # On a busy computer many flips are left out, but a quarter never is.
    quick = float(np.quantile(gaps, 0.25))
    interval = float(np.median(gaps[np.abs(gaps - quick) <= ALIKE * quick]))
    late = gaps > LATE * interval
    plausible = PLAUSIBLE_S[0] <= interval <= PLAUSIBLE_S[1]
    as_told = refresh_hz is None or abs(interval * refresh_hz - 1) <= REFRESH_TOLERANCE
    return Flips(
        interval_ms=interval * 1e3,
        sd_ms=float(np.std(gaps[~late])) * 1e3,
        longest_ms=float(gaps.max()) * 1e3,
        n=len(gaps),
        n_late=int(late.sum()),
        paced=may_be_paced and plausible and as_told,
    )


class Pace:
    """Follows the flips of one screen.

    Parameters
    ----------
    interval : s between two flips; of an unpaced screen, between two pictures of the countdown.
    paced : whether flips wait for the screen.
    """

    def __init__(self, interval: float, paced: bool) -> None:
        self.interval, self.paced = interval, paced
        self._last: float | None = None
        self._is_running = False  # pictures follow each other, one a frame

    def aim(self, now: float) -> float:
        """When the picture that is drawn now will be seen: at the next flip of a paced screen, else at once."""
        if not self.paced or self._last is None:
            return now
        frames = ceil((now - self._last) / self.interval + IN_TIME)
        return self._last + max(1, frames) * self.interval

    @property
    def lead(self) -> float:
        """Seconds by which a change may be seen too early: it is due at the nearest flip, not at the next."""
        return self.interval / 2 if self.paced else 0.0

    def flipped(self, at: float, running: bool) -> float | None:
        """Take a flip, of one of the pictures that follow each other or not. By how many ms it was late; None if not.

        Only a picture that follows another at once can be known to be late: the screen was ready for it a frame after.
        """
        gap = at - self._last if self._last is not None and self._is_running else 0.0
        self._last, self._is_running = at, running
        # Without a screen's beat a picture may always come some of a frame later.
        limit = LATE if self.paced else LATE + 0.5
        return (gap - self.interval) * 1e3 if gap > limit * self.interval else None
