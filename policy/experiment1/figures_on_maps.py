"""The figures of the first experiment that show the grid itself: gradients by cell, and trajectories."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

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
            _grid(axes, layout)
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
            _grid(axes, layout)
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
    step = np.array(column(path, "step"))
    drift = LANES * (2 * step / max(longest, 1) - 1)
    points = np.stack([np.array(column(path, "column")) + drift, np.array(column(path, "row")) + drift], axis=1)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(segments), cmap="plasma", linewidths=2, capstyle="round", zorder=3)
    lines.set_array(step[1:])
    lines.set_clim(0, longest)
    axes.add_collection(lines)
    wrong = points[[row["error"] for row in path]]
    axes.plot(*wrong.T, linestyle="none", zorder=4, **ERROR)
    axes.plot(*points[0], zorder=5, **START)
    axes.plot(path[0]["goal_column"], path[0]["goal_row"], zorder=5, **GOAL)
    return lines


def _grid(axes: Axes, layout: list[str]) -> None:
    """An empty map, the first row on top."""
    n_rows, n_columns = len(layout), len(layout[0])
    axes.set(xlim=(-0.5, n_columns - 0.5), ylim=(n_rows - 0.5, -0.5), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(True)
    for at in range(1, n_columns):
        axes.axvline(at - 0.5, color="0.88", linewidth=0.5, zorder=0)
    for at in range(1, n_rows):
        axes.axhline(at - 0.5, color="0.88", linewidth=0.5, zorder=0)
    for row, line in enumerate(layout):
        for at, what in enumerate(line):
            if what == OBSTACLE:
                axes.add_patch(Rectangle((at - 0.5, row - 0.5), 1, 1, color=WALL, zorder=2))
