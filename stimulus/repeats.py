"""Which moves of a calibration's block must be made again, because their epochs were rejected."""

import math
from collections import deque
from typing import Literal

MOST_REPEATED = 0.5
"""Share of a block's moves that may be repeated: with more rejected, the electrodes want looking at (decided)."""
MOST_UNTIMELY = 1.0
"""The same of those whose samples came at the wrong time, or were lost with a decoder: one that hangs is ended after
some seconds, which at high speed are many moves (decided)."""
Key = tuple[int, int]
"""(episode, step)."""


class Repeats:
    """Follows the moves and verdicts of one block after the other.

    Parameters
    ----------
    moves_per_block : None for a run without blocks, in which nothing is repeated.
    """

    def __init__(self, moves_per_block: int | None) -> None:
        self.is_on = moves_per_block is not None
        self.most = {
            by_time: math.ceil(share * (moves_per_block or 0))
            for by_time, share in ((False, MOST_REPEATED), (True, MOST_UNTIMELY))
        }
        """Moves of a block that are repeated, at most, by whether they were rejected by time."""
        self._unjudged: dict[Key, bool] = {}  # of this block; whether each was an error
        self._again: deque[bool] = deque()  # the same of moves still to be repeated
        self._n = {False: 0, True: 0}  # in this block

    def begin(self) -> None:
        """A new block."""
        self._n = {False: 0, True: 0}
        self._again.clear()

    def made(self, key: Key, error: bool) -> None:
        """A move was made, and its verdict is awaited."""
        if self.is_on:
            self._unjudged[key] = error

    def judged(self, key: Key, outcome: str, by_time: bool) -> Literal["known", "valid", "again", "last"]:
        """Take a verdict: it isn't awaited, the move is valid, must be made again, or is the last that may be."""
        error = self._unjudged.pop(key, None)
        if error is None:
            return "known"
        if outcome != "rejected" or self._n[by_time] >= self.most[by_time]:
            return "valid"
        self._again.append(error)
        self._n[by_time] += 1
        return "last" if self._n[by_time] == self.most[by_time] else "again"

    def take(self) -> bool | None:
        """Whether the next move to be made again was an error; None where there is none."""
        return self._again.popleft() if self._again else None

    def give_up(self) -> int:
        """Take the moves whose verdicts stay away for valid; how many."""
        n_missing = len(self._unjudged)
        self._unjudged.clear()
        return n_missing

    @property
    def any_left(self) -> bool:
        """Whether a move is still to be made again."""
        return bool(self._again)

    @property
    def is_undecided(self) -> bool:
        """Whether a verdict is awaited."""
        return bool(self._unjudged)
