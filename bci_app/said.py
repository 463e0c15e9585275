"""What was said in a run so far: what of it is void, and what a process that was started again must know of it.

A move is made when bci-app has heard of it. A stimulus that dies may have announced a move that nobody remembers when
it is started again; its `Continued` makes that void, for whoever listens and for whoever reads the recording.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from bci_app.protocol import (
    Action,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Recall,
    Role,
    Said,
    SessionStart,
    Tellable,
    Truth,
    Verdict,
)

Place = tuple[int, float]
"""(episode, step): how far a run was when something was said; an episode's end lies behind all of its steps."""
T = TypeVar("T")

_OF_THE_EPISODE = {
    "decoder": (EpisodeStart, MoveOnset, Electrodes, Verdict),
    "policy": (EpisodeStart, MoveOnset, Verdict, Action),
}
"""What these two must know, of the last episode only; a stimulus must know everything."""


def place_of(message: Message) -> Place | None:
    """How far the run was; None for what belongs to no place."""
    match message:
        case EpisodeStart() | EpisodeGoal():
            return message.episode, 0
        case MoveOnset() | Truth() | Verdict() | Electrodes():
            return message.episode, message.step
        case Action():
            return message.episode, message.step - 1
        case EpisodeEnd():
            return message.episode, float("inf")
    return None


def is_void(message: Message, continued: Continued) -> bool:
    """Whether something said before doesn't count any more."""
    place = place_of(message)
    return place is not None and place > (continued.episode, continued.step)


def without_void(items: Iterable[T], message_of: Callable[[T], Message]) -> list[T]:
    """Those that count, of all in the order in which they were said."""
    kept: list[T] = []
    for item in items:
        message = message_of(item)
        if isinstance(message, Continued):
            kept = [before for before in kept if not is_void(message_of(before), message)]
        kept.append(item)
    return kept


class Memory:
    """Keeps what a run's processes say. Messages are handed in as they come."""

    def __init__(self, session: str) -> None:
        self._session = session
        self._said: list[Said] = []

    def take(self, stamp: float, message: Message) -> None:
        """Keep a message, if a process might have to know it again."""
        if isinstance(message, Continued):
            self._said = [said for said in self._said if not is_void(said.message, message)]
        elif isinstance(message, Tellable):
            self._said.append(Said(stamp=stamp, message=message))

    def recall(self, role: Role) -> Recall:
        """What a process in this role must know."""
        said = sorted(self._said, key=lambda item: item.stamp)
        kinds = _OF_THE_EPISODE.get(role)
        if kinds is not None:
            opening = [item for item in said if isinstance(item.message, SessionStart)]
            said = opening + [item for item in _last_episode(said) if isinstance(item.message, kinds)]
        return Recall(session=self._session, role=role, said=tuple(said))


def _last_episode(said: Sequence[Said]) -> list[Said]:
    numbers = [item.message.episode for item in said if isinstance(item.message, EpisodeStart)]
    last = numbers[-1] if numbers else None
    return [item for item in said if getattr(item.message, "episode", None) == last and last is not None]
