"""A simulated amplifier's photodiode: a channel that changes between dark and light with each jump on the screen."""

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config

CHANNEL = "PHOTO"
LIGHT_UV = 1000.0
"""Height of the light, uV (decided)."""
NOISE_UV = 5.0
"""Standard deviation of the sensor's noise, uV (decided)."""


class Photodiode:
    """The channel's samples; none where the configuration has no photodiode.

    Parameters
    ----------
    config : `simulation.photodiode_ms` after a flip the light changes. What the stimulus adds to its flips'
        stamps (`stimulus.photon_delay_ms`) is taken off again, for light doesn't wait for stamps.
    t0 : session time of sample 0, s.
    sfreq : rate, Hz.
    """

    def __init__(self, config: Config, t0: float, sfreq: float) -> None:
        delay_ms = config.simulation.photodiode_ms
        self.names = () if delay_ms is None else (CHANNEL,)
        self._delay_s = ((delay_ms or 0.0) - config.stimulus.photon_delay_ms) / 1e3
        self._t0, self._sfreq, self._run = t0, sfreq, config.simulation.run
        self._changes: list[float] = []

    def jump(self, onset: float) -> None:
        """The stimulus said that a jump was seen at `onset`, session s."""
        self._changes.append(onset + self._delay_s)

    def render(self, start: int, n_times: int) -> NDArray[np.float32]:
        """Samples from number `start` on, (n_times, n_channels), uV; each is lit as the screen is at its very time."""
        if not self.names:
            return np.empty((n_times, 0), np.float32)
        times = self._t0 + np.arange(start, start + n_times) / self._sfreq
        lit = np.array([bisect_right(self._changes, time) % 2 for time in times], dtype=np.float64)
        noise = np.random.default_rng([self._run % 2**32, start]).normal(0, NOISE_UV, n_times)
        return (lit * LIGHT_UV + noise).astype(np.float32)[:, np.newaxis]
