"""Sets of moves, a bit each: what is heard of a run that lasts all day takes no room to speak of. Pure."""

from collections.abc import Iterable, Iterator, MutableSet

Key = tuple[int, int]
"""(episode, step), neither below 0."""


class MoveSet(MutableSet[Key]):
    """A set of (episode, step)."""

    def __init__(self, moves: Iterable[Key] = ()) -> None:
        self._steps: dict[int, int] = {}  # by episode: a number whose bits are its steps
        for move in moves:
            self.add(move)

    def __contains__(self, move: object) -> bool:
        """Whether it holds a move."""
        if not isinstance(move, tuple):
            return False
        episode, step = move
        return bool(self._steps.get(episode, 0) >> step & 1)

    def __iter__(self) -> Iterator[Key]:
        """All moves, in the order of their steps within an episode."""
        for episode, steps in self._steps.items():
            for step in range(steps.bit_length()):
                if steps >> step & 1:
                    yield episode, step

    def __len__(self) -> int:
        """How many."""
        return sum(steps.bit_count() for steps in self._steps.values())

    def add(self, move: Key) -> None:
        """Take in a move, if it isn't there yet."""
        episode, step = move
        self._steps[episode] = self._steps.get(episode, 0) | 1 << step

    def discard(self, move: Key) -> None:
        """Leave out a move, if it is there."""
        if move in self:
            episode, step = move
            self._steps[episode] ^= 1 << step
