"""Figures of the error potential: at one channel, over the head, by area, by the number of errors in a row."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bci_app.report import AVERAGED, FEWEST_PEOPLE, Row, Tables, by_person, count, distinct, those, unit_of
from bci_app.report.clusters import FEWEST_PARTICIPANTS
from bci_app.report.drawing import AREA_LOOKS, CONDITIONS, FEWEST_FOR_A_BAND, LOOK, Drawn
from bci_app.report.erp import FEWEST, MAPS_MS, grand_average
from bci_app.report.in_a_row import level_name
from bci_app.report.waveforms import BASELINE_MS, nearest
from decoder.montage import canonical, template
from policy.experiment1.plotting import BLACK, GREY, VERMILION, sheet

WHERE = {"calibration": "calibration", "online": "online runs"}


def potential(tables: Tables, source: str) -> Drawn | None:
    """Fig. 9: error and correct moves and their difference next to Fz, its peaks marked."""
    rows = grand_average(those(tables.get("erp", []), source=source, area="all"), ("source", "area"))
    rows = _at("Fz", rows)
    if not {"error", "correct"} <= set(distinct(rows, "condition")):
        return None
    channel, whose = rows[0]["channel"], _whose(rows)
    several = whose["participant"] == "all"
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(2, 1, 4.6, sharex=True)
        upper, lower = grid[:, 0]
        for condition in ("error", "correct"):
            wave = those(rows, condition=condition)
            time, mean, sd = _columns(wave, "time_ms", "mean_uv", "sd_uv")
            n = wave[0]["n"]
            counted = count(n, "participant") if several else f"n = {n}"
            upper.plot(time, mean, label=f"{condition} ({counted})", **CONDITIONS[condition])
            for sign in (-1, 1):
                upper.plot(time, mean + sign * sd, color=CONDITIONS[condition]["color"], linestyle=":", linewidth=0.8)
        upper.plot([], [], color=BLACK, linestyle=":", linewidth=0.8, label="± 1 SD")
        wave = those(rows, condition="difference")
        time, mean, low, high = _columns(wave, "time_ms", "mean_uv", "low_uv", "high_uv")
        lower.plot(time, mean, label="error less correct", **CONDITIONS["difference"])
        if wave[0]["n"] >= FEWEST_FOR_A_BAND:
            lower.fill_between(time, low, high, color=BLACK, alpha=0.15, linewidth=0, label="95 % interval")
        peaks = those(tables.get("erp_peaks", []), source=source, channel=channel, **whose)
        _mark(lower, peaks)
        clusters = those(tables.get("erp_clusters", []), source=source, channel=channel, **whose)
        tested = those(clusters, comparison="error - correct, all")
        differ = _significant(lower, tested)
        if differ:
            lower.plot([], [], color="0.4", linewidth=4, solid_capstyle="butt", label="differ, p < 0.05")
        for axes in (upper, lower):
            _zero(axes)
            axes.set_ylabel(f"{channel} (µV)")
            axes.legend(loc="upper right", ncols=1)
        lower.set(xlabel="time after the move (ms)", xlim=(BASELINE_MS[0], time[-1]))
        lower.margins(y=0.34)
    told = "; ".join(f"{peak['peak']}: {peak['mean_uv']:.1f} µV at {peak['time_ms']:.0f} ms" for peak in peaks)
    counted = count(wave[0]["n"], "participant" if several else "move")
    return Drawn(
        figure,
        f"Error potential at {channel}, {WHERE[source]}",
        f"Waveforms of error and correct moves and their difference, {counted}. Peaks of the difference: {told}.",
        f"As the paper's Fig. 9: baseline {BASELINE_MS[0]:.0f} to 0 ms, 1 to 50 Hz without delay, common average"
        f". Dotted: one standard deviation over {'participants' if several else 'moves'}. "
        + (AVERAGES if whose["visit"] == AVERAGED else _told_of_bars(tested, differ, several)),
    )


def _told_of_bars(tested: Sequence[Row], differ: bool, several: bool) -> str:
    """What the bars below are, or why there are none."""
    if differ:
        return "Grey bars below: clusters in which error and correct moves differ (permutation test, p < 0.05)."
    if tested:
        least = min(row["p"] for row in tested)
        return f"Error and correct moves differ nowhere (permutation test of clusters, p = {least:.3f} at the least)."
    return f"Whether error and correct moves differ isn't tested{_why_not(several)}."


def _why_not(several: bool) -> str:
    """Why clusters aren't tested."""
    return f", for that needs {f'{FEWEST_PARTICIPANTS} participants' if several else f'{FEWEST} moves of each kind'}"


AVERAGES = "The participant's visits are averaged, each counting alike; tests are within each visit, in the tables."


def _whose(rows: Sequence[Row]) -> Row:
    """Whom rows are about, as other tables tell it: one visit, one participant's visits, or all participants."""
    return {name: rows[0][name] for name in ("participant", "visit")}


def _mark(axes: Axes, peaks: Sequence[Row]) -> None:
    for peak in peaks:
        above = peak["mean_uv"] > 0
        axes.plot(peak["time_ms"], peak["mean_uv"], marker="v" if above else "^", color=VERMILION, markersize=6)
        text = f"{peak['mean_uv']:+.1f} µV\n{peak['time_ms']:.0f} ms".replace("-", "−")
        axes.annotate(
            text,
            (peak["time_ms"], peak["mean_uv"]),
            xytext=(0, 12 if above else -12),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=7,
        )


def _significant(axes: Axes, clusters: Sequence[Row]) -> bool:
    """Bars along the bottom where two waveforms differ; whether they do."""
    for row in clusters:
        if row["begin_ms"] is not None:
            axes.axvspan(row["begin_ms"], row["end_ms"], ymax=0.025, color="0.4", linewidth=0)
    return any(row["begin_ms"] is not None for row in clusters)


def _zero(axes: Axes) -> None:
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.axvline(0, color=GREY, linewidth=0.8)


def head_maps(tables: Tables, source: str) -> Drawn | None:
    """The difference wave over the head at three moments, averaged over visits and over participants."""
    rows = those(tables.get("erp_maps", []), source=source)
    places = {canonical(name): name for name in template().ch_names}
    names = [name for name in distinct(rows, "channel") if canonical(name) in places]
    if len(names) < 8:  # a map of fewer electrodes shows the interpolation, not the potential
        return None
    values = np.array(
        [
            [
                np.mean([r["difference_uv"] for r in by_person(those(at, channel=name), "difference_uv")])
                for name in names
            ]
            for at in (those(rows, time_ms=moment) for moment in MAPS_MS)
        ]
    )
    most = float(np.abs(values).max()) or 1.0
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, len(MAPS_MS), 2.9)
        for axes, moment, value in zip(grid[0], MAPS_MS, values, strict=True):
            image = head_map(
                axes, value, [places[canonical(name)] for name in names], cmap="RdBu_r", vlim=(-most, most)
            )
            axes.set_title(f"{moment:.0f} ms")
        figure.colorbar(image, ax=grid[0], location="bottom", shrink=0.4, label="error less correct (µV)")
    told = "; ".join(
        f"{moment:.0f} ms: most positive at {names[int(v.argmax())]} ({v.max():.1f} µV), most negative at "
        f"{names[int(v.argmin())]} ({v.min():.1f} µV)"
        for moment, v in zip(MAPS_MS, values, strict=True)
    )
    return Drawn(
        figure,
        f"Difference wave over the head, {WHERE[source]}",
        f"Three maps of the head, nose up. {told}.",
        "Means of 20 ms around each moment, error less correct; red is positive, blue negative. "
        f"{len(names)} electrodes, between them interpolated by MNE.",
    )


def head_map(axes: Axes, values: np.ndarray, channels: list[str], **look: Any) -> Any:
    """A map over the head through MNE; `channels` as its template spells them. The image, for a colour bar."""
    import mne

    info = mne.create_info(channels, 256.0, "eeg")
    info.set_montage(template())
    with mne.use_log_level("error"):
        image, _ = mne.viz.plot_topomap(values, info, axes=axes, show=False, res=48, **{"contours": 4, **look})
    return image


def by_area(tables: Tables, source: str) -> Drawn | None:
    """Fig. 11: the error potential in the central and in the edge area, next to FCz."""
    rows = _at("FCz", grand_average(those(tables.get("erp", []), source=source), ("source", "area")))
    names = [name for name in AREA_LOOKS if {"error", "correct"} <= set(distinct(those(rows, area=name), "condition"))]
    if len(names) < 2:
        return None
    channel, whose = rows[0]["channel"], _whose(rows)
    clusters = those(tables.get("erp_clusters", []), source=source, channel=channel, **whose)
    banded = shaded = False
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 3, 2.9, sharey=True, sharex=True)
        for axes, name in zip(grid[0], names, strict=False):
            for condition in ("error", "correct"):
                wave = those(rows, area=name, condition=condition)
                time, mean, low, high = _columns(wave, "time_ms", "mean_uv", "low_uv", "high_uv")
                axes.plot(time, mean, **CONDITIONS[condition])
                if wave[0]["n"] >= FEWEST_FOR_A_BAND:
                    axes.fill_between(time, low, high, color=CONDITIONS[condition]["color"], alpha=0.15, linewidth=0)
                    banded = True
            shaded |= _shade(axes, those(clusters, comparison=f"error - correct, {name}"))
            axes.set_title(f"{name} area{_counted(those(rows, area=name))}")
        for name in names:
            wave = those(rows, area=name, condition="difference")
            time, mean, low, high = _columns(wave, "time_ms", "mean_uv", "low_uv", "high_uv")
            look = {"color": AREA_LOOKS[name]["color"], "linestyle": "-" if name == "central" else "--"}
            grid[0, 2].plot(time, mean, **look)
            if wave[0]["n"] >= FEWEST_FOR_A_BAND:
                grid[0, 2].fill_between(time, low, high, color=look["color"], alpha=0.15, linewidth=0)
                banded = True
        grid[0, 2].set_title("error less correct")
        for axes in grid[0]:
            _zero(axes)
            axes.set(xlabel="time after the move (ms)", xlim=(-100, time[-1]))
        grid[0, 0].set_ylabel(f"{channel} (µV)")
        handles: list[Any] = [Line2D([], [], label=name, **CONDITIONS[name]) for name in ("error", "correct")]
        handles += [
            Line2D([], [], label=f"{name} area", linestyle=line, color=AREA_LOOKS[name]["color"])
            for name, line in zip(names, ("-", "--"), strict=True)
        ]
        if shaded:
            handles.append(Patch(color=SHADE, label="differ, p < 0.05"))
        figure.legend(handles=handles, loc="outside lower center", ncols=5)
    sizes = {name: _size(those(rows, area=name, condition="difference")) for name in names}
    p = min((row["p"] for row in those(clusters, comparison="error, central - edge")), default=None)
    told = "; ".join(f"{name} {size:.1f} µV" for name, size in sizes.items())
    tested = f"not tested{_why_not(whose['participant'] == 'all')}" if p is None else f"p = {p:.3f} at the least"
    if whose["visit"] == AVERAGED:
        tested = "tested within each visit, in the tables"
    return Drawn(
        figure,
        f"Error potential by area, {WHERE[source]}",
        f"Waveforms at {channel} in the central and the edge area. From the negative to the positive peak of the "
        f"difference: {told}. Error moves, central against edge: {tested}.",
        "As the paper's Fig. 11. Edge: within two cells of the wall (decided; the paper's Fig. 10 is a drawing). "
        + ("Shaded: clusters in which error and correct moves differ (permutation test). " if shaded else "")
        + ("Bands: 95 % intervals. " if banded else "")
        + f"Error moves in the central area against those at the edge: {tested}.",
    )


SHADE = "#C9E4D6"  # green as in the paper, light enough for all lines on it


def _counted(rows: Sequence[Row]) -> str:
    """How many error and correct moves, or participants, a panel's means are of."""
    n = {name: those(list(rows), condition=name)[0]["n"] for name in ("error", "correct")}
    several = rows[0]["participant"] == "all"
    return f", {count(n['error'], 'participant')}" if several else f", n = {n['error']} and {n['correct']}"


def _shade(axes: Axes, clusters: Sequence[Row]) -> bool:
    """Shades where two waveforms differ; whether they do."""
    for row in clusters:
        if row["begin_ms"] is not None:
            axes.axvspan(row["begin_ms"], row["end_ms"], color=SHADE, linewidth=0, zorder=0)
    return any(row["begin_ms"] is not None for row in clusters)


def _size(wave: Sequence[Row]) -> float:
    inside = [row["mean_uv"] for row in wave if 150 <= row["time_ms"] <= 350]
    return float(max(inside) - min(inside))


def in_a_row(tables: Tables) -> Drawn | None:
    """Fig. 13: the error potential's size against the number of errors in a row."""
    everything = tables.get("errors_in_a_row", [])
    if not everything:
        return None
    source = "online" if those(everything, source="online") else "calibration"
    # Means over participants, or over one's visits, come after those that they are of.
    whose = _whose(those(everything, source=source)[-1:])
    few = FEWEST_PEOPLE if whose["participant"] == "all" else FEWEST
    rows = [row for row in those(everything, source=source, **whose) if row["n"] >= few]
    if not rows:
        return None
    with matplotlib.rc_context(LOOK):
        figure, grid = sheet(1, 1, 2.9)
        axes = grid[0, 0]
        level, mean, low, high = _columns(rows, "errors_in_a_row", "mean", "low", "high")
        reach = [mean - low, high - mean]
        axes.errorbar(level, mean, yerr=reach, color=VERMILION, marker="o", capsize=2, label="mean around the peaks")
        peaks = [row["peak_to_peak"] for row in rows]
        look = {"color": BLACK, "marker": "D", "markerfacecolor": "white", "linestyle": "none"}
        axes.plot(level + 0.08, peaks, label="peak to peak of the mean, as in the paper", **look)
        axes.axhline(0, color=GREY, linewidth=0.8)
        labels = [f"{level_name(row)}\nn = {row['n']}" for row in rows]
        axes.set_xticks(level, labels)
        axes.set(
            xlabel=f"errors in a row (n: {unit_of(rows[0])})",
            ylabel=f"{rows[0]['channel']}: positive less\nnegative peak (µV)",
        )
        axes.legend(loc="best")
    trend = those(tables.get("errors_in_a_row_trend", []), source=source, **whose)
    slope = "".join(f" Over the first four: {_slope(row)}." for row in trend)
    told = "; ".join(f"{level_name(row)}: {row['mean']:.1f} µV" for row in rows)
    return Drawn(
        figure,
        f"Error potential and errors in a row, {WHERE[source]}",
        f"Size by errors in a row. {told}.{slope}",
        "As the paper's Fig. 13. A mean of few moves has large peaks by chance, so the paper's measure (diamonds) "
        f"grows where moves are few; the mean of each move around the peaks (dots, 95 % intervals) doesn't.{slope}",
    )


def _slope(row: Row) -> str:
    text = f"{row['slope']:+.2f} µV an error"
    if row["p"] is None:
        return text
    return f"{text} [{row['low']:+.2f}, {row['high']:+.2f}], p = {row['p']:.3f}"


def _at(wanted: str, rows: list[Row]) -> list[Row]:
    """The rows of the channel that stands for the wanted one."""
    names = distinct(rows, "channel")
    return those(rows, channel=nearest(wanted, names)) if names else []


def _columns(rows: Sequence[Row], *names: str) -> list[np.ndarray]:
    return [np.array([row[name] for row in rows], dtype=np.float64) for name in names]
