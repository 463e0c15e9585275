"""The one input layout of the policy, for the simulator's thousands of episodes and the live server's one.

Everything the agent perceives is a ``View``; ``encode`` turns views into network inputs. The goal is in none of it.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import N_ACTIONS, GridWorld

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LAYOUT = "binary-1"  # name and version; a policy trained on another layout is refused
CORRECT, MISSING, ERROR = -1, 0, 1
VERDICTS = {"correct": CORRECT, "missing": MISSING, "error": ERROR}
NO_ACTION = -1  # before the first move
STEP_LIMIT = 60  # most moves in an episode with people (paper IV.C), and the maximum of the step number


@dataclass(frozen=True)
class View:
    """What ``n`` agents perceive at one step.

    Attributes
    ----------
    verdict : int64, (n,), on the last move: -1 correct, +1 error, 0 missing or no move yet.
    sensed : bool, (n, 5), goal here, then through each of the four actions.
    action : int64, (n,), the last action, -1 before the first.
    visited : bool, (n, n_cells), cells entered in this episode, the start included.
    cell : int64, (n,), where the agent is.
    step : int64, (n,), moves made so far.
    """

    verdict: Ints
    sensed: Bools
    action: Ints
    visited: Bools
    cell: Ints
    step: Ints


@cache
def fields(world: GridWorld) -> dict[str, slice]:
    """Name and columns of each part of an input, in order.

    ``verdict`` is the sign, so that a score can take its place in a later layout; ``verdict_given`` says whether
    there is one. ``row`` and ``column`` are one-hot: a linear layer can then address every line of the map.
    """
    sizes = {
        "verdict": 1,
        "verdict_given": 1,
        "sensed": 1 + N_ACTIONS,
        "action": N_ACTIONS,
        "judged_action": N_ACTIONS,
        "legal": N_ACTIONS,
        "step": 1,
        "row": world.height,
        "column": world.width,
        "visited": world.n_cells,
    }
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def input_size(world: GridWorld) -> int:
    """Number of inputs of the network on this map."""
    return int(fields(world)["visited"].stop)


def encode(world: GridWorld, view: View) -> NDArray[np.float32]:
    """Network inputs, float32, (n, input_size), every one divided by its maximum."""
    rows = np.arange(len(view.cell))
    at = {name: columns.start for name, columns in fields(world).items()}
    inputs = np.zeros((len(rows), input_size(world)), np.float32)
    inputs[:, at["verdict"]] = view.verdict
    inputs[:, at["verdict_given"]] = view.verdict != MISSING
    inputs[:, fields(world)["sensed"]] = view.sensed
    moved = view.action != NO_ACTION
    inputs[rows[moved], at["action"] + view.action[moved]] = 1
    inputs[rows[moved], at["judged_action"] + view.action[moved]] = view.verdict[moved]
    inputs[:, fields(world)["legal"]] = world.legal[view.cell]
    inputs[:, at["step"]] = np.minimum(view.step / STEP_LIMIT, 1)
    inputs[rows, at["row"] + world.cells[view.cell, 0]] = 1
    inputs[rows, at["column"] + world.cells[view.cell, 1]] = 1
    inputs[:, fields(world)["visited"]] = view.visited
    return inputs


class Tracker:
    """The view of one live episode: the part of the simulator's book-keeping that needs no goal."""

    def __init__(self, world: GridWorld, start: int, sensed: tuple[bool, ...]) -> None:
        self.world = world
        self.cell, self.action, self.verdict, self.step_number = start, NO_ACTION, MISSING, 0
        self.sensed = sensed
        self.visited = np.zeros(world.n_cells, bool)
        self.visited[start] = True

    def moved(self, action: int, cell: int, sensed: tuple[bool, ...], verdict: int) -> None:
        """Take in one move, the cell it led to, what is sensed there and the verdict on it."""
        self.action, self.cell, self.sensed, self.verdict = action, cell, sensed, verdict
        self.visited[cell] = True
        self.step_number += 1

    def view(self) -> View:
        """The view, with n = 1."""
        return View(
            verdict=np.array([self.verdict]),
            sensed=np.array([self.sensed]),
            action=np.array([self.action]),
            visited=self.visited[None],
            cell=np.array([self.cell]),
            step=np.array([self.step_number]),
        )


@cache
def sensed_table(world: GridWorld) -> Bools:
    """What is sensed in each cell for each goal, bool, (n_cells, n_cells, 5), cell first (paper IV.A)."""
    cell = np.arange(world.n_cells)
    around = world.legal[:, None] & (world.next_cell[:, None] == cell[:, None])
    return np.concatenate([(cell[:, None] == cell)[..., None], around], axis=2)
