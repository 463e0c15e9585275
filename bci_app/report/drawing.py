"""What the report's figures share: their form, their colours, and how they are written."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bci_app.report import Row
from policy.experiment1.plotting import BLACK, BLUE, GREEN, GREY, ORANGE, STYLE, VERMILION

PURPLE, SKY = "#CC79A7", "#56B4E9"  # of Okabe and Ito's, too
FORMATS = ("svg", "pdf")
LOOK = {**STYLE, "svg.hashsalt": "report", "pdf.fonttype": 42}
"""The first experiment's; letters stay letters in a PDF."""

CONDITIONS: dict[str, dict[str, Any]] = {
    "error": {"color": VERMILION, "linestyle": "-"},
    "correct": {"color": BLUE, "linestyle": "--"},
    "difference": {"color": BLACK, "linestyle": "-"},
}
AREA_LOOKS: dict[str, dict[str, Any]] = {
    "central": {"color": GREEN, "marker": "o"},
    "edge": {"color": ORANGE, "marker": "s"},
}
FEWEST_FOR_A_BAND = 3
"""An interval of two participants or episodes (Student's t of 12.7) hides everything else; the tables have it."""
_SOURCES = (
    {"color": BLUE, "marker": "o"},
    {"color": BLACK, "marker": "s"},
    {"color": ORANGE, "marker": "^"},
    {"color": GREEN, "marker": "D"},
    {"color": PURPLE, "marker": "v"},
    {"color": GREY, "marker": "X"},
)
PEOPLE_LOOKS: tuple[dict[str, Any], ...] = tuple(
    {"color": colour, "marker": marker, "linestyle": line}
    for colour, marker, line in (
        (BLUE, "o", "-"),
        (VERMILION, "s", "--"),
        (GREEN, "D", "-"),
        (PURPLE, "v", "--"),
        (BLACK, "^", "-"),
        (SKY, "X", "-"),
        (ORANGE, "P", "--"),
    )
)
"""Of several participants beside each other, in their order."""
WORDS = {
    "tenfold": "tenfold cross-validation",
    "contiguous": "contiguous folds",
    "open": "online, open map",
    "obstacles": "online, map with obstacles",
}


@dataclass(frozen=True)
class Drawn:
    """A figure.

    Attributes
    ----------
    figure : matplotlib's.
    title : its heading.
    alt : what it shows, with its main numbers, for those who can't see it.
    caption : how to read it.
    """

    figure: Figure
    title: str
    alt: str
    caption: str


@dataclass(frozen=True)
class Written:
    """A figure on disk, and as SVG to put into a page."""

    name: str
    drawn: Drawn
    paths: tuple[Path, ...]
    svg: bytes


def write(name: str, drawn: Drawn, folder: Path) -> Written:
    """Write a figure as SVG and PDF, the same bytes for the same tables."""
    with matplotlib.rc_context(LOOK):
        if drawn.figure.get_layout_engine() is not None:  # it is laid out once for all formats
            drawn.figure.draw_without_rendering()
            drawn.figure.set_layout_engine("none")
        paths = tuple(folder / f"{name}.{ending}" for ending in FORMATS)
        for path in paths:
            undated = {"Date" if path.suffix == ".svg" else "CreationDate": None, "Title": drawn.title}
            drawn.figure.savefig(path, metadata=undated)
    return Written(name, drawn, paths, paths[0].read_bytes())


def looks(sources: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker of each source of verdicts, in a fixed order."""
    known = [*WORDS, *sorted(set(sources) - set(WORDS))]
    return {name: dict(_SOURCES[place % len(_SOURCES)]) for place, name in enumerate(known)}


def words(source: str) -> str:
    """What a source of verdicts is called."""
    return WORDS.get(source, f"online, map {source}")


def with_interval(axes: Axes, x: float, row: Row, scale: float = 100.0, **look: Any) -> None:
    """A value with its interval, vertical; without one where none is known."""
    low, high = row.get("low"), row.get("high")
    reach = None if low is None or high is None else [[scale * (row["value"] - low)], [scale * (high - row["value"])]]
    axes.errorbar(x, scale * row["value"], yerr=reach, capsize=2, elinewidth=1, linestyle="none", **look)


def percent(share: float | None, digits: int = 1) -> str:
    """A share for people; a dash where there is none."""
    return "–" if share is None else f"{100 * share:.{digits}f} %"


def run_names(runs: Sequence[tuple[str, str, str]]) -> list[str]:
    """Runs by participant, by visit where there are several of one, and by themselves where a visit has several."""
    visits = dict.fromkeys((who, visit) for who, visit, _ in runs)
    return [
        who
        + (f" {visit}" if sum(each[0] == who for each in visits) > 1 else "")
        + (f", {run}" if sum(each[:2] == (who, visit) for each in runs) > 1 else "")
        for who, visit, run in runs
    ]
