"""A clock that runs a little fast or slow, seen by how late samples come after their stamps.

Pure. An amplifier whose connector counts samples instead of asking LSL's clock drifts by up to 100 ppm, a third of a
second an hour. Its samples then come later and later after their stamps, or earlier, evenly and from the beginning on;
a network that holds them back does so by leaps. Only the first is a drift.
"""

import numpy as np
from scipy.stats import theilslopes

EVERY_S = 10.0
"""Real seconds of which one value of lateness is kept, the least (decided)."""
REFIT_S = 60.0
"""Real seconds after which the line is drawn anew (decided)."""
LEAST_S = 180.0
"""Real seconds that must be known (decided: 18 ms at 100 ppm)."""
MOST_PPM = 500.0
"""Parts in a million by which no working clock drifts (decided: crystals are within 100)."""
SCATTER_S = 0.005
"""Seconds the values may scatter about the line, in the median, for it to be a line (decided)."""
SMALL_S = 0.010
"""Seconds of drift that are no matter, and less than this can't be known (decided)."""
MOST_POINTS = 240
"""Of the line; of a longer session every second, third ... value is taken."""


class ClockDrift:
    """Follows how late samples come, in seconds of a session at speed 1."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._lateness: list[float] = []
        self._slope = 0.0
        self._fitted_at = 0.0

    def take(self, now: float, late: float) -> None:
        """Samples came `late` seconds after their stamps at best, in the seconds until real time `now`."""
        if self._times and now - self._times[-1] < EVERY_S:
            self._lateness[-1] = min(self._lateness[-1], late)
            return
        self._times.append(now)
        self._lateness.append(late)
        if now - self._times[0] >= LEAST_S and now - self._fitted_at >= REFIT_S:
            self._fitted_at = now
            self._fit()

    @property
    def ppm(self) -> float:
        """By how much the clock is slow, parts in a million; 0 while it isn't known to be off."""
        return 1e6 * self._slope

    def at(self, now: float) -> float:
        """Seconds by which stamps have fallen behind since the beginning."""
        return self._slope * (now - self._times[0]) if self._times else 0.0

    def _fit(self) -> None:
        step = -(-len(self._times) // MOST_POINTS)
        times, lateness = np.array(self._times[::step]), np.array(self._lateness[::step])
        line = theilslopes(lateness, times)
        scatter = float(np.median(np.abs(lateness - line.intercept - line.slope * times)))
        is_line = scatter < SCATTER_S and abs(line.slope) < MOST_PPM * 1e-6
        self._slope = float(line.slope) if is_line and abs(line.slope) * (times[-1] - times[0]) > SMALL_S else 0.0
