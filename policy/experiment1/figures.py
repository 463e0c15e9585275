"""The figures of the first experiment, drawn from its tables and from nothing else; each as SVG, PDF and PNG.

Figures that all of whose rows are missing aren't drawn. No state of pyplot is touched.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from policy.experiment1 import Row, Tables
from policy.experiment1.figures_on_maps import gradient_maps, trajectories
from policy.experiment1.plotting import (
    BLACK,
    BLUE,
    DPI,
    FORMATS,
    GREEN,
    GREY,
    ORANGE,
    STYLE,
    VERMILION,
    column,
    sheet,
    those,
    title,
)

SERIES = {"ours": ("our policies", BLUE), "told": ("our told policy", GREEN), "paper": ("paper's recipe", VERMILION)}
PUBLISHED: dict[str, Any] = {
    "color": BLACK,
    "marker": "D",
    "linestyle": "none",
    "markersize": 4.5,
    "markerfacecolor": "white",
}
MAP_LOOKS: tuple[dict[str, Any], ...] = (
    {"marker": "o"},
    {"marker": "s", "linestyle": "--", "markerfacecolor": "white"},
)
MEAN_AT, PUBLISHED_AT = 22.4, 23.4  # beside the distances, up to 20
NONE_AT = 50.0  # per cent: where no verdicts are drawn, for verdicts of that accuracy say as much


def draw(tables: Tables, layouts: dict[str, list[str]], folder: Path) -> dict[str, list[Path]]:
    """Draw and write all figures for which there are rows; the paths of each.

    Parameters
    ----------
    tables : as `policy.experiment1.tables` makes them.
    layouts : each map's name and the lines of its file.
    """
    maps = list(layouts)
    figures: dict[str, Callable[[], Figure | None]] = {
        "figure3a_learning_curves": lambda: _learning_curves(tables["curves"], maps),
        "figure3b_steps_by_accuracy": lambda: _steps_by_accuracy(tables["accuracy"], maps),
        "figure4_robustness": lambda: _robustness(tables["robustness"], maps),
        "figure5_gradients": lambda: _gradients(tables["gradients"], maps),
        "figure6_gradient_maps": lambda: gradient_maps(tables, layouts, "ours"),
        "figure6_gradient_maps_told": lambda: gradient_maps(tables, layouts, "told"),
        "figure6_gradient_maps_paper_recipe": lambda: gradient_maps(tables, layouts, "paper"),
        "figure7_success": lambda: _success(tables, maps),
        "figure8_trajectories": lambda: trajectories(tables["trajectories"], layouts),
    }
    written: dict[str, list[Path]] = {}
    with matplotlib.rc_context(STYLE):
        for name, made in figures.items():
            figure = made()
            if figure is not None:
                figure.draw_without_rendering()
                figure.set_layout_engine("none")  # it is laid out once for all formats
                written[name] = [folder / f"{name}.{ending}" for ending in FORMATS]
                for path in written[name]:
                    undated = (
                        {} if path.suffix == ".png" else {"Date" if path.suffix == ".svg" else "CreationDate": None}
                    )
                    figure.savefig(path, dpi=DPI, metadata=undated)
    return written


def _percent(rows: Sequence[Row]) -> list[float]:
    return [NONE_AT if row["accuracy"] is None else 100 * row["accuracy"] for row in rows]


def _line(axes: Axes, x: Sequence[float], rows: Sequence[Row], value: str, **style: Any) -> None:
    """A line with its intervals, as far as there are rows."""
    if rows:
        y = np.array(column(rows, value))
        reach = [y - column(rows, "ci_low"), np.array(column(rows, "ci_high")) - y]
        axes.errorbar(x, y, yerr=np.maximum(reach, 0), elinewidth=1, capsize=1.5, **style)


def _legend(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    """Below the axes, where no data are."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def _learning_curves(rows: list[Row], maps: list[str]) -> Figure | None:
    recipes = [series for series in SERIES if those(rows, series=series)]
    if not recipes:
        return None
    figure, grid = sheet(len(recipes), len(maps), 0.7 + 2.3 * len(recipes), sharey="row", sharex="row")
    known = sorted({row["accuracy"] or 0.5 for row in rows})
    colours = dict(zip(known, matplotlib.colormaps["viridis"](np.linspace(0, 0.92, len(known))), strict=True))
    styles = {key: {"color": GREY, "linestyle": "--"} if key == 0.5 else {"color": colours[key]} for key in known}
    for series, line in zip(recipes, grid, strict=True):
        for name, axes in zip(maps, line, strict=True):
            for key in known:
                curve = those(rows, map=name, series=series, accuracy=None if key == 0.5 else key)
                axes.plot(np.array(column(curve, "moves")) / 1e6, column(curve, "mean_steps"), **styles[key])
            axes.set(title=f"{title(name)}, {SERIES[series][0]}", xlabel="Training moves (millions)")
            # An episode has 60 steps at most; the first means are of the few that had ended by then, and mean nothing.
            axes.set_ylim(0, 62)
        line[0].set_ylabel("Steps an episode, mean")
    handles = [Line2D([], [], **styles[key], label="none" if key == 0.5 else f"{100 * key:.0f} %") for key in known]
    figure.legend(handles=handles, loc="outside right center", title="Verdicts right")
    return figure


def _steps_by_accuracy(rows: list[Row], maps: list[str]) -> Figure | None:
    if not rows:
        return None
    figure, grid = sheet(1, len(maps), 3.4, sharey=True)
    styles: dict[str, dict[str, Any]] = {
        "published": {"label": "published", **PUBLISHED},
        "paper": {"label": "paper's recipe, trained here", "color": VERMILION, "marker": "s"},
        "ours": {"label": "our policies", "color": BLUE, "marker": "o"},
        "Bayes filter": {"label": "exact Bayes filter, greedy move", "color": GREEN, "marker": "^", "linestyle": "--"},
    }
    bounds: dict[str, dict[str, Any]] = {
        "search": {"label": "best search without verdicts", "color": GREY, "linestyle": "-."},
        "oracle": {"label": "shortest path", "color": GREY, "linestyle": ":"},
    }
    for name, axes in zip(maps, grid[0], strict=True):
        for series, style in styles.items():
            found = those(rows, map=name, series=series)
            if series == "published":
                axes.plot(_percent(found), column(found, "mean_steps"), zorder=4, **style)
            else:
                _line(axes, _percent(found), found, "mean_steps", **style)
        for series, style in bounds.items():
            for row in those(rows, map=name, series=series):
                axes.axhline(row["mean_steps"], zorder=1, **style)
        axes.set(title=title(name), xlabel="Verdicts right (%)")
        axes.set_xticks([NONE_AT, *range(60, 101, 10)], ["none", *map(str, range(60, 101, 10))])
    grid[0, 0].set_ylabel("Steps to the goal, mean")
    grid[0, 0].set_ylim(0, None)  # of both, when both are full
    shown = {series for series in (*styles, *bounds) if those(rows, series=series)}
    _legend(figure, [Line2D([], [], **s) for key, s in {**styles, **bounds}.items() if key in shown], 3)
    return figure


def _robustness(rows: list[Row], maps: list[str]) -> Figure | None:
    if not rows:
        return None
    figure, grid = sheet(1, len(maps), 3.4, sharey=True)
    colours = {0.75: BLUE, 1.0: ORANGE, None: GREEN}
    looks: dict[str, dict[str, Any]] = {
        "ours": {"marker": "o"},
        "told": {"marker": "^"},
        "paper": {"marker": "s", "linestyle": "--", "markerfacecolor": "white"},
        "published": {"marker": "D", "linestyle": "none", "markersize": 5, "markeredgecolor": BLACK},
    }
    words = {"ours": "ours, trained at", "told": "ours, told the truth", "paper": "paper's recipe, trained at"}
    handles = {}
    for name, axes in zip(maps, grid[0], strict=True):
        for series, look in looks.items():
            for trained, colour in colours.items():
                found, style = those(rows, map=name, series=series, trained=trained), {"color": colour, **look}
                if not found:
                    continue
                if series == "published":
                    axes.plot(_percent(found), column(found, "mean_steps"), zorder=4, **style)
                else:
                    _line(axes, _percent(found), found, "mean_steps", **style)
                at = "" if trained is None else f" {100 * trained:.0f} %"
                handles[series, trained] = Line2D(
                    [], [], **style, label=words.get(series, "published, trained at") + at
                )
        axes.set(title=title(name), xlabel="Verdicts right in use (%)")
        axes.set_xticks(range(70, 101, 5))
    grid[0, 0].set_ylabel("Steps to the goal, mean")
    grid[0, 0].set_ylim(0, None)  # of both, when both are full
    _legend(figure, list(handles.values()), 3)
    return figure


def _gradients(rows: list[Row], maps: list[str]) -> Figure | None:
    if not rows:
        return None
    methods = list(dict.fromkeys(column(rows, "method")))
    figure, grid = sheet(2, len(methods), 4.6, sharex=True)
    handles = {}
    for line, name in zip(grid, ("verdict", "position"), strict=True):
        for axes, method in zip(line, methods, strict=True):
            for series, (word, colour) in SERIES.items():
                for number, map_name in enumerate(maps):
                    found = those(rows, map=map_name, series=series, method=method, input=name)
                    style = {"color": colour, **MAP_LOOKS[number % len(MAP_LOOKS)]}
                    _line(axes, _percent(found), found, "mean", **style)
                    if found:
                        handles[series, map_name] = Line2D([], [], **style, label=f"{word}, {title(map_name).lower()}")
            axes.set(yscale="log", title=f"{method[0].upper()}{method[1:]}, {name}")
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.set_ylabel("nats" if method == "integrated gradients" else "nats a unit")
    for axes in grid[-1]:
        axes.set(xlabel="Verdicts right (%)")
        axes.set_xticks([70, 75, 80, 100])
    _legend(figure, list(handles.values()), 2)
    return figure


def _success(tables: Tables, maps: list[str]) -> Figure | None:
    rows = tables["success"]
    present = [series for series in SERIES if those(rows, series=series)]
    if not present:
        return None
    figure, grid = sheet(len(present), len(maps), 0.8 + 2.3 * len(present), sharey=True, sharex=True)
    looks: dict[float | None, dict[str, Any]] = {
        None: {"color": GREY, "marker": "o"},
        0.7: {"color": ORANGE, "marker": "s"},
        0.8: {"color": BLUE, "marker": "^"},
    }
    for series, line in zip(present, grid, strict=True):
        for name, axes in zip(maps, line, strict=True):
            for accuracy, look in looks.items():
                found = those(rows, map=name, series=series, accuracy=accuracy)
                shares = [{key: 100 * row[key] for key in ("success", "ci_low", "ci_high")} for row in found]
                _line(axes, column(found, "distance"), shares, "success", **look)
                for row in those(tables["success_mean"], map=name, series=series, accuracy=accuracy):
                    axes.plot(MEAN_AT, 100 * row["success"], **look)
                    if row["published"] is not None:
                        there = {**PUBLISHED, "markeredgecolor": look["color"]}
                        axes.plot(PUBLISHED_AT, 100 * row["published"], **there)
            axes.axvline(MEAN_AT - 1.2, color="0.8", linewidth=0.8)
            axes.set(title=f"{title(name)}, {SERIES[series][0]}")
            axes.set_xticks([2, 5, 10, 15, 20, (MEAN_AT + PUBLISHED_AT) / 2], ["2", "5", "10", "15", "20", "mean"])
        line[0].set_ylabel("Success within 60 steps (%)")
    for axes in grid[-1]:
        axes.set_xlabel("Initial distance (moves)")
    words = {None: "no verdicts", 0.7: "70 % right", 0.8: "80 % right"}
    handles = [Line2D([], [], **look, label=words[accuracy]) for accuracy, look in looks.items()]
    _legend(figure, [*handles, Line2D([], [], **PUBLISHED, label="published mean")], 4)
    return figure
