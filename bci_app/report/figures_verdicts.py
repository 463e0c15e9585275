"""Figures of the verdicts: how often they are right, of what kind their mistakes are, how far they can be believed."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from bci_app.report import Row, Tables, by_person, distinct, those
from bci_app.report.drawing import LOOK, PEOPLE_LOOKS, Drawn, looks, percent, run_names, with_interval, words
from policy.experiment1.plotting import BLACK, BLUE, GREY, sheet

MEASURES = {
    "accuracy": "accuracy",
    "balanced_accuracy": "balanced\naccuracy",
    "auc": "area under\nthe ROC",
    "hit_rate": "hit rate",
    "correct_rejection_rate": "correct-\nrejection rate",
}
GATE = 70.0
"""Per cent below which the paper sends people home."""


def accuracy(tables: Tables) -> Drawn | None:
    """Shares of right verdicts with their intervals: by measure for one participant, by participant for several."""
    rows = tables.get("scores", [])
    if not rows:
        return None
    people, sources = distinct(rows, "participant"), distinct(rows, "source")
    style = looks(sources)
    with matplotlib.rc_context(LOOK):
        panels = list(MEASURES)[:3] if len(people) > 1 else [None]
        figure, grid = sheet(len(panels), 1, 0.9 + 2.2 * len(panels) if len(panels) > 1 else 3.1)
        for measure, axes in zip(panels, grid[:, 0], strict=True):
            places = people if measure else list(MEASURES)
            for number, source in enumerate(sources):
                for place, what in enumerate(places):
                    wanted = {"participant": what, "measure": measure} if measure else {"measure": what}
                    found = those(rows, source=source, **wanted)
                    offset = 0.6 * ((number + 0.5) / len(sources) - 0.5)
                    for row in found:
                        with_interval(axes, place + offset, row, markersize=4, **style[source])
            axes.axhline(50, color=GREY, linestyle=":", linewidth=1)
            labels = people if measure else list(MEASURES.values())
            _gate(axes, measure)
            axes.set_xticks(range(len(places)), labels, rotation=45 if measure and len(people) > 8 else 0)
            label = MEASURES[measure].replace(chr(10), " ") if measure else "value with 95 % interval"
            axes.set(ylabel=f"{label} (%)", ylim=(None, 101))
        handles = [
            Line2D([], [], linestyle="none", label=words(source) + _moves(those(rows, source=source)), **style[source])
            for source in sources
        ]
        handles += [Line2D([], [], color=GREY, linestyle="--", label="the paper's gate, 70 %")]
        handles += [Line2D([], [], color=GREY, linestyle=":", label="chance, 50 %")]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.2, handlelength=1.6)
    means = {source: _mean(those(rows, source=source, measure="balanced_accuracy")) for source in sources}
    told = "; ".join(f"{words(source)} {percent(mean)}" for source, mean in means.items())
    return Drawn(
        figure,
        "How often verdicts are right",
        f"Points with intervals. Balanced accuracy{' in the mean' if len(people) > 1 else ''}: {told}.",
        "Bars are 95 % intervals: Wilson's for shares, MOVER's for the balanced accuracy, DeLong's for the area under "
        "the ROC curve. n counts moves. The gate is of plain accuracies, chance that of the balanced measures. "
        "Neighbouring epochs resemble each other, so believe contiguous folds where the two differ.",
    )


def _gate(axes: Axes, measure: str | None) -> None:
    """The paper's gate, where plain accuracies are: all over a panel of them, or over their place among measures."""
    look: dict[str, Any] = {"color": GREY, "linestyle": "--", "linewidth": 1}
    if measure == "accuracy":
        axes.axhline(GATE, **look)
    elif measure is None:
        axes.plot((-0.4, 0.4), (GATE, GATE), **look)


def _moves(rows: list[Row]) -> str:
    """How many moves a source's figures are of, in brackets; of several participants all of theirs."""
    mine = those(rows, measure="accuracy")
    n = sum(row["n_error"] + row["n_correct"] for row in mine)
    return f" (n = {n:,})" if n else ""


def _mean(rows: list[Row]) -> float | None:
    """Of participants, each counting alike."""
    return float(np.mean([row["value"] for row in by_person(rows, "value")])) if rows else None


def decisions(tables: Tables) -> Drawn | None:
    """Confusion, ROC curve and reliability diagram."""
    if not tables.get("confusion"):
        return None
    sources = [name for name in distinct(tables["confusion"], "source") if name != "tenfold"]
    style = looks(sources)
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 3, 2.9)
        counts = _confusion(grid[0, 0], those(tables["confusion"], source=sources[0]), sources[0])
        _roc(grid[0, 1], tables.get("roc", []), style)
        _reliability(grid[0, 2], tables.get("reliability", []), style)
        handles = [Line2D([], [], label=words(name), markersize=4, **style[name]) for name in sources]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    areas = those(tables.get("scores", []), measure="auc")
    told = "; ".join(
        f"{words(name)} {mean:.3f}" for name in sources if (mean := _mean(those(areas, source=name))) is not None
    )
    bars = bool(tables.get("reliability")) and not _several(tables["reliability"])
    return Drawn(
        figure,
        "Mistakes, ROC curve and reliability",
        f"Three panels. Left: of {counts[0, 0] + counts[0, 1]} errors {counts[0, 0]} were called errors, of "
        f"{counts[1, 0] + counts[1, 1]} correct moves {counts[1, 1]} correct ({words(sources[0])}). Middle: ROC "
        f"curves; area under them: {told}. Right: share of errors among moves that were said to be errors with some "
        "probability.",
        "Left: counts, and shares of each row. Middle: the dot is where verdicts are given (log odds of 0). Right: "
        f"{'points' if bars else 'lines'} on the diagonal are probabilities that hold"
        + ("; bars are Wilson's 95 % intervals." if bars else "."),
    )


def _several(rows: list[Row]) -> bool:
    """Whether they are of several participants, whose curves have neither marks nor bars of their own."""
    return len(distinct(rows, "participant")) > 1


def _confusion(axes: Axes, rows: list[Row], source: str) -> np.ndarray:
    names = (("hits", "misses"), ("false_alarms", "correct_rejections"))
    counts = np.array([[sum(row[name] for row in rows) for name in line] for line in names])
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for (line, place), count in np.ndenumerate(counts):
        share = shares[line, place]
        colour = "white" if share > 0.5 else BLACK
        axes.text(place, line, f"{count}\n{100 * share:.0f} %", ha="center", va="center", color=colour)
    axes.set_xticks([0, 1], ["error", "correct"])
    axes.set_yticks([0, 1], ["error", "correct"], rotation=90, va="center")
    axes.set(xlabel="verdict", ylabel="truth", title=words(source))
    axes.grid(False)
    return counts


def _roc(axes: Axes, rows: list[Row], style: dict[str, dict[str, Any]]) -> None:
    axes.plot([0, 1], [0, 1], color=GREY, linestyle=":", linewidth=1)
    for source in distinct(rows, "source"):
        colour = style[source]["color"]
        for curve in _curves(those(rows, source=source)):
            alarms, hits = ([row[name] for row in curve] for name in ("false_alarm_rate", "hit_rate"))
            axes.plot(alarms, hits, color=colour, linewidth=1.2, drawstyle="steps-post")
            said = [row for row in curve if row["log_odds"] is not None and row["log_odds"] > 0]
            if said:
                axes.plot(said[-1]["false_alarm_rate"], said[-1]["hit_rate"], markersize=5, **style[source])
    axes.set(xlabel="false alarms", ylabel="hits", title="ROC", aspect="equal", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))


def _curves(rows: list[Row]) -> list[list[Row]]:
    runs = dict.fromkeys((row["participant"], row["visit"], row["run"]) for row in rows)
    return [those(rows, participant=who, visit=visit, run=run) for who, visit, run in runs]


def _reliability(axes: Axes, rows: list[Row], style: dict[str, dict[str, Any]]) -> None:
    axes.plot([0, 1], [0, 1], color=GREY, linestyle=":", linewidth=1)
    several = _several(rows)
    for source in distinct(rows, "source"):
        for curve in _curves(those(rows, source=source)):
            said, happened = (np.array([row[name] for row in curve]) for name in ("said", "happened"))
            reach = [happened - [row["low"] for row in curve], [row["high"] for row in curve] - happened]
            bars = None if several else np.maximum(reach, 0)
            look = {"color": style[source]["color"], "alpha": 0.5} if several else style[source]
            axes.errorbar(said, happened, yerr=bars, markersize=3.5, linewidth=0.8, elinewidth=0.8, **look)
    axes.set(xlabel="said probability of an error", ylabel="share of errors", title="Reliability", aspect="equal")
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))


def learning_curve(tables: Tables) -> Drawn | None:
    """What was expected of the decoder after each block of the calibration: with its interval for one calibration, by
    name for several, in the mean beside all for many."""
    rows = tables.get("learning_curve", [])
    if not rows:
        return None
    curves = _curves(rows)
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 1, 2.7)
        axes = grid[0, 0]
        if len(curves) == 1:
            n, value, low, high = _learnt(curves[0])
            axes.plot(n, value, color=BLUE, marker="o", label="expected")
            axes.fill_between(n, low, high, color=BLUE, alpha=0.15, linewidth=0, label="95 % interval")
        else:
            _learning_curves(axes, curves)
        axes.set(xlabel="valid epochs of the calibration", ylabel="balanced accuracy (%)", xlim=(0, None))
        figure.legend(loc="outside lower center", ncols=4)
    ends = [curve[-1]["sentence"] for curve in curves]
    if len(curves) > 1:
        ends = [f"{name}: {end}" for name, end in zip(_names(curves), ends, strict=True)]
    band = "; the band is its 95 % interval" if len(curves) == 1 else ""
    if len(curves) > NAMED:
        band = f". Thick: the mean over participants, as far as all {len(curves)} calibrations go"
    return Drawn(
        figure,
        "Learning curve",
        "Expected balanced accuracy against the number of epochs. "
        + (" ".join(ends) if len(curves) <= NAMED else f"{len(curves)} calibrations and their mean."),
        f"What is expected of a decoder fitted on all epochs until then, after each block{band}.",
    )


NAMED = 7
"""Calibrations whose learning curves can be told apart by their looks, one each of `drawing.PEOPLE_LOOKS`."""


def _learning_curves(axes: Axes, curves: list[list[Row]]) -> None:
    """Of several calibrations."""
    if len(curves) <= NAMED:
        for name, curve, look in zip(_names(curves), curves, PEOPLE_LOOKS, strict=False):
            axes.plot(*_learnt(curve)[:2], label=name, **look)
        return
    for number, curve in enumerate(curves):
        label = f"each of {len(curves)} calibrations" if number == 0 else None
        axes.plot(*_learnt(curve)[:2], color=GREY, alpha=0.5, linewidth=0.8, label=label)
    n_blocks = min(map(len, curves))
    blocks = [by_person([curve[block] for curve in curves], *_LEARNT[:2]) for block in range(n_blocks)]
    n, value = (np.array([np.mean([row[name] for row in each]) for each in blocks]) for name in _LEARNT[:2])
    axes.plot(n, 100 * value, color=BLACK, linewidth=3, marker="o", label="mean over participants")


_LEARNT = ("n_epochs", "balanced_accuracy", "balanced_accuracy_low", "balanced_accuracy_high")


def _learnt(curve: list[Row]) -> list[np.ndarray]:
    """Epochs, and the balanced accuracy expected after them with its interval, per cent."""
    return [
        np.array([row[name] for row in curve], dtype=float) * (1 if name == "n_epochs" else 100) for name in _LEARNT
    ]


def _names(curves: list[list[Row]]) -> list[str]:
    """Whose calibrations these are: by visit and run only where there are several."""
    return run_names([(curve[0]["participant"], curve[0]["visit"], curve[0]["run"]) for curve in curves])
