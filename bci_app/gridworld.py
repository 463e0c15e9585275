"""The world as tables: a map file compiles into moves and distances that everybody indexes.

The stimulus, the simulator, the Bayes baseline and the truth labels share these arrays, so there is one set of rules.
"""

import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError

ACTIONS = ("north", "south", "west", "east")
N_ACTIONS = len(ACTIONS)
STEP = ((-1, 0), (1, 0), (0, -1), (0, 1))  # (row, column) of each action
FREE, OBSTACLE = ".", "#"
SHIPPED_MAPS = ("open", "obstacles")
BORDER = 2
"""Cells from the wall that count as edge. The paper gives no number, its Fig. 10 is a drawing; the first experiment's
maps of the gradient count as many (decided)."""


@dataclass(frozen=True, eq=False)
class GridWorld:
    """A compiled map. Cells are numbered row by row over the free cells only.

    Attributes
    ----------
    name : file name without its ending; ``open`` and ``obstacles`` are shipped.
    height, width : number of rows and columns.
    cells : int64, (n_cells, 2), row and column of each free cell.
    next_cell : int64, (n_cells, 4), the cell each of ``ACTIONS`` leads to; the cell itself when illegal.
    legal : bool, (n_cells, 4), False where an obstacle or the border is in the way.
    distance : int64, (n_cells, n_cells), shortest path in moves.
    digest : SHA-256 of the layout, to tell maps of the same name apart.
    """

    name: str
    height: int
    width: int
    cells: NDArray[np.int64]
    next_cell: NDArray[np.int64]
    legal: NDArray[np.bool_]
    distance: NDArray[np.int64]
    digest: str

    @property
    def n_cells(self) -> int:
        """Number of free cells."""
        return len(self.cells)

    def cell_at(self, row: int, column: int) -> int:
        """The cell at a row and column; ValueError where none is free."""
        found = np.flatnonzero((self.cells == (row, column)).all(axis=1))
        if not len(found):
            raise ValueError(f"no free cell at row {row}, column {column} of map '{self.name}'")
        return int(found[0])

    def is_error(self, cell: int, action: int, goal: int) -> bool:
        """ErrP truth (paper V.A.1): True when the move makes the shortest path to the goal longer."""
        return bool(self.distance[self.next_cell[cell, action], goal] > self.distance[cell, goal])

    def goal_sensed(self, cell: int, goal: int) -> tuple[bool, bool, bool, bool, bool]:
        """What the agent senses (paper IV.A): goal here, and through each of the four actions."""
        around = (self.legal[cell] & (self.next_cell[cell] == goal)).tolist()
        return (cell == goal, around[0], around[1], around[2], around[3])

    def layout(self) -> list[str]:
        """The map as lines of text, as in its file."""
        rows = [[OBSTACLE] * self.width for _ in range(self.height)]
        for row, column in self.cells.tolist():
            rows[row][column] = FREE
        return ["".join(row) for row in rows]


def area_of(position: tuple[int, int], height: int, width: int, border: int = BORDER) -> str:
    """``edge`` within `border` cells of the grid's border, else ``central``."""
    row, column = position
    return "edge" if min(row, column, height - 1 - row, width - 1 - column) < border else "central"


def compile_map(text: str, name: str) -> GridWorld:
    """Compile the text of a map: one line a row, ``.`` free, ``#`` obstacle.

    Raises SetupError for ragged rows, other characters, fewer than two free cells or unreachable cells.
    """
    rows = [line.rstrip() for line in text.strip("\r\n").splitlines()]
    _check_characters(rows, name)
    free = np.array([[char == FREE for char in row] for row in rows])
    cells = np.argwhere(free)
    number = np.full(free.shape, -1)
    number[free] = np.arange(len(cells))
    padded = np.pad(number, 1, constant_values=-1)
    neighbour = np.stack([padded[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc] for dr, dc in STEP], axis=1)
    legal = neighbour >= 0
    next_cell = np.where(legal, neighbour, np.arange(len(cells))[:, None])
    distance = _distances(next_cell)
    if (distance < 0).any():
        row, column = cells[int(np.argmax(distance[0] < 0))]
        raise SetupError(
            f"Map '{name}' has unreachable cells: every free cell must be reachable from every other, but row "
            f"{row + 1}, column {column + 1} is cut off from the first free cell. Open a way in the map file."
        )
    digest = hashlib.sha256("\n".join(rows).encode()).hexdigest()
    return GridWorld(name, free.shape[0], free.shape[1], cells, next_cell, legal, distance, digest)


def _check_characters(rows: list[str], name: str) -> None:
    if not rows or len({len(row) for row in rows}) != 1 or not rows[0]:
        raise SetupError(
            f"Map '{name}' must be a rectangle of text, but its rows have lengths {sorted({len(r) for r in rows})}. "
            "Make all rows equally long."
        )
    odd = sorted(set("".join(rows)) - {FREE, OBSTACLE})
    if odd:
        raise SetupError(
            f"Map '{name}' may hold only '{FREE}' (free) and '{OBSTACLE}' (obstacle), but holds {odd}. Replace them."
        )
    if "".join(rows).count(FREE) < 2:
        raise SetupError(f"Map '{name}' needs at least 2 free cells for a start and a goal.")


def _distances(next_cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """All shortest paths by growing every cell's reachable set one move at a time; -1 where there is none."""
    n_cells = len(next_cell)
    reached = np.eye(n_cells, dtype=bool)
    distance = np.where(reached, 0, -1)
    for length in range(1, n_cells):
        # From a cell one reaches in `length` moves whatever a neighbour reaches in one fewer.
        grown = reached | reached[next_cell].any(axis=1)
        if (grown == reached).all():
            break
        distance[grown & ~reached] = length
        reached = grown
    return distance


@cache
def load_map(name_or_path: str) -> GridWorld:
    """Load a shipped map by name, or a lab's own by the path of its ``.txt`` file.

    Raises SetupError when there is no such map or it is malformed.
    """
    if name_or_path in SHIPPED_MAPS:
        text = files("bci_app").joinpath("maps", f"{name_or_path}.txt").read_text(encoding="ascii")
        return compile_map(text, name_or_path)
    path = Path(name_or_path)
    try:
        return compile_map(path.read_text(encoding="utf-8"), path.stem)
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise SetupError(
            f"No map '{name_or_path}': expected one of {', '.join(SHIPPED_MAPS)} or the path of a map file ({why})."
        ) from error
