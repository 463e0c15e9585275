"""Searching while verdicts say little: after every move the laid-down paths are weighed anew with what is believed now.

A search laid down at the start takes no notice of verdicts; the greedy move on the belief looks no further than the
nearest likely goal. In between lies open-loop feedback control (Bertsekas, Dynamic Programming and Optimal Control,
4th ed. 2017, chapter 6): go as if nothing more were to be learnt, along the path of the fewest expected moves, and
think again after each move. Without verdicts it is the search itself.
"""

import numpy as np

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.belief import Belief, Float32s
from policy.coverage import sensed_from
from policy.simulator import Bools, Ints


class Replanning:
    """The moves each action costs, at best, until the goal is reached.

    Weighed are the rest of every laid-down path that comes by, and for each cell the shortest way there and its own
    laid-down path.

    Parameters
    ----------
    world : the map.
    paths : (n_cells, n_steps), the search from each cell, as ``coverage.search_paths`` gives it.
    """

    def __init__(self, world: GridWorld, paths: Ints) -> None:
        self.world = world
        cells, rests = _along(world, paths)
        towards, ways = _towards(world, rests[:, 0])
        self._moves: list[Float32s] = []  # of each cell: (n_paths, n_cells), by the goal's cell
        self._first: list[Ints] = []  # of each cell: where the paths that begin with each of `_action` begin
        self._action: list[Ints] = []
        others = ~np.eye(world.n_cells, dtype=bool)
        for cell in range(world.n_cells):
            by, to = (cells[:, :-1] == cell) & (paths >= 0), others[cell]
            actions = np.concatenate([paths[by], towards[cell, to]])
            # The first move is made whatever is sensed here: it is what is being weighed.
            moves = 1 + np.concatenate([rests[:, 1:][by], ways[world.next_cell[cell, towards[cell, to]], to]])
            distinct = np.unique(np.column_stack([actions, moves]), axis=0)
            action, first = np.unique(distinct[:, 0], return_index=True)
            self._moves.append(distinct[:, 1:].astype(np.float32))
            self._action.append(action.astype(np.int64))
            self._first.append(first)

    def cost(self, belief: Belief) -> Float32s:
        """Expected moves to the goal by the first action, (n, 4); infinite where it is illegal."""
        cost = np.full((len(belief.cell), N_ACTIONS), np.inf, np.float32)
        order = np.argsort(belief.cell, kind="stable")
        bounds = np.searchsorted(belief.cell[order], np.arange(self.world.n_cells + 1))
        for cell in np.unique(belief.cell):
            rows = order[bounds[cell] : bounds[cell + 1]]
            expected = belief.probability[rows] @ self._moves[cell].T
            cost[rows[:, None], self._action[cell]] = np.minimum.reduceat(expected, self._first[cell], axis=1)
        return cost


def _along(world: GridWorld, paths: Ints) -> tuple[Ints, Ints]:
    """Where each path is at each step, (n_cells, n_steps + 1), and the moves from there to each goal, (..., n_cells).

    A goal is entered as soon as it is sensed. One that the rest of a path doesn't sense is met on the path that is laid
    down from its end.
    """
    n_steps = paths.shape[1]
    cells = np.empty((world.n_cells, n_steps + 1), np.int64)
    cells[:, 0] = np.arange(world.n_cells)
    for step in range(n_steps):
        here, action = cells[:, step], paths[:, step]
        cells[:, step + 1] = np.where(action < 0, here, world.next_cell[here, np.maximum(action, 0)])
    senses, rests = sensed_from(world), np.empty((world.n_cells, n_steps + 1, world.n_cells), np.int64)
    rests[:, 0] = n_steps  # more than any path; only until the paths themselves are known
    for _ in range(2):
        rests[:, -1] = _unless_sensed(world, senses, cells[:, -1], rests[cells[:, -1], 0])
        for step in range(n_steps - 1, -1, -1):
            goes_on = rests[:, step + 1] + (paths[:, step, None] >= 0)
            rests[:, step] = _unless_sensed(world, senses, cells[:, step], goes_on)
    return cells, rests


def _towards(world: GridWorld, full: Ints) -> tuple[Ints, Ints]:
    """From each cell the first action of a shortest way to each other, and the moves to each goal on it and beyond.

    Parameters
    ----------
    full : (n_cells, n_cells), the moves from each start to each goal along the laid-down path.

    Returns
    -------
    (n_cells, n_cells) and (n_cells, n_cells, n_cells): from, towards, goal.
    """
    action = world.distance[world.next_cell].argmin(axis=1)
    senses, moves = sensed_from(world), np.empty((world.n_cells,) * 3, np.int64)
    cell = np.arange(world.n_cells)
    moves[cell, cell] = full
    for distance in range(1, int(world.distance.max()) + 1):
        here, there = np.nonzero(world.distance == distance)
        following = world.next_cell[here, action[here, there]]
        moves[here, there] = _unless_sensed(world, senses, here, 1 + moves[following, there])
    return action, moves


def _unless_sensed(world: GridWorld, senses: Bools, cell: Ints, moves: Ints) -> Ints:
    """The moves to each goal, (n, n_cells): straight to one that is sensed from the cell, (n,), else as given."""
    found: Ints = np.where(senses[cell], world.distance[cell], moves)
    return found
