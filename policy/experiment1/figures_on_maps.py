"""The figures of the first experiment that show the grid itself: gradients by cell, and trajectories."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from bci_app.gridworld import OBSTACLE
from policy.experiment1 import Row, Tables
from policy.experiment1.plotting import BLACK, GREEN, VERMILION, column, sheet, those, title

BORDER = 2
"""Cells from the wall that the titles count as edge; the table has others, too."""
WALL = "0.35"
LANES = 0.16
"""Part of a cell by which a path drifts from its first step to its last, so that ways back lie beside ways there."""

START: dict[str, Any] = {"marker": "o", "markersize": 9, "color": VERMILION, "markeredgecolor": BLACK}
GOAL: dict[str, Any] = {"marker": "*", "markersize": 13, "color": GREEN, "markeredgecolor": BLACK}
ERROR: dict[str, Any] = {"marker": "x", "markersize": 5, "color": BLACK}


def gradient_maps(tables: Tables, layouts: dict[str, list[str]], series: str) -> Figure | None:
    """Fig. 6: mean absolute gradient of the verdict in each cell, by map and accuracy."""
    rows = those(tables["gradient_map"], series=series)
    accuracies = sorted({row["accuracy"] for row in rows})
    if not accuracies:
        return None
    figure, grid = sheet(len(layouts), len(accuracies), 2.35 * len(layouts) + 0.5)
    for line, (name, layout) in zip(grid, layouts.items(), strict=True):
        for axes, accuracy in zip(line, accuracies, strict=True):
            image = np.full((len(layout), len(layout[0])), np.nan)
            for row in those(rows, map=name, accuracy=accuracy):
                image[row["row"], row["column"]] = row["gradient"]
            empty_map(axes, layout)
            if np.isfinite(image).any():
                # A cell where hardly anybody comes may have any mean: it mustn't take all the colours.
                most = float(np.nanpercentile(image, 98)) or 1.0
                shown = axes.imshow(image, cmap="viridis", vmin=0, vmax=most, zorder=1)
                bar = figure.colorbar(shown, ax=axes, location="bottom", shrink=0.85, pad=0.03, aspect=18, extend="max")
                bar.ax.tick_params(labelsize=6)
                bar.ax.locator_params(nbins=4)
            axes.set_title(_compared(tables["centre_edge"], name, series, accuracy), fontsize=8)
        line[0].set_ylabel(title(name))
    figure.suptitle(
        "Mean |gradient| of the verdict by cell (nats a unit), by share of right verdicts\n"
        f"above each: centre : edge (within {BORDER} cells of the wall), 95 % interval; white: never visited",
        fontsize=8,
    )
    return figure


def _compared(rows: list[Row], name: str, series: str, accuracy: float) -> str:
    words = f"{100 * accuracy:.0f} % right"
    for row in those(rows, map=name, series=series, accuracy=accuracy, border=BORDER):
        words += f"\n{row['ratio']:.2f} [{row['ratio_low']:.2f}, {row['ratio_high']:.2f}]"
    return words


def trajectories(rows: list[Row], layouts: dict[str, list[str]]) -> Figure | None:
    """Fig. 8: the way with perfect verdicts and without any, from the same start to the same goal."""
    if not rows:
        return None
    conditions: dict[float | None, str] = {1.0: "verdicts 100 % right", None: "no verdicts"}
    figure, grid = sheet(len(layouts), len(conditions), 3.1 * len(layouts) + 0.4)
    longest = max(column(rows, "step"))
    lines = None
    for line, (name, layout) in zip(grid, layouts.items(), strict=True):
        for axes, (accuracy, words) in zip(line, conditions.items(), strict=True):
            path = those(rows, map=name, accuracy=accuracy)
            empty_map(axes, layout)
            axes.set_title(f"{words}: {_end(path)}")
            if path:
                lines = _path(axes, path, longest)
        line[0].set_ylabel(title(name), fontsize=9)
    if lines is not None:
        figure.colorbar(lines, ax=grid, shrink=0.6, label="Step", aspect=30)
    marks = {"start": START, "goal": GOAL, "after a move that was an error": ERROR}
    handles = [Line2D([], [], linestyle="none", label=words, **mark) for words, mark in marks.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(marks))
    return figure


def _end(path: list[Row]) -> str:
    if not path:
        return "no policy"
    last = path[-1]
    reached = (last["row"], last["column"]) == (last["goal_row"], last["goal_column"])
    return f"{last['step']} steps" + ("" if reached else ", goal not reached")


def _path(axes: Axes, path: list[Row], longest: int) -> LineCollection:
    cells = np.stack([np.array(column(path, name), dtype=np.float64) for name in ("row", "column")], axis=1)
    goal = (path[0]["goal_row"], path[0]["goal_column"])
    return draw_way(axes, cells, [bool(row["error"]) for row in path], goal, longest)


def draw_way(
    axes: Axes,
    cells: NDArray[np.float64],
    error: Sequence[bool],
    goal: tuple[int, int] | None,
    longest: int,
    size: float = 1.0,
) -> LineCollection:
    """A way on a map, coloured by step; the lines, for a colour bar.

    Parameters
    ----------
    cells : float64, (n_steps + 1, 2), row and column, from the start on.
    error : whether each of them was reached by an error.
    goal : row and column, where it is known.
    longest : steps of the last colour.
    size : of lines and markers, relative to a map three inches wide.
    """
    step = np.arange(len(cells))
    drift = LANES * (2 * step / max(longest, 1) - 1)
    points = cells[:, ::-1] + drift[:, None]
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(segments), cmap="plasma", linewidths=2 * size, capstyle="round", zorder=3)
    lines.set_array(step[1:])
    lines.set_clim(0, longest)
    axes.add_collection(lines)
    marks = [(points[np.array(error, dtype=bool)].T, ERROR, 4), (points[:1].T, START, 5)]
    if goal is not None:
        marks.append((np.array([goal[::-1]]).T, GOAL, 5))
    for places, mark, order in marks:
        axes.plot(*places, zorder=order, **{"linestyle": "none", **mark, "markersize": size * mark["markersize"]})
    return lines


def empty_map(axes: Axes, layout: list[str]) -> None:
    """An empty map, the first row on top."""
    n_rows, n_columns = len(layout), len(layout[0])
    axes.set(xlim=(-0.5, n_columns - 0.5), ylim=(n_rows - 0.5, -0.5), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(True)
    across = [[(-0.5, at - 0.5), (n_columns - 0.5, at - 0.5)] for at in range(1, n_rows)]
    down = [[(at - 0.5, -0.5), (at - 0.5, n_rows - 0.5)] for at in range(1, n_columns)]
    axes.add_collection(LineCollection(across + down, colors="0.88", linewidths=0.5, zorder=0))
    walls = [(row, at) for row, line in enumerate(layout) for at, what in enumerate(line) if what == OBSTACLE]
    blocks = [Rectangle((at - 0.5, row - 0.5), 1, 1) for row, at in walls]
    axes.add_collection(PatchCollection(blocks, color=WALL, zorder=2))
