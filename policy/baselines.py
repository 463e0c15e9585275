"""What is reachable: the exact Bayes filter over the goal's cell, with a greedy move.

It is the yardstick of every policy and the teacher of their warm start.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import View, sensed_table
from policy.simulator import NO_VERDICTS, Bools, Floats, Ints, VerdictModel

Belief = NDArray[np.float32]

# How the greedy move weighs near against far goals. Ours: of 0.2, 0.3, 0.4, 0.6, .. 0.95 the fewest steps at 70-80 %
# on both maps, and without verdicts on `open`. Towards 1 it minimises the expected distance, which dithers in the
# middle of a wide belief.
NEARNESS, NEARNESS_WITHOUT_VERDICTS = 0.6, 0.3


@cache
def error_table(world: GridWorld) -> NDArray[np.int64]:
    """Whether a move is an error (1) for each goal, (n_cells, 4, n_cells): cell left, action, goal."""
    return (world.distance[world.next_cell] > world.distance[:, None]).astype(np.int64)


@cache
def nearness_table(world: GridWorld, nearness: float) -> NDArray[np.float32]:
    """``nearness`` to the power of the distance after a move, (n_cells, 4, n_cells): cell left, action, goal."""
    return (nearness ** world.distance[world.next_cell]).astype(np.float32)


def _sense_code(sensed: Bools) -> Ints:
    """What is sensed, (..., 5), as one number: 0 nothing, 1 here, 2 .. 5 through an action."""
    code: Ints = np.where(sensed.any(axis=-1), sensed.argmax(axis=-1) + 1, 0)
    return code


class BayesFilter:
    """The probability of each goal cell given all that ``n`` agents have perceived.

    Parameters
    ----------
    world : the map.
    n : number of episodes in parallel.
    weights : (n_cells, n_cells), probability of each start and goal: the prior.
    verdicts : the decoder as the filter believes it to be.

    Attributes
    ----------
    belief : float32, (n, n_cells), each row sums to one.
    """

    def __init__(self, world: GridWorld, n: int, weights: Floats, verdicts: VerdictModel) -> None:
        self.world = world
        self._prior = weights.astype(np.float32)
        self._likelihood = verdicts.likelihood().astype(np.float32)
        self._nearness = NEARNESS_WITHOUT_VERDICTS if verdicts == NO_VERDICTS else NEARNESS
        self._cell = np.zeros(n, np.int64)
        self.belief: Belief = np.zeros((n, world.n_cells), np.float32)

    def begin(self, which: Bools, view: View) -> None:
        """Start the episodes of the mask ``which``, (n,), from the prior and what is sensed at the start."""
        start = view.cell[which]
        self._cell[which] = start
        self.belief[which] = self._prior[start] * self._agrees(start, view.sensed[which])
        self._normalise()

    def update(self, view: View) -> None:
        """Take in one move of every episode: its verdict and what is sensed where it led."""
        error = error_table(self.world)[self._cell, view.action]
        self.belief *= self._likelihood[view.verdict[:, None], error]
        self.belief *= self._agrees(view.cell, view.sensed)
        self._cell = view.cell.copy()
        self._normalise()

    def worth(self) -> NDArray[np.float32]:
        """Expected nearness of the goal after each action, (n, 4); -1 where it is illegal."""
        nearness = nearness_table(self.world, self._nearness)[self._cell]
        expected = np.matmul(nearness, self.belief[:, :, None])[:, :, 0]
        return np.where(self.world.legal[self._cell], expected, np.float32(-1))

    def greedy(self, rng: np.random.Generator) -> Ints:
        """The action of most worth, (n,); equal ones are drawn."""
        worth = self.worth()
        actions: Ints = np.argmax(worth * (1 + 1e-6 * rng.random((len(worth), N_ACTIONS))), axis=1)
        return actions

    def _agrees(self, cell: Ints, sensed: Bools) -> Bools:
        """Goals for which just this would be sensed in the cells, (n, n_cells)."""
        agrees: Bools = _sense_code(sensed_table(self.world))[cell] == _sense_code(sensed)[:, None]
        return agrees

    def _normalise(self) -> None:
        self.belief /= np.maximum(self.belief.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
