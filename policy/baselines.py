"""What is reachable: the exact Bayes filter over the goal's cell, with a greedy move.

It is the yardstick of every policy and the teacher of their warm start.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import View, sensed_table
from policy.simulator import Bools, Floats, Ints, VerdictModel

Belief = NDArray[np.float32]


@cache
def error_table(world: GridWorld) -> NDArray[np.int64]:
    """Whether a move is an error (1) for each goal, (n_cells, 4, n_cells): cell left, action, goal."""
    return (world.distance[world.next_cell] > world.distance[:, None]).astype(np.int64)


@cache
def closer_table(world: GridWorld) -> NDArray[np.float32]:
    """Whether a move shortens the path (1) for each goal, (n_cells, 4, n_cells): cell left, action, goal."""
    return (world.distance[world.next_cell] < world.distance[:, None]).astype(np.float32)


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
        # The last factor of a fully uninformative decoder is 1/2 for all goals, and drops out.
        self._likelihood = verdicts.likelihood().astype(np.float32)
        self._cell = np.zeros(n, np.int64)
        self.belief: Belief = np.zeros((n, world.n_cells), np.float32)

    def begin(self, which: Bools, view: View) -> None:
        """Start the episodes of the mask ``which``, (n,), from the prior and what is sensed at the start."""
        start = view.cell[which]
        self._cell[which] = start
        self.belief[which] = self._prior[start] * self._senses(start, view.sensed[which])
        self._normalise()

    def update(self, view: View) -> None:
        """Take in one move of every episode: its verdict and what is sensed where it led."""
        error = error_table(self.world)[self._cell, view.action]
        self.belief *= self._likelihood[view.verdict[:, None], error]
        self.belief *= self._senses(view.cell, view.sensed)
        self._cell = view.cell.copy()
        self._normalise()

    def progress(self) -> NDArray[np.float32]:
        """Probability that each action shortens the path, (n, 4); -1 where it is illegal."""
        closer = closer_table(self.world)[self._cell]
        # Every move changes the distance by one (a grid has no odd cycles), so the largest probability
        # is also the smallest expected distance.
        chance = np.matmul(closer, self.belief[:, :, None])[:, :, 0]
        return np.where(self.world.legal[self._cell], chance, np.float32(-1))

    def greedy(self, rng: np.random.Generator) -> Ints:
        """The action most likely to shorten the path, (n,); equal ones are drawn."""
        progress = self.progress()
        return np.argmax(progress + 1e-6 * rng.random((len(progress), N_ACTIONS)), axis=1)

    def _senses(self, cell: Ints, sensed: Bools) -> Bools:
        """Goals that agree with what is sensed, (n, n_cells): the one sensed, else all that would not be."""
        hidden = self._hidden()[cell]
        goal = np.concatenate([cell[:, None], self.world.next_cell[cell]], axis=1)[
            np.arange(len(cell)), np.argmax(sensed, axis=1)
        ]
        only = goal[:, None] == np.arange(self.world.n_cells)
        return np.where(sensed.any(axis=1)[:, None], only, hidden)

    def _hidden(self) -> Bools:
        return ~sensed_table(self.world).any(axis=2)

    def _normalise(self) -> None:
        self.belief /= np.maximum(self.belief.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
