"""A few moves to get used to, before the first that counts: the same picture at the same pace, and nothing is sent."""

from collections.abc import Callable
from enum import Enum, auto
from random import Random

from bci_app.config import StimulusConfig
from bci_app.gridworld import GridWorld
from stimulus.episodes import Episode, calibration_action, random_episodes
from stimulus.scene import Scene, countdown_at

WRONG_EVERY = 3
"""Every third move is an error, where one is possible: both kinds must have been seen (decided)."""


class Stage(Enum):
    """Of a move."""

    LOOK = auto()
    COUNTDOWN = auto()
    ARROW = auto()
    REST = auto()
    OVER = auto()


class Practice:
    """Moves that don't count. They draw on a chance of their own, so the run's moves are the same without them.

    Parameters
    ----------
    n_moves : how many.
    seed : of the run.
    """

    def __init__(self, times: StimulusConfig, world: GridWorld, n_moves: int, seed: int) -> None:
        self._times, self._world, self._left = times, world, n_moves
        rng = Random(f"practice {seed}")
        self._episodes = random_episodes(world, rng)
        self._choose: Callable[[int, int, float], int] = lambda cell, goal, error: calibration_action(
            world, cell, goal, rng, error
        )
        self._made = 0
        self._episode = Episode(0, 0)
        self._cell = 0
        self._last_move: tuple[int, int] | None = None
        self._stage = Stage.OVER
        self.due = 0.0
        """Session time of the next change."""

    @property
    def is_over(self) -> bool:
        """Whether all moves have been shown."""
        return self._stage is Stage.OVER

    def begin(self, now: float) -> None:
        """Show a new start: at first, and after a pause."""
        self._episode = next(self._episodes)
        self._cell, self._last_move = self._episode.start, None
        self._wait(Stage.LOOK if self._left else Stage.OVER, now + self._times.rest_s)

    def advance(self, now: float) -> None:
        """Go on to what is due."""
        match self._stage:
            case Stage.LOOK:
                self._wait(Stage.COUNTDOWN, self.due + self._times.countdown_s)
            case Stage.COUNTDOWN:
                self._jump()
                self._wait(Stage.ARROW, self.due + self._times.arrow_s)
            case Stage.ARROW:
                self._wait(Stage.REST, self.due + self._times.rest_s)
            case Stage.REST if not self._left:
                self._stage = Stage.OVER
            case Stage.REST if self._cell == self._episode.goal:
                self.begin(now)
            case Stage.REST:
                self._wait(Stage.COUNTDOWN, self.due + self._times.countdown_s)

    def scene(self, now: float, light: bool = False) -> Scene:
        """What belongs on the screen at `now`; `light` is the photodiode's, which practice leaves as it is."""
        is_counting = self._stage is Stage.COUNTDOWN
        countdown = countdown_at(now, self.due, self._times.countdown_s) if is_counting else None
        arrow = self._last_move if self._stage is Stage.ARROW else None
        return Scene(self._world, self._cell, self._episode.goal, countdown, arrow, screen="practising", light=light)

    def _jump(self) -> None:
        self._made += 1
        self._left -= 1
        action = self._choose(self._cell, self._episode.goal, float(self._made % WRONG_EVERY == 0))
        self._last_move = self._cell, action
        self._cell = int(self._world.next_cell[self._last_move])

    def _wait(self, stage: Stage, due: float) -> None:
        self._stage, self.due = stage, due
