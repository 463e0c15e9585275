"""What the agent perceives, in one form for the simulator's thousands of episodes and the live server's one.

The goal is in none of it.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import N_ACTIONS, GridWorld

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STEP_LIMIT = 60  # most moves in an episode with people (paper IV.C), and the maximum of the step number
GOAL_NEXT = 2  # what is sensed, less this, is the action that leads to the goal
N_SENSES = GOAL_NEXT + N_ACTIONS  # nothing; the goal here; the goal through an action


@dataclass(frozen=True)
class View:
    """What ``n`` agents perceive at one step.

    Attributes
    ----------
    move : int64, (n,), the last move, as cell left times 4 plus action; before the first, 4 n_cells plus the start.
    cell : int64, (n,), where the agent is.
    evidence : float32, (n,), on the last move, log P(verdict | error) / P(verdict | correct); 0 without a verdict.
    sensed : uint8, (n,), 0 nothing, 1 the goal is here, 2 .. 5 it is through an action.
    visited : bool, (n, n_cells), cells entered in this episode, the start included.
    step : int64, (n,), moves made so far.
    information : float32, (n,), bits a verdict, as told of the decoder.
    """

    move: Ints
    cell: Ints
    evidence: NDArray[np.float32]
    sensed: NDArray[np.uint8]
    visited: Bools
    step: Ints
    information: NDArray[np.float32]


class Tracker:
    """The view of one live episode: the part of the simulator's book-keeping that needs no goal."""

    def __init__(self, world: GridWorld, start: int, sensed: tuple[bool, ...], information: float) -> None:
        self.world, self._information = world, information
        self._cell, self._move, self._evidence, self._step = start, world.n_cells * N_ACTIONS + start, 0.0, 0
        self._sensed = sensed
        self._visited = np.zeros((1, world.n_cells), bool)
        self._visited[0, start] = True

    def moved(self, action: int, cell: int, sensed: tuple[bool, ...], evidence: float) -> None:
        """Take in one move, the cell it led to, what is sensed there and what the verdict says of it."""
        self._move, self._cell = self._cell * N_ACTIONS + action, cell
        self._sensed, self._evidence = sensed, evidence
        self._visited[0, cell] = True
        self._step += 1

    def view(self) -> View:
        """The view, with n = 1."""
        return View(
            move=np.array([self._move]),
            cell=np.array([self._cell]),
            evidence=np.array([self._evidence], np.float32),
            sensed=_sense_code(np.array([self._sensed])).astype(np.uint8),
            visited=self._visited,
            step=np.array([self._step]),
            information=np.array([self._information], np.float32),
        )


@cache
def sense_codes(world: GridWorld) -> Ints:
    """What is sensed in each cell for each goal (paper IV.A), as in ``View.sensed``, (n_cells, n_cells), cell first."""
    cell = np.arange(world.n_cells)
    around = world.legal[:, None] & (world.next_cell[:, None] == cell[:, None])
    return _sense_code(np.concatenate([(cell[:, None] == cell)[..., None], around], axis=2))


def _sense_code(sensed: Bools) -> Ints:
    code: Ints = np.where(sensed.any(axis=-1), sensed.argmax(axis=-1) + 1, 0)
    return code
