"""What the keys do: space begins and goes on, P pauses, Escape pauses and, pressed twice, ends.

One stray key never ends a session: it costs a pause.
"""

from bci_app.clock import Clock
from stimulus.paradigm import Paradigm
from stimulus.view import Key

AGAIN_S = 2.0
"""Real seconds within which Escape must be pressed again to end the session (decided)."""
PAUSED, STOPPED = "The experimenter pressed pause.", "Stopped at the stimulus's keyboard."


class Keyboard:
    """Hands keys on to the paradigm."""

    def __init__(self, paradigm: Paradigm, clock: Clock) -> None:
        self._paradigm, self._clock = paradigm, clock
        self._escaped_at = float("-inf")  # session time

    def pressed(self, key: Key, now: float, commanded: bool) -> None:
        """Take a key; `commanded` where bci-app begins the run, and goes on after pauses."""
        paradigm = self._paradigm
        match key:
            case "start" if paradigm.waiting_for == "start" and not commanded:
                paradigm.start(now)
            case "start" if paradigm.is_paused_by_person and commanded:
                paradigm.release(now)
            case "start" if paradigm.is_paused_by_person:
                paradigm.resume(now)
            case "start":
                paradigm.key_start(now)
            case "pause":
                paradigm.pause(now, PAUSED, by_person=True)
            case "stop" if self._is_asked_again(now):
                paradigm.stop(now, "interrupted", STOPPED)
            case "stop":
                self._escaped_at = now
                paradigm.pause(now, PAUSED, by_person=True)

    def _is_asked_again(self, now: float) -> bool:
        return (now - self._escaped_at) / self._clock.speed <= AGAIN_S
