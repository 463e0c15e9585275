"""The exact Bayes filter over the goal's cell: all that ``n`` agents can know from what they perceived."""

from collections.abc import Sequence
from copy import copy
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import N_SENSES, View, sense_codes
from policy.simulator import Bools, Floats, Ints

Float32s = NDArray[np.float32]


@cache
def error_table(world: GridWorld) -> Float32s:
    """1 where a move is an error for a goal, else 0, (n_cells * 4, n_cells): move as in `View`, goal."""
    error = world.distance[world.next_cell] > world.distance[:, None]
    table: Float32s = error.reshape(-1, world.n_cells).astype(np.float32)
    return table


@cache
def _agreement(world: GridWorld) -> Float32s:
    """1 where a goal would be sensed just so, (n_cells * N_SENSES, n_cells)."""
    agrees = sense_codes(world)[:, None] == np.arange(N_SENSES)[:, None]
    table: Float32s = agrees.reshape(-1, world.n_cells).astype(np.float32)
    return table


class Belief:
    """The probability of each goal cell.

    Parameters
    ----------
    world : the map.
    weights : (n_cells, n_cells), probability of each start and goal: the prior.
    view : of episodes at their beginning.

    Attributes
    ----------
    probability : float32, (n, n_cells), each row sums to one.
    cell : int64, (n,), where the agents are.
    """

    def __init__(self, world: GridWorld, weights: Floats, view: View) -> None:
        self.world = world
        self._prior = weights.astype(np.float32)
        self.cell = view.cell.copy()
        self.probability = np.empty((len(view.cell), world.n_cells), np.float32)
        self.begin(np.ones(len(view.cell), bool), view)

    def begin(self, which: Bools, view: View) -> None:
        """Start the episodes of the mask ``which``, (n,), from the prior and what is sensed at the start."""
        start = view.cell[which]
        self.cell[which] = start
        self.probability[which] = _normalised(self._prior[start] * self._agrees(start, view.sensed[which]))

    def update(self, view: View) -> None:
        """Take in one move of every episode: what its verdict says, and what is sensed where it led."""
        # A goal for which the move was an error gains by the factor e^evidence against one for which it wasn't.
        gain = np.expm1(view.evidence)[:, None] * error_table(self.world)[view.move]
        gain += 1
        gain *= self._agrees(view.cell, view.sensed)
        gain *= self.probability
        self.probability = _normalised(gain)
        self.cell = view.cell.copy()

    def keep(self, which: Bools | Ints) -> None:
        """Go on with the episodes ``which``, a mask (n,) or indices, only."""
        self.cell, self.probability = self.cell[which], self.probability[which]

    def of(self, which: Bools | Ints) -> "Belief":
        """The belief of the episodes ``which`` alone; this one goes on with all."""
        part = copy(self)
        part.keep(which)
        return part

    @staticmethod
    def joined(parts: Sequence["Belief"]) -> "Belief":
        """The beliefs of all parts, one after another."""
        whole = copy(parts[0])
        whole.cell = np.concatenate([part.cell for part in parts])
        whole.probability = np.concatenate([part.probability for part in parts])
        return whole

    def _agrees(self, cell: NDArray[np.int64], sensed: NDArray[np.uint8]) -> Float32s:
        agrees: Float32s = _agreement(self.world)[cell * N_SENSES + sensed]
        return agrees


def _normalised(belief: Float32s) -> Float32s:
    belief /= np.maximum(belief.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return belief


class Nearness:
    """How near each action brings the goal: the expected ``discount`` to the power of the distance after it.

    Towards a discount of 0 only a goal next door counts; towards 1 it is the expected distance, which dithers in the
    middle of a wide belief.

    Parameters
    ----------
    world : the map.
    discounts : one worth for each, side by side.
    """

    def __init__(self, world: GridWorld, discounts: tuple[float, ...]) -> None:
        self.world, self.n = world, len(discounts)
        tables = [discount ** world.distance[world.next_cell] for discount in discounts]
        self._table = np.concatenate(tables, axis=1).astype(np.float32)

    def worth(self, belief: Belief) -> Float32s:
        """Worth of each action, (n, n_discounts, 4); -1 where it is illegal."""
        worth = np.matmul(self._table[belief.cell], belief.probability[:, :, None])
        worth = worth.reshape(-1, self.n, N_ACTIONS)
        return np.where(self.world.legal[belief.cell][:, None], worth, np.float32(-1))
