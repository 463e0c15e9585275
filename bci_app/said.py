"""What was said in a run so far: what of it is void, and what a process that was started again must know of it.

A move is made when bci-app has heard of it. A stimulus that dies may have announced a move that nobody remembers when
it is started again; its `Continued` makes that void, for whoever listens and for whoever reads the recording.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Pause,
    Recall,
    Resume,
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
_ONCE = (EpisodeStart, EpisodeGoal, MoveOnset, Truth, Verdict)
"""Said once of an episode or of a move: of two the first counts."""
_OUTLINE = (SessionStart, BlockStart, BlockEnd, EpisodeStart, EpisodeEnd, Pause, Resume)
"""How far a run has come."""


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


def place_after(continued: Continued) -> Place:
    """The last place that counts."""
    return continued.episode, float("inf") if continued.step is None else continued.step


def is_void(message: Message, continued: Continued) -> bool:
    """Whether something said before doesn't count any more."""
    place = place_of(message)
    return place is not None and place > place_after(continued)


def without_void(items: Iterable[T], message_of: Callable[[T], Message]) -> list[T]:
    """Those that count, of all in the order in which they were said.

    Where a decoder was started again there may be two verdicts on a move: the first counts, for the policy acted on it.
    A stimulus that was started again says its last words once more.
    """
    kept: list[T] = []
    known: set[tuple[type[Message], Place]] = set()
    for item in items:
        message = message_of(item)
        if isinstance(message, Continued):
            kept = [before for before in kept if not is_void(message_of(before), message)]
            known = {each for each in known if each[1] <= place_after(message)}
        elif isinstance(message, _ONCE):
            place = place_of(message)
            assert place is not None, "all of these have one"
            if (type(message), place) in known:
                continue
            known.add((type(message), place))
        kept.append(item)
    return kept


class Memory:
    """Keeps what a run's processes say. Messages are handed in as they come."""

    def __init__(self, session: str) -> None:
        self._session = session
        self._said: list[Said] = []
        self._is_online = False

    def take(self, stamp: float, message: Message) -> None:
        """Keep a message, if a process might have to know it again."""
        if isinstance(message, Continued):
            self._said = [said for said in self._said if not is_void(said.message, message)]
        elif isinstance(message, EpisodeStart | MoveOnset) and self._has(message):
            return  # said once more, by a stimulus that was started again
        elif isinstance(message, Tellable):
            self._said.append(Said(stamp=stamp, message=message))
            if isinstance(message, SessionStart):
                self._is_online = message.task == "online"
            elif isinstance(message, EpisodeStart) and self._is_online:
                self._forget_before(message.episode - 1)

    def _has(self, message: EpisodeStart | MoveOnset) -> bool:
        place = place_of(message)
        return any(type(said.message) is type(message) and place_of(said.message) == place for said in self._said[::-1])

    def _forget_before(self, episode: int) -> None:
        """Of online episodes that are long over nobody must know more than that they were: a run may last all day.

        A calibration's stimulus needs all of its moves, for chance goes on from them.
        """
        judged = {place_of(item.message) for item in self._said if isinstance(item.message, Verdict)}
        decisions = _last_decision(
            [item for item in self._said if (place_of(item.message) or (episode, 0)) < (episode, 0)]
        )

        def is_needed(item: Said) -> bool:
            match item.message:
                case MoveOnset(episode=number):
                    return number >= episode or place_of(item.message) not in judged
                case Verdict(episode=number) | Action(episode=number):
                    return number >= episode
                case Electrodes(episode=number):
                    return number >= episode or item in decisions
                case _:
                    return True

        self._said = [item for item in self._said if is_needed(item)]

    def recall(self, role: Role) -> Recall:
        """What a process in this role must know."""
        said = sorted(self._said, key=lambda item: item.stamp)
        match role:
            case "policy":
                said = [*_openings(said), *_last_episode(said, (EpisodeStart, MoveOnset, Verdict, Action))]
            case "decoder":
                said = [*_openings(said), *_unjudged(said), *_last_episode(said, (EpisodeStart, MoveOnset, Verdict))]
                said += _last_decision(self._said)
            case "console":
                # Not all moves: the stimulus, which mustn't lose time over it, hears this as well.
                said = [item for item in said if isinstance(item.message, _OUTLINE)]
                said += _last_episode(self._said, (MoveOnset, Verdict)) + _last_decision(self._said)
                said.sort(key=lambda item: item.stamp)
        return Recall(session=self._session, role=role, said=tuple(said))


def _openings(said: Sequence[Said]) -> list[Said]:
    return [item for item in said if isinstance(item.message, SessionStart)]


def _last_number(said: Sequence[Said]) -> int | None:
    return max((item.message.episode for item in said if isinstance(item.message, EpisodeStart)), default=None)


def _last_episode(said: Sequence[Said], kinds: tuple[type[Message], ...]) -> list[Said]:
    last = _last_number(said)
    return [item for item in said if isinstance(item.message, kinds) and getattr(item.message, "episode", None) == last]


def _unjudged(said: Sequence[Said]) -> list[Said]:
    """Moves of earlier episodes that have no verdict."""
    judged = {(item.message.episode, item.message.step) for item in said if isinstance(item.message, Verdict)}
    return [
        item
        for item in said
        if isinstance(item.message, MoveOnset)
        and item.message.episode != _last_number(said)
        and (item.message.episode, item.message.step) not in judged
    ]


def _last_decision(said: Sequence[Said]) -> list[Said]:
    """What holds of the electrodes, whatever episode it was decided in."""
    return [item for item in said if isinstance(item.message, Electrodes)][-1:]
