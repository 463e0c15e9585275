"""Where in a run the paradigm is, and what it hands to the shell."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Literal

from bci_app.protocol import Message


@dataclass(frozen=True)
class Outgoing:
    """A message to send, on which stream, with which stamp (session seconds)."""

    stream: Literal["stimulus", "truth"]
    message: Message
    stamp: float


class Phase(Enum):
    """Where in the paradigm we are."""

    READY = auto()  # until `start`
    PAGE = auto()  # an instruction, until a key
    PRACTICE = auto()  # moves that don't count
    EYES = auto()  # the person moves the eyes as told, for the decoder to learn what that looks like
    LOOK = auto()  # a new episode is on the screen: time to find agent and goal
    COUNTDOWN = auto()
    HOLD = auto()  # the countdown is full, the action missing
    JUMP = auto()  # the scene shows the jump, its flip is not reported yet
    ARROW = auto()
    REST = auto()
    VERDICT = auto()  # the block has all its moves, but whether one must be repeated isn't known yet
    BREAK = auto()
    KEY = auto()  # a key may end the break
    PAUSED = auto()
    DONE = auto()


TIMED = (Phase.PRACTICE, Phase.EYES, Phase.LOOK, Phase.COUNTDOWN, Phase.ARROW, Phase.REST, Phase.BREAK)
"""Phases that time ends."""
AT_ONCE = (Phase.PAGE, Phase.PRACTICE, Phase.LOOK, Phase.COUNTDOWN, Phase.HOLD, Phase.VERDICT, Phase.KEY)
"""Phases that can be left for a pause at once, for that spoils no epoch."""


class Outbox:
    """The messages that wait to be sent, in order; their stamps never decrease."""

    def __init__(self) -> None:
        self._waiting: list[Outgoing] = []
        self._last_stamp = float("-inf")

    def put(self, message: Message, stamp: float, stream: Literal["stimulus", "truth"] = "stimulus") -> None:
        """Add a message. A flip may be dated a little after the `now` that follows it: such a stamp is put off.

        Onsets, the latest time there is when they are reported, are never changed by this.
        """
        self.not_before(stamp)
        self._waiting.append(Outgoing(stream, message, self._last_stamp))

    def put_pair(self, messages: tuple[Message, Message], stamp: float) -> None:
        """Add a message and what the truth stream says at the same time."""
        self.put(messages[0], stamp)
        self.put(messages[1], stamp, "truth")

    def again(self, said: Iterable[Outgoing]) -> None:
        """Add what was said before, with the stamps it had."""
        self._waiting += said

    def not_before(self, stamp: float) -> None:
        """No later message gets an earlier stamp."""
        self._last_stamp = max(stamp, self._last_stamp)

    def take(self) -> list[Outgoing]:
        """All that wait; handed out once."""
        out, self._waiting = self._waiting, []
        return out
