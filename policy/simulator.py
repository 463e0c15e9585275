"""Thousands of episodes in parallel on the world's tables, by the same rules as the stimulus.

Nothing here knows a network. A simulator is deterministic from its random generator.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError
from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import STEP_LIMIT, View, sense_codes
from policy.verdicts import Decoders, Resampled

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

Distribution = Literal["pairs", "distances", "mixture"]
DISTRIBUTIONS: tuple[Distribution, ...] = get_args(Distribution)
MIN_DISTANCE = 2  # the initial distance is more than one (paper IV.C)
MAX_DISTANCE = 20  # one online episode for each initial distance 2..20 (paper IV.C)
FAR_SHARE = 0.3
"""Of the experiment's starts and goals in the mixture. From 0.1 to 0.5 random pairs cost 1 % more steps at accuracies
of 0.6 and 0.7, the experiment's 3 to 6 % fewer (both maps, 10,000 episodes each, the moves a planner starts from)."""


def pair_weights(world: GridWorld, distribution: Distribution) -> Floats:
    """Probability of each start and goal, (n_cells, n_cells), start first.

    ``pairs``: every pair at least ``MIN_DISTANCE`` apart alike. ``distances``: every initial distance from
    ``MIN_DISTANCE`` to ``MAX_DISTANCE`` alike, as in the experiment. ``mixture``: of both, by `FAR_SHARE`, to train on.
    """
    if distribution == "mixture":
        pairs, distances = pair_weights(world, "pairs"), pair_weights(world, "distances")
        return (1 - FAR_SHARE) * pairs + FAR_SHARE * distances
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


class Pairs:
    """Draws starts and goals.

    Parameters
    ----------
    weights : (n_cells, n_cells), probability of each start and goal, as ``pair_weights`` gives.
    """

    def __init__(self, weights: Floats) -> None:
        self._cumulative = np.cumsum(weights)
        self._n_cells = len(weights)

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Ints, Ints]:
        """``n`` starts and as many goals."""
        return self._at(rng.random(n))

    def spread(self, n: int, rng: np.random.Generator) -> tuple[Ints, Ints]:
        """``n`` starts and goals, each pair as nearly as often as it should be: less noise in the means over them."""
        return self._at((np.arange(n) + rng.random(n)) / n)

    def _at(self, quantiles: Floats) -> tuple[Ints, Ints]:
        pair = np.searchsorted(self._cumulative, quantiles * self._cumulative[-1], side="right")
        start, goal = np.divmod(np.minimum(pair, self._n_cells**2 - 1), self._n_cells)
        return start, goal


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
    start, goal : (n,), where the episodes begin and end.
    decoders : the simulated decoder of each.
    rng : all randomness comes from here.
    limit : steps after which an episode is truncated; 60 in the experiment (paper IV.C).
    """

    def __init__(
        self,
        world: GridWorld,
        start: Ints,
        goal: Ints,
        decoders: Decoders | Resampled,
        rng: np.random.Generator,
        limit: int = STEP_LIMIT,
    ) -> None:
        self.world, self.decoders, self.rng, self.limit = world, decoders, rng, limit
        self._next = world.next_cell.ravel()
        # 8 bits an entry: the tables of a map then stay in the processor's first cache.
        self._distance = world.distance.ravel().astype(np.uint8 if world.distance.max() < 256 else np.uint16)
        self._senses = sense_codes(world).ravel().astype(np.uint8)
        n = len(start)
        self.start, self.cell, self.goal = start.copy(), start.copy(), goal.copy()
        self.move = np.zeros(n, np.int64)
        self.evidence, self.step_number = np.zeros(n, np.float32), np.zeros(n, np.int64)
        self.visited = np.zeros((n, world.n_cells), bool)
        self._left = self._distance[self.cell * world.n_cells + self.goal]
        self.begin(np.ones(n, bool), start, goal)

    @property
    def n(self) -> int:
        """Number of episodes."""
        return len(self.cell)

    def begin(self, which: Bools, start: Ints, goal: Ints, decoders: Decoders | None = None) -> None:
        """Begin the episodes of the mask ``which`` at given starts and goals, one each per true entry."""
        self.start[which], self.cell[which], self.goal[which] = start, start, goal
        self.move[which] = self.world.n_cells * N_ACTIONS + start
        self.evidence[which], self.step_number[which] = 0, 0
        self.visited[which] = False
        self.visited[np.flatnonzero(which), start] = True
        self._left[which] = self._distance[start * self.world.n_cells + goal]
        if decoders is not None:
            self.decoders.put(which, decoders)  # type: ignore[arg-type]

    def step(self, action: Ints) -> Outcome:
        """Move every episode by its action, (n,)."""
        self.move = self.cell * N_ACTIONS + action
        self.cell = self._next[self.move]
        left = self._distance[self.cell * self.world.n_cells + self.goal]
        error = left > self._left
        self._left = left
        self.evidence = self.decoders.evidence(error, self.rng)
        self.visited[np.arange(self.n), self.cell] = True
        self.step_number += 1
        terminated = left == 0
        return Outcome(terminated, ~terminated & (self.step_number >= self.limit), error)

    def view(self) -> View:
        """What the agents perceive now. It shares memory with the simulator: use it before the next step."""
        sensed = self._senses[self.cell * self.world.n_cells + self.goal]
        return View(
            self.move, self.cell, self.evidence, sensed, self.visited, self.step_number, self.decoders.information
        )

    def keep(self, which: Bools) -> None:
        """Go on with the episodes of the mask ``which`` only."""
        self.decoders = self.decoders.take(which)
        for name in ("start", "cell", "goal", "move", "evidence", "step_number", "visited", "_left"):
            setattr(self, name, getattr(self, name)[which])
