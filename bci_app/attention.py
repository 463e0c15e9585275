"""Time as somebody has listened: who was stopped or starved has heard nothing, and that is nobody else's silence.

Pure: a clock is handed in.
"""

from collections.abc import Callable
from dataclasses import dataclass

ROUND_S = 1.0
"""Real seconds that pass between two looks at the time, at most (decided: rounds take 0.1 s)."""


@dataclass
class Attention:
    """Counts the seconds for which its owner has listened.

    Attributes
    ----------
    clock : reads the real clock, s.
    """

    clock: Callable[[], float]

    def __post_init__(self) -> None:
        self._looked_at = self._listened = self.clock()

    def now(self) -> float:
        """Seconds listened; the real clock's, less those in which its owner wasn't there."""
        real = self.clock()
        self._listened += min(real - self._looked_at, ROUND_S)
        self._looked_at = real
        return self._listened
