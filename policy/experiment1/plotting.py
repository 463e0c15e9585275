"""What all figures share: a page-wide sheet, its style and colours, and how rows of a table are picked."""

from collections.abc import Sequence
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from policy.experiment1 import Row

FORMATS = ("svg", "pdf", "png")
DPI = 150
WIDTH = 7.0  # inches, a page
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "lines.markersize": 4,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "svg.hashsalt": "experiment1",  # the same tables give the same file
}
# Okabe and Ito's colours, told apart by all common kinds of sight.
BLUE, ORANGE, GREEN, VERMILION, BLACK, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#000000", "#777777"
MAPS = {"open": "Open map", "obstacles": "Map with obstacles"}


def sheet(n_rows: int, n_columns: int, height: float, **options: Any) -> tuple[Figure, Any]:
    """A page-wide figure of this height in inches, and its axes, (n_rows, n_columns)."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(n_rows, n_columns, squeeze=False, **options)


def those(rows: Sequence[Row], **wanted: Any) -> list[Row]:
    """The rows that have these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def column(rows: Sequence[Row], name: str) -> list[Any]:
    """One value of each row."""
    return [row.get(name) for row in rows]


def title(map_name: str) -> str:
    """What a map is called above its axes."""
    return MAPS.get(map_name, f"Map {map_name}")
