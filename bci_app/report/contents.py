"""What is on the page, and in which order."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from bci_app.report import (
    AVERAGED,
    Row,
    Tables,
    count,
    distinct,
    figures_erp,
    figures_online,
    figures_verdicts,
    those,
    words,
    words_on_runs,
)
from bci_app.report.drawing import Drawn, Written, percent
from bci_app.report.page import Grid, Section

Figures = Mapping[str, Written]


def drawings(tables: Tables) -> Iterator[tuple[str, Callable[[], Drawn | None]]]:
    """The figures a report may have: the file's name, and how it is drawn."""
    yield "verdicts_accuracy", lambda: figures_verdicts.accuracy(tables)
    yield "verdicts_decisions", lambda: figures_verdicts.decisions(tables)
    yield "calibration_learning_curve", lambda: figures_verdicts.learning_curve(tables)
    for source in ("calibration", "online"):
        yield f"erp_{source}", lambda source=source: figures_erp.potential(tables, source)  # type: ignore[misc]
        yield f"erp_maps_{source}", lambda source=source: figures_erp.head_maps(tables, source)  # type: ignore[misc]
    # By area the online runs are looked at, as in the paper; a calibration where there are none.
    yield "erp_areas", lambda: figures_erp.by_area(tables, "online") or figures_erp.by_area(tables, "calibration")
    yield "online_by_distance", lambda: figures_online.by_distance(tables)
    yield "online_areas", lambda: figures_online.areas(tables)
    yield "erp_errors_in_a_row", lambda: figures_erp.in_a_row(tables)
    for row in those(tables.get("runs", []), task="online"):
        yield ways_name(row), lambda row=row: figures_online.ways(tables, row["participant"], row["visit"], row["run"])  # type: ignore[misc]
    yield "latencies", lambda: figures_online.latencies(tables)
    yield "electrodes", lambda: figures_online.electrodes(tables)


def ways_name(run: Row) -> str:
    """File name of a run's ways."""
    words = "_".join(str(run[name]) for name in ("participant", "visit", "run"))
    return "ways_" + "".join(letter if letter.isalnum() or letter == "_" else "-" for letter in words)


def title(tables: Tables) -> str:
    """Of the page."""
    people = distinct(tables["runs"], "participant")
    visits = distinct(tables["runs"], "visit")
    if len(people) > 1:
        return f"Study of {len(people)} participants"
    return f"Participant {people[0]}, session {', '.join(visits)}"


def summary(tables: Tables, seen: Sequence[Mapping[str, Any]]) -> list[str]:
    """The page's first sentences."""
    lines = [_in_short(seen[0])] if len(seen) == 1 else [*_on_all(tables), _on_visits(tables)]
    troubles = [row for row in tables.get("events", []) if row["level"] != "info"]
    n_errors = sum(row["level"] == "error" for row in troubles)
    lines.append(
        f"{count(n_errors, 'error')} and {count(len(troubles) - n_errors, 'warning')}: see the end of the page."
        if troubles
        else "Nothing went wrong that the recordings know of."
    )
    return [line for line in lines if line]


def _in_short(figures: Mapping[str, Any]) -> str:
    """One session in a sentence."""
    parts = []
    if calibration := figures.get("calibration"):
        blocked = calibration["blocked"]["balanced_accuracy"]
        parts.append(
            f"the decoder's verdicts are right in {percent(blocked['value'])} of moves (balanced, contiguous folds, "
            f"95 % interval {100 * blocked['low']:.1f} to {100 * blocked['high']:.1f} %)"
        )
    for map_name, online in figures["online"].items():
        if online["n_episodes"]:
            parts.append(
                f"on map {map_name} {percent(online['success'])} of {online['n_episodes']} episodes reached the goal, "
                f"in {words.number(online['mean_steps'])} steps in the mean, with "
                f"{percent(online['verdict_accuracy'])} of verdicts right"
            )
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _on_all(tables: Tables) -> list[str]:
    """Means over participants, or over the visits of one."""
    over = "participants" if len(distinct(tables["runs"], "participant")) > 1 else "visits"
    lines: list[str] = []
    means: Row = {}
    for name in ("table_1", "table_2"):
        ours = those(tables.get(name, []), series="ours")
        mean = [row for row in ours if row["participant"] == "mean" or row["visit"] == AVERAGED]
        means |= mean[0] if mean else {}
    if (balanced := means.get("contiguous_balanced_accuracy")) is not None:
        lines.append(
            f"In the mean over {over} the decoders' verdicts are right in {percent(balanced)} of moves "
            "(balanced, contiguous folds)."
        )
    for name in distinct(those(tables["runs"], task="online"), "map"):
        if (success := means.get(f"{name}_success")) is not None:
            lines.append(
                f"On map {name} {percent(success)} of episodes reached the goal, in "
                f"{words.number(means.get(f'{name}_mean_steps_all'))} steps in the mean, with "
                f"{percent(means.get(f'{name}_accuracy'))} of verdicts right."
            )
    return lines


def _on_visits(tables: Tables) -> str:
    """That means are over visits, which may have been under different conditions."""
    visits: dict[tuple[str, str], dict[str, None]] = {}
    for row in tables["runs"]:
        visits.setdefault((row["participant"], row["task"]), {})[row["visit"]] = None
    several = dict.fromkeys(visit for each in visits.values() if len(each) > 1 for visit in each)
    if not several:
        return ""
    return (
        f"Participants have several visits ({', '.join(several)}), which means and tests average within each "
        "participant first. Where visits are conditions to be told apart, as those of a study, make a report of each."
    )


def sections(tables: Tables, figures: Figures, seen: Sequence[Mapping[str, Any]]) -> list[Section]:
    """The page's parts; those with nothing to show are left out."""
    ways = [
        (figures[ways_name(row)].drawn.title, [figures[ways_name(row)]])
        for row in those(tables["runs"], task="online")
        if ways_name(row) in figures
    ]
    infos = words_on_runs.events(tables, ("info",), "Notes that are no trouble")
    found = [
        Section("Runs", shown=[words_on_runs.runs(tables)]),
        Section(
            "Verdicts",
            shown=_of(
                figures,
                "verdicts_accuracy",
                words.table_one(tables),
                words.beside_table_one(tables),
                words.calibrations(seen),
                "verdicts_decisions",
                "calibration_learning_curve",
            ),
        ),
        Section(
            "Online runs",
            shown=_of(figures, words.table_two(tables), "online_by_distance", *words.tables_a(tables)),
            folded=ways,
        ),
        Section(
            "Error potential",
            shown=_of(
                figures, "erp_calibration", "erp_maps_calibration", "erp_online", "erp_maps_online", words.peaks(tables)
            ),
        ),
        Section(
            "Central and edge area",
            shown=_of(figures, "online_areas", "erp_areas", *words.area_tests(tables)),
        ),
        Section("Errors in a row", shown=_of(figures, "erp_errors_in_a_row", words.levels(tables))),
        Section("Latencies", shown=_of(figures, "latencies", *words_on_runs.ledger(tables))),
        Section("Signal quality", _on_signals(tables), _of(figures, "electrodes", *words_on_runs.signals(tables))),
        Section(
            "What went wrong",
            [] if _troubles(tables) else ["Nothing that the recordings know of."],
            _of(figures, _troubles(tables)),
            [("Notes that are no trouble", [infos])] if infos else [],
        ),
        Section("Files", FILES),
    ]
    return [section for section in found if section.text or section.shown or section.folded]


FILES = (
    "Beside this page: figures/ holds each figure as SVG and PDF, tables/ each table as CSV and JSON, report.json the "
    "figures as bci-app fit, online and demo print them. docs/report.md of the program tells every column.",
    "The page needs nothing else and no network.",
)


def _troubles(tables: Tables) -> Grid | None:
    return words_on_runs.events(tables, ("error", "warning"), "Errors and warnings")


def _of(figures: Figures, *wanted: str | Grid | None) -> list[Written | Grid]:
    """Figures by their names, and tables, as far as they are there."""
    found: list[Written | Grid] = []
    for item in wanted:
        if isinstance(item, Grid):
            found.append(item)
        elif item is not None and item in figures:
            found.append(figures[item])
    return found


def _on_signals(tables: Tables) -> list[str]:
    lines = [] if tables.get("electrodes") else ["No electrode was found bad."]
    for row in tables.get("waveforms", []):
        if row["n_without"]:
            lines.append(
                f"{words.who(row)}, {row['source']}: {count(row['n_without'], 'move')} without a waveform: samples are "
                "missing around it, or its epoch was rejected."
            )
    return lines
