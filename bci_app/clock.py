"""Session time: the LSL clock, or the LSL clock running N times faster from an origin all processes share.

Everything in the loop is stamped and scheduled in session time, so a simulated session at speed 20 carries the
stamps of a real one. Only patience with a peer that may be dead is measured in real seconds.
"""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """Session time derived from a real clock.

    Attributes
    ----------
    source : reads the real clock in seconds (``bci_app.lsl.local_clock``, or a fake one in tests).
    speed : session seconds a real second; 1 with people.
    origin : the reading of ``source`` at which session time and real time agree; shared by all processes.
    """

    source: Callable[[], float]
    speed: float = 1.0
    origin: float = 0.0

    def now(self) -> float:
        """Session time in seconds."""
        return self.to_session(self.source())

    def to_session(self, real: float) -> float:
        """Session time of a reading of the real clock; the very same number at speed 1."""
        return real if self.speed == 1.0 else self.origin + (real - self.origin) * self.speed

    def real_until(self, when: float) -> float:
        """Real seconds until a session time, 0 when it is past: how long a wait may block."""
        return max(0.0, (when - self.now()) / self.speed)
