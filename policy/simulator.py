"""Thousands of episodes in parallel on the world's tables, by the same rules as the stimulus.

Nothing here knows a network. A simulator is deterministic from its random generator.
"""

from dataclasses import dataclass
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy.observation import MISSING, NO_ACTION, STEP_LIMIT, View, sensed_table

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

Distribution = Literal["pairs", "distances", "mixture"]
DISTRIBUTIONS: tuple[Distribution, ...] = get_args(Distribution)
MIN_DISTANCE = 2  # the initial distance is more than one (paper IV.C)
MAX_DISTANCE = 20  # one online episode for each initial distance 2..20 (paper IV.C)


@dataclass(frozen=True)
class VerdictModel:
    """A simulated decoder: each verdict is drawn on its own from the truth of the move.

    Attributes
    ----------
    hit : probability that an error is called an error.
    correct_rejection : probability that a correct move is called correct.
    missing : probability that there is no verdict at all.
    """

    hit: float
    correct_rejection: float
    missing: float = 0.0

    @classmethod
    def right(cls, accuracy: float, missing: float = 0.0) -> Self:
        """The paper's model: right with one probability, whatever the truth (paper IV.B)."""
        return cls(accuracy, accuracy, missing)

    def draw(self, error: Bools, rng: np.random.Generator) -> Ints:
        """Draw verdicts, int64, -1 correct, +1 error, 0 missing, for truths ``error`` of the same shape."""
        says_error = rng.random(error.shape) < np.where(error, self.hit, 1 - self.correct_rejection)
        missing = rng.random(error.shape) < self.missing
        return np.where(missing, MISSING, np.where(says_error, 1, -1))

    def likelihood(self) -> Floats:
        """P(verdict | truth), (3, 2): rows missing, error, correct (so ``verdict`` indexes it), columns truth."""
        return np.array([[1.0, 1.0], [1 - self.correct_rejection, self.hit], [self.correct_rejection, 1 - self.hit]])


NO_VERDICTS = VerdictModel(0.5, 0.5, missing=1.0)
COIN_FLIPS = VerdictModel(0.5, 0.5)


def pair_weights(world: GridWorld, distribution: Distribution) -> Floats:
    """Probability of each start and goal, (n_cells, n_cells), start first.

    ``pairs``: every pair at least ``MIN_DISTANCE`` apart alike. ``distances``: every initial distance from
    ``MIN_DISTANCE`` to ``MAX_DISTANCE`` alike, as in the experiment. ``mixture``: half of each, to train on.
    """
    if distribution == "mixture":
        return 0.5 * pair_weights(world, "pairs") + 0.5 * pair_weights(world, "distances")
    far = world.distance >= MIN_DISTANCE
    if not far.any():
        raise SetupError(
            f"Map '{world.name}' must have two cells at least {MIN_DISTANCE} moves apart, but has none. Enlarge it."
        )
    weight: Floats = far.astype(float)
    if distribution == "distances":
        count = np.bincount(world.distance.ravel())
        weight = np.where(far & (world.distance <= MAX_DISTANCE), 1 / count[world.distance], 0.0)
    return weight / float(weight.sum())


@dataclass(frozen=True)
class Outcome:
    """What a step of all episodes led to, before any restart; every array is (n,).

    ``terminated``: the goal is reached. ``truncated``: stopped by the step limit, so the future still has value.
    """

    terminated: Bools
    truncated: Bools
    error: Bools

    @property
    def done(self) -> Bools:
        """Episodes that are over, for either reason."""
        return self.terminated | self.truncated


class Simulator:
    """``n`` episodes at once. ``step`` moves them all, ``restart`` begins those that are over anew.

    Parameters
    ----------
    world : the map.
    n : number of episodes in parallel.
    weights : (n_cells, n_cells), probability of each start and goal, as ``pair_weights`` gives.
    verdicts : the simulated decoder.
    rng : all randomness comes from here.
    limit : steps after which an episode is truncated; 60 in the experiment (paper IV.C).
    """

    def __init__(
        self,
        world: GridWorld,
        n: int,
        weights: Floats,
        verdicts: VerdictModel,
        rng: np.random.Generator,
        limit: int = STEP_LIMIT,
    ) -> None:
        self.world, self.n, self.verdicts, self.rng, self.limit = world, n, verdicts, rng, limit
        self._cumulative = np.cumsum(weights)
        self._sensed = sensed_table(world)
        self.cell, self.goal = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self.action, self.verdict = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self.visited = np.zeros((n, world.n_cells), bool)
        self.step_number = np.zeros(n, np.int64)
        self.restart(np.ones(n, bool))

    def restart(self, which: Bools) -> None:
        """Begin the episodes of the mask ``which``, (n,), at a new start and goal."""
        draws = self.rng.random(int(which.sum())) * self._cumulative[-1]
        pair = np.searchsorted(self._cumulative, draws, side="right")
        self.begin(which, *np.divmod(pair, self.world.n_cells))

    def begin(self, which: Bools, start: Ints, goal: Ints) -> None:
        """Begin the episodes of the mask ``which`` at given starts and goals, one each per true entry."""
        self.cell[which], self.goal[which] = start, goal
        self.action[which], self.verdict[which], self.step_number[which] = NO_ACTION, MISSING, 0
        self.visited[which] = False
        self.visited[np.arange(self.n), self.cell] = True

    def step(self, action: Ints) -> Outcome:
        """Move every episode by its action, (n,)."""
        distance = self.world.distance
        before = distance[self.cell, self.goal]
        self.cell = self.world.next_cell[self.cell, action]
        error = distance[self.cell, self.goal] > before
        self.verdict = self.verdicts.draw(error, self.rng)
        self.action = action.copy()
        self.visited[np.arange(self.n), self.cell] = True
        self.step_number += 1
        terminated = self.cell == self.goal
        return Outcome(terminated, ~terminated & (self.step_number >= self.limit), error)

    def view(self) -> View:
        """What the agents perceive now. It shares memory with the simulator: encode it before the next step."""
        sensed = self._sensed[self.cell, self.goal]
        return View(self.verdict, sensed, self.action, self.visited, self.cell, self.step_number)
