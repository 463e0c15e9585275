"""Searching without verdicts: for each start the path that meets a hidden goal soonest on average.

Nothing is learnt on the way but that the goal was not met yet, so the whole path can be laid down beforehand. A beam
search keeps the most promising unfinished paths: those with the least expected steps so far and to come.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import STEP, GridWorld
from policy.observation import GOAL_NEXT
from policy.simulator import pair_weights

Ints = NDArray[np.int64]

BEAM = 2000
"""Unfinished paths kept: 300 find paths 0.1 to 0.3 % longer, in a seventh of the time."""
CELLS_A_STEP = 2.3
"""New cells a step of a good search senses: what is left divided by it is how long the rest will take (of 2.0 to 2.6
the result depends by less than 0.1 %)."""
FAR_SHARE = 0.15
"""Weight of goals as the experiment chooses them, one for each distance, against pairs drawn alike. A path for pairs
alone leaves far corners to the end: on `open` it takes 22.9 steps over pairs but 26.7 over the experiment's."""


@cache
def search_paths(world: GridWorld, far_share: float = FAR_SHARE, beam: int = BEAM) -> Ints:
    """Actions of the search from each start, (n_cells, n_steps); -1 after every goal has been sensed."""
    weights = (1 - far_share) * pair_weights(world, "pairs") + far_share * pair_weights(world, "distances")
    paths: dict[int, list[int]] = {}
    turns = symmetries(world)
    for start in range(world.n_cells):
        if start not in paths:
            path = _path(world, start, weights[start], beam)
            for cells, actions in turns:
                paths.setdefault(int(cells[start]), [int(actions[action]) for action in path])
    longest = max(map(len, paths.values()))
    return np.array([paths[start] + [-1] * (longest - len(paths[start])) for start in range(world.n_cells)])


def searching(paths: Ints, step: Ints, sensed: NDArray[np.uint8]) -> Ints:
    """The search's action in each of ``n`` episodes: along its path, (n, n_steps), until the goal is sensed, (n,)."""
    following = paths[np.arange(len(step)), np.minimum(step, paths.shape[1] - 1)]
    return np.where(sensed >= GOAL_NEXT, sensed.astype(np.int64) - GOAL_NEXT, following)


def symmetries(world: GridWorld) -> list[tuple[Ints, Ints]]:
    """Turns and reflections that leave the map as it is: for each the new number of every cell and action."""
    row, column = world.cells.T
    last_row, last_column = world.height - 1, world.width - 1
    number = {(int(r), int(c)): cell for cell, (r, c) in enumerate(world.cells)}
    found = []
    for transposed in (False, True) if world.height == world.width else (False,):
        for down in (False, True):
            for right in (False, True):
                r, c = (last_row - row if down else row), (last_column - column if right else column)
                images = list(zip(*((c, r) if transposed else (r, c)), strict=True))
                if all(image in number for image in images):
                    cells = np.array([number[image] for image in images])
                    found.append((cells, _turned_actions(down, right, transposed)))
    return found


def _turned_actions(down: bool, right: bool, transposed: bool) -> Ints:
    turned = [((-dr if down else dr), (-dc if right else dc)) for dr, dc in STEP]
    return np.array([STEP.index((dc, dr) if transposed else (dr, dc)) for dr, dc in turned])


def _path(world: GridWorld, start: int, weight: NDArray[np.float64], beam: int) -> list[int]:
    """The best path found from one start; ``weight``, (n_cells,), is the probability of each goal."""
    senses = sensed_from(world)
    hidden = np.array([(weight > 0) & ~senses[start]])
    if not hidden.any():
        return []  # no goal begins further away than what is sensed from here
    weight = weight / weight.sum()
    cell, steps = np.array([start]), np.zeros(1)
    moves: list[tuple[Ints, Ints]] = []
    best_steps, best = np.inf, [0]
    while len(cell):
        path, action = np.nonzero(world.legal[cell])
        reached = world.next_cell[cell[path], action]
        left = hidden[path] & ~senses[reached]
        # Each step costs one for every goal that was still hidden before it.
        cost = steps[path] + hidden[path] @ weight
        # What is left is met evenly over the steps it takes.
        promise = cost + left @ weight * (left.sum(axis=1) / CELLS_A_STEP + 1) / 2
        chosen = _distinct(promise, reached, left)[:beam]
        finished = chosen[~left[chosen].any(axis=1)]
        moves.append((path[chosen], action[chosen]))
        if len(finished) and cost[finished].min() < best_steps:
            number = int(np.flatnonzero(chosen == finished[np.argmin(cost[finished])])[0])
            best_steps, best = float(cost[chosen[number]]), _traced(moves, number)
        going_on = left[chosen].any(axis=1) & (cost[chosen] < best_steps)
        chosen = chosen[going_on]
        moves[-1] = path[chosen], action[chosen]
        cell, hidden, steps = reached[chosen], left[chosen], cost[chosen]
    return best


def sensed_from(world: GridWorld) -> NDArray[np.bool_]:
    """Cells an agent senses from each cell, (n_cells, n_cells): its own and those a move away."""
    sensed = np.eye(world.n_cells, dtype=bool)
    sensed[np.arange(world.n_cells)[:, None], world.next_cell] = True
    return sensed


def _distinct(promise: NDArray[np.float64], cell: Ints, hidden: NDArray[np.bool_]) -> Ints:
    """Indices from the most promising on, only the first of those that stand in one cell with the same left to see."""
    order = np.argsort(promise, kind="stable")
    key = np.concatenate([np.packbits(hidden[order], axis=1), cell[order, None].astype(">u4").view(np.uint8)], axis=1)
    _, first = np.unique(key, axis=0, return_index=True)
    return order[np.sort(first)]


def _traced(moves: list[tuple[Ints, Ints]], number: int) -> list[int]:
    actions = []
    for path, action in reversed(moves):
        actions.append(int(action[number]))
        number = int(path[number])
    return actions[::-1]
