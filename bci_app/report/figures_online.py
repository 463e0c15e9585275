"""Figures of the online runs: ways, success and steps, areas of the map, latencies; and of the electrodes."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from bci_app.gridworld import FREE
from bci_app.report import Row, Tables, count, distinct, those
from bci_app.report.drawing import AREA_LOOKS, FEWEST_FOR_A_BAND, LOOK, Drawn, looks, percent, run_names
from bci_app.report.figures_erp import head_map
from bci_app.report.steps import BORDER, area_of, way
from decoder.montage import canonical, template
from policy.experiment1.figures_on_maps import ERROR, GOAL, START, draw_way, empty_map
from policy.experiment1.plotting import BLACK, BLUE, GREY, ORANGE, sheet, title

COLUMNS = 5
"""Episodes beside each other."""


def ways(tables: Tables, participant: str, visit: str, run: str) -> Drawn | None:
    """The agent's way in each episode of a run, by initial distance."""
    moves = those(tables.get("moves", []), participant=participant, visit=visit, run=run)
    episodes = those(tables.get("episodes", []), participant=participant, visit=visit, run=run)
    episodes = [row for row in episodes if row["steps"]]
    if not moves or not episodes:
        return None
    layout = _layout(tables, moves[0]["map"])
    episodes.sort(key=lambda row: (row["distance"] is None, row["distance"], row["episode"]))
    n_rows = -(-len(episodes) // COLUMNS)
    longest = max(row["steps"] for row in episodes)
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(n_rows, COLUMNS, 1.45 * n_rows + 0.55)
        # Laid out by hand: matplotlib takes half a second to find out that all maps are alike.
        figure.set_layout_engine(None)
        height = figure.get_figheight()
        figure.subplots_adjust(0.01, 0.45 / height, 0.87, 1 - 0.2 / height, 0.06, 0.16)
        for axes in grid.flat[len(episodes) :]:
            axes.set_axis_off()
        for axes, episode in zip(grid.flat, episodes, strict=False):
            mine = those(moves, episode=episode["episode"])
            empty_map(axes, layout)
            axes.set_title(_ended(episode), fontsize=7)
            if mine:
                cells = np.array(way(mine), dtype=np.float64)
                goal = (episode["goal_row"], episode["goal_column"])
                wrong = [False, *(bool(move["error"]) for move in mine)]
                lines = draw_way(axes, cells, wrong, goal if goal[0] is not None else None, longest, size=0.55)
        figure.colorbar(lines, cax=figure.add_axes((0.9, 0.3, 0.012, 0.4)), label="step")
        marks = {"start": START, "goal": GOAL, "after a move that was an error": ERROR}
        handles = [
            Line2D([], [], linestyle="none", label=name, **{**mark, "markersize": 6}) for name, mark in marks.items()
        ]
        figure.legend(handles=handles, loc="lower center", ncols=len(marks))
    reached = sum(row["success"] for row in episodes)
    return Drawn(
        figure,
        f"Ways on {title(moves[0]['map']).lower()}, {participant}, {run}",
        f"{count(len(episodes), 'small map')} with the agent's way from start to goal; {reached} reached it, in "
        f"{np.mean([row['steps'] for row in episodes]):.1f} steps in the mean.",
        "Above each map the initial distance to the goal and the steps made. Crosses: after a move that was an error.",
    )


def _ended(episode: Row) -> str:
    distance = "" if episode["distance"] is None else f"{episode['distance']} away: "
    return f"{distance}{episode['steps']} steps" + ("" if episode["success"] else ", failed")


def by_distance(tables: Tables) -> Drawn | None:
    """Success and steps by initial distance, all participants together."""
    rows = tables.get("by_distance", [])
    if not rows:
        return None
    maps = distinct(rows, "map")
    style = {
        name: {**look, "linestyle": line} for (name, look), line in zip(_map_looks(maps), ("-", "--") * 9, strict=False)
    }
    most = max(row["n_episodes"] for row in rows)
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 2, 2.9)
        for name in maps:
            mine = those(rows, map=name)
            x = np.array([row["distance"] for row in mine])
            for axes, key, scale in ((grid[0, 0], "success", 100), (grid[0, 1], "mean", 1)):
                y = scale * np.array([row[key] for row in mine], dtype=float)
                axes.plot(x, y, **style[name], alpha=0.9)
                if most >= FEWEST_FOR_A_BAND:
                    ends = ("success_low", "success_high") if key == "success" else ("low", "high")
                    low, high = (scale * np.array([row[end] for row in mine], dtype=float) for end in ends)
                    axes.fill_between(x, low, high, color=style[name]["color"], alpha=0.12, linewidth=0)
        longest = max(row["distance"] for row in rows)
        grid[0, 1].plot([0, longest], [0, longest], color=GREY, linestyle=":", linewidth=1)
        grid[0, 0].set(ylabel="episodes that reached the goal (%)", ylim=(-3, 103))
        # Intervals of three or four episodes may be as wide as they like.
        grid[0, 1].set(ylabel="steps an episode", ylim=(0, 1.15 * max(*(row["mean"] for row in rows), longest)))
        for axes in grid[0]:
            axes.set(xlabel="initial distance to the goal (moves)", xlim=(0, longest + 1))
        n = {name: sum(row["n_episodes"] for row in those(rows, map=name)) for name in maps}
        handles = [Line2D([], [], label=f"{title(name)} ({count(n[name], 'episode')})", **style[name]) for name in maps]
        handles.append(Line2D([], [], color=GREY, linestyle=":", label="shortest way"))
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    told = "; ".join(
        f"{title(name).lower()}: {percent(np.average(*_weighted(rows, name, 'success')))} reached the goal, "
        f"{np.average(*_weighted(rows, name, 'mean')):.1f} steps in the mean"
        for name in maps
    )
    return Drawn(
        figure,
        "Success and steps by initial distance",
        f"Two panels. {told}.",
        "Failed episodes count with the steps they took. "
        + (
            "Bands: 95 % intervals, Wilson's of shares, Student's of means."
            if most >= FEWEST_FOR_A_BAND
            else f"Episodes a distance and map: {most}, too few for an interval."
        ),
    )


def _weighted(rows: list[Row], name: str, key: str) -> tuple[list[float], None, list[int]]:
    mine = those(rows, map=name)
    return [row[key] for row in mine], None, [row["n_episodes"] for row in mine]


def _map_looks(maps: Sequence[str]) -> list[tuple[str, dict[str, Any]]]:
    found = looks(maps)
    return [(name, found[name]) for name in maps]


def areas(tables: Tables) -> Drawn | None:
    """Fig. 10 and 12: the two areas, and how often verdicts are right in each."""
    rows = tables.get("area_accuracy", [])
    if not rows:
        return None
    maps = distinct(rows, "map")
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(len(maps), 2, 2.6 * len(maps) + 0.6, width_ratios=(1, 2.2))
        for line, name in zip(grid, maps, strict=True):
            _draw_areas(line[0], _layout(tables, name))
            line[0].set_title(title(name))
            _draw_accuracy(line[1], those(rows, map=name))
        handles = [
            Line2D([], [], linestyle="none", label=f"{name} area", **{**look, "markersize": 6})
            for name, look in AREA_LOOKS.items()
        ]
        handles.append(Line2D([], [], color=GREY, linestyle=":", label="chance, 50 %"))
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    tests = tables.get("area_test", [])
    group = those(tests, participant="all") or tests
    names = _names_of(rows)
    told = "; ".join(
        f"{names.get((row['participant'], row['visit'], row.get('run')), '')}{title(row['map']).lower()}: central "
        f"{percent(row['central'])}, edge {percent(row['edge'])}, difference "
        f"{100 * row['difference']:+.1f} points [{100 * row['low']:+.1f}, {100 * row['high']:+.1f}], p = "
        f"{row['p']:.3f} ({row['test']})"
        for row in group
    )
    return Drawn(
        figure,
        "Verdicts in the central and in the edge area",
        f"Maps with the two areas, and accuracies in each. {told}.",
        f"As the paper's Fig. 10 and 12. A move counts where it led. Edge: within {BORDER} cells of the wall (decided; "
        "the paper's Fig. 10 is a drawing without numbers, and it tells no test). Bars: Wilson's 95 % intervals. "
        f"{told}.",
    )


def _names_of(rows: list[Row]) -> dict[tuple[str, str, str | None], str]:
    """Each run as its panel names it, to begin a result with; nothing where each map has but one."""
    names: dict[tuple[str, str, str | None], str] = {}
    for name in distinct(rows, "map"):
        here = those(rows, map=name)
        runs = list(dict.fromkeys((row["participant"], row["visit"], row["run"]) for row in here))
        if len(runs) > 1:
            names |= {run: f"{called}, " for run, called in zip(runs, run_names(runs), strict=True)}
    return names


def _draw_areas(axes: Axes, layout: list[str]) -> None:
    empty_map(axes, layout)
    height, width = len(layout), len(layout[0])
    for name, look in AREA_LOOKS.items():
        cells = [
            Rectangle((column - 0.5, row - 0.5), 1, 1)
            for row in range(height)
            for column in range(width)
            if layout[row][column] == FREE and area_of((row, column), height, width) == name
        ]
        axes.add_collection(PatchCollection(cells, color=look["color"], alpha=0.35, linewidth=0, zorder=1))


def _draw_accuracy(axes: Axes, rows: list[Row]) -> None:
    """By run; of a single one also of errors and of correct moves."""
    runs = list(dict.fromkeys((row["participant"], row["visit"], row["run"]) for row in rows))
    measures = ("accuracy", "hit_rate", "correct_rejection_rate") if len(runs) == 1 else ("accuracy",)
    labels = _numbered(rows) if len(runs) == 1 else run_names(runs)
    for area, look in AREA_LOOKS.items():
        for number, (who, visit, run) in enumerate(runs):
            for row in those(rows, participant=who, visit=visit, run=run, area=area):
                for place, name in enumerate(measures, number):
                    if row[name] is None:
                        continue
                    value = 100 * row[name]
                    reach = [[value - 100 * row[f"{name}_low"]], [100 * row[f"{name}_high"] - value]]
                    x = place + (-0.12 if area == "central" else 0.12)
                    axes.errorbar(x, value, yerr=reach, capsize=2, linestyle="none", **look)
    axes.set_xticks(range(len(labels)), labels, rotation=45 if len(labels) > 8 else 0)
    axes.axhline(50, color=GREY, linestyle=":", linewidth=1)
    axes.set(ylabel="right verdicts (%)", ylim=(None, 102), xlim=(-0.5, len(labels) - 0.5))


def _numbered(rows: list[Row]) -> list[str]:
    """What moves, and how many of them in the central and in the edge area."""
    counts = {row["area"]: (row["n"], row["n_error"], row["n"] - row["n_error"]) for row in rows}
    return [
        "\n".join([name, "n = " + " and ".join(str(counts[area][place]) for area in AREA_LOOKS if area in counts)])
        for place, name in enumerate(("all moves", "errors", "correct moves"))
    ]


STAGES = {"verdict": BLUE, "policy": ORANGE, "action": GREY, "late frame": GREY}


def latencies(tables: Tables) -> Drawn | None:
    """What the loop adds between a move's last sample and the next action, by run."""
    rows = [row for row in tables.get("latency", []) if row["what"] in ("verdict", "policy", "action", "late frame")]
    if not rows:
        return None
    names = [(row["participant"], row["run"], row["what"]) for row in rows]
    several = len(distinct(rows, "participant")) > 1
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 1, 1.1 + 0.22 * len(rows))
        axes = grid[0, 0]
        for place, row in enumerate(rows):
            colour = STAGES[row["what"]]
            low = max(row["min_ms"], 1e-3)
            axes.plot([low, row["max_ms"]], [place, place], color=colour, linewidth=1)
            axes.plot([low, row["p95_ms"]], [place, place], color=colour, linewidth=5, solid_capstyle="butt", alpha=0.5)
            axes.plot(row["p50_ms"], place, color=colour, marker="o", linestyle="none")
            axes.plot(row["p99_ms"], place, color=colour, marker="|", markersize=8, linestyle="none")
        labels = [f"{who + ' ' if several else ''}{run}: {what}" for who, run, what in names]
        axes.set_yticks(range(len(rows)), labels)
        axes.invert_yaxis()
        axes.set(xscale="log", xlabel="latency (ms of real time, logarithmic)")
        axes.xaxis.set_major_formatter("{x:g}")
        figure.legend(handles=_latency_marks(), loc="outside lower center", ncols=4)
    told = "; ".join(f"{row['run']} {row['what']}: {row['p50_ms']:.1f} and {row['p99_ms']:.1f} ms" for row in rows[:8])
    return Drawn(
        figure,
        "Latencies of the loop",
        f"Ranges on a logarithmic axis. Median and 99th percentile: {told}.",
        "Thick bars begin at the least. "
        "Verdict: from the arrival of a move's last EEG sample to the verdict. Policy: from the verdict's arrival to "
        "the action. Action: from verdict to action as both were sent, so with the way between the two processes.",
    )


def _latency_marks() -> list[Line2D]:
    looks_of: dict[str, dict[str, Any]] = {
        "median": {"marker": "o", "linestyle": "none"},
        "to the 95th percentile": {"linewidth": 5, "alpha": 0.5, "solid_capstyle": "butt"},
        "99th percentile": {"marker": "|", "markersize": 8, "linestyle": "none"},
        "to the largest": {"linewidth": 1},
    }
    return [Line2D([], [], color=BLACK, label=name, **look) for name, look in looks_of.items()]


def electrodes(tables: Tables) -> Drawn | None:
    """How often each electrode was bad, over the head; nothing where none ever was."""
    rows = tables.get("electrodes", [])
    places = {canonical(name): name for name in template().ch_names}
    shares = {
        name: float(np.mean([row["share_of_moves"] for row in those(rows, channel=name)]))
        for name in distinct(rows, "channel")
        if canonical(name) in places
    }
    names = list(dict.fromkeys([*distinct(tables.get("erp_maps", []), "channel"), *shares]))
    names = [name for name in names if canonical(name) in places]
    if not shares or len(names) < 8:
        return None
    values = np.array([100 * shares.get(name, 0.0) for name in names])
    spelt = [places[canonical(name)] for name in names]
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 1, 3.0)
        figure.set_figwidth(3.8)
        most = max(1.0, 1.6 * float(values.max()))  # names must be read on the darkest place
        image = head_map(
            grid[0, 0], values, spelt, cmap="Oranges", vlim=(0, most), names=_labels(names, shares), contours=0
        )
        figure.colorbar(image, ax=grid[0, 0], shrink=0.7, label="moves while it was bad (%)")
    told = "; ".join(
        f"{name} {percent(share)}" for name, share in sorted(shares.items(), key=lambda item: -item[1])[:12]
    )
    return Drawn(
        figure,
        "Bad electrodes",
        f"Map of the head. Share of moves while an electrode was bad: {told}.",
        "In the mean over the runs in which it was found bad. Bad electrodes are repaired from the others.",
    )


def _labels(names: Sequence[str], shares: dict[str, float]) -> list[str]:
    return [name if shares.get(name) else "" for name in names]


def _layout(tables: Tables, name: str) -> list[str]:
    return [row["cells"] for row in those(tables["maps"], map=name)]
