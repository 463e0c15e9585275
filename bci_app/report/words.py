"""Rows of tables in words, as people read them in a page."""

from collections.abc import Mapping, Sequence
from typing import Any

from bci_app.report import FEWEST_PEOPLE, Row, Tables, count, distinct, those
from bci_app.report.drawing import percent, words
from bci_app.report.in_a_row import level_name
from bci_app.report.online import PEOPLE
from bci_app.report.page import Grid

FEW = f"Over fewer than {FEWEST_PEOPLE} participants, and of a single move, there is no interval."


def number(value: float | None, digits: int = 1) -> str:
    """A number for people; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")


def with_interval(value: float | None, low: float | None, high: float | None, digits: int = 1) -> str:
    """A number with its interval, rounded alike, for what is rounded otherwise may lie outside; a dash where there is
    none."""
    if low is None or high is None:
        return f"{number(value, digits)} [–]"
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"


def with_bounds(row: Row, name: str) -> str:
    """A share with its interval, where one is known."""
    value, low, high = (row.get(f"{name}{end}") for end in ("", "_low", "_high"))
    if value is None:
        return "–"
    return percent(value) if low is None or high is None else f"{percent(value)} [{100 * low:.1f}, {100 * high:.1f}]"


def who(row: Row) -> str:
    """A participant, with the visit where it isn't the first."""
    name = str(row["participant"])
    return name if row.get("visit") in (None, "S001") else f"{name} {row['visit']}"


def calibrations(seen: Sequence[Mapping[str, Any]]) -> Grid | None:
    """What `fit` tells beside the shares of right verdicts."""
    lines = []
    for figures in seen:
        found = figures.get("calibration")
        if not found:
            continue
        expected, alone = found["session"]["accuracy"], found["eyes"]["alone"]
        lines.append(
            (
                who(dict(figures)),
                f"{found['n_valid']} of {found['n_moves']}",
                str(found["n_error"]),
                number(found["evidence"]["information"], 2),
                f"{100 * expected['low']:.0f} to {100 * expected['high']:.0f} % in {found['session']['n_moves']} moves",
                f"{number(found['reliability']['ece'], 3)} ({number(found['reliability']['ece_by_chance'], 3)})",
                number(alone["auc"]["value"], 2) if alone else "–",
                found["eyes"]["correction"],
            )
        )
    head = (
        "Participant",
        "Valid epochs",
        "Errors",
        "Bits a verdict",
        "Accuracy to expect online",
        "Calibration error (by chance)",
        "AUC of the eyes alone",
        "Eyes",
    )
    return Grid("Calibrations", head, lines) if lines else None


def table_one(tables: Tables) -> Grid:
    """Table I."""
    rows = tables["table_1"]
    columns = _columns(tables, "accuracy")
    return Grid(
        "Table I: share of right verdicts",
        ("Participant", *columns.values()),
        [(_whose(row), *(with_bounds(row, name) for name in columns)) for row in rows],
        _quiet(rows),
        "95 % intervals in brackets. Italics: the paper's numbers, of people, with its own decoder.",
    )


def beside_table_one(tables: Tables) -> Grid | None:
    """What Table I lacks."""
    rows = [row for row in tables["table_1"] if row["series"] != PEOPLE]
    columns = {
        f"balanced, {text[0].lower()}{text[1:]}": name for name, text in _columns(tables, "balanced_accuracy").items()
    } | {f"area under the ROC, {text[0].lower()}{text[1:]}": name for name, text in _columns(tables, "auc").items()}
    head = ("Participant", *(text[0].upper() + text[1:] for text in columns))
    lines = [(_whose(row), *(with_bounds(row, name) for name in columns.values())) for row in rows]
    note = "Plain accuracy flatters where one kind of move is rare: these don't. The paper doesn't tell them."
    return (
        Grid("Beside Table I: balanced accuracy and area under the ROC curve", head, lines, note=note)
        if columns
        else None
    )


def _columns(tables: Tables, measure: str) -> dict[str, str]:
    """Columns of Table I that have something in them, and their headings."""
    found = {f"{source}_{measure}": words(source) for source in ("tenfold", "contiguous", *_maps(tables))}
    return {
        name: text[0].upper() + text[1:]
        for name, text in found.items()
        if any(row.get(name) is not None for row in tables["table_1"])
    }


def table_two(tables: Tables) -> Grid | None:
    """Table II."""
    rows = tables.get("table_2", [])
    if not rows:
        return None
    maps = [name for name in _maps(tables) if any(row.get(f"{name}_n_episodes") for row in rows)]
    head = ["Participant"]
    for name in maps:
        head += [f"Success, {name}", f"Steps of successes, {name}", f"Steps of all, {name}"]
    lines = []
    for row in rows:
        cells = [_whose(row)]
        for name in maps:
            mean, sd = row.get(f"{name}_mean_steps"), row.get(f"{name}_sd_steps")
            steps = "–" if mean is None else f"{mean:.2f}" + ("" if sd is None else f" ± {sd:.2f}")
            cells += [with_bounds(row, f"{name}_success"), steps, number(row.get(f"{name}_mean_steps_all"), 2)]
        lines.append(cells)
    return Grid(
        "Table II: success and steps",
        head,
        lines,
        _quiet(rows),
        "Success within the limit of steps with Wilson's 95 % interval; mean ± standard deviation of the steps of "
        "episodes that reached the goal, as in the paper; failed episodes count with their steps in the last column. "
        "Italics: the paper's numbers, of people.",
    )


def tables_a(tables: Tables) -> list[Grid]:
    """Tables A1, A2, and of other maps."""
    grids = []
    for name in _maps(tables):
        rows = tables.get(f"table_a_{name}", [])
        if not rows:
            continue
        distances = [key for key in dict.fromkeys(key for row in rows for key in row) if key.startswith("distance_")]
        head = ("Participant", *(key.removeprefix("distance_") for key in distances), "Failed")
        lines = [
            (_whose(row), *(row.get(key) or "–" for key in distances), f"{row['failed']} of {row['n_episodes']}")
            for row in rows
            if row["series"] != PEOPLE
        ]
        label = {"open": "Table A1", "obstacles": "Table A2"}.get(name, "Table A")
        people = ", ".join(f"{row['participant']} {row['failed']}" for row in rows if row["series"] == PEOPLE)
        note = "Columns are initial distances to the goal."
        note += f" Failed of 19 in the paper, of people: {people}." if people else ""
        grids.append(Grid(f"{label}: steps of each episode, map {name}", head, lines, note=note))
    return grids


def peaks(tables: Tables) -> Grid | None:
    """Peaks of the difference waves."""
    rows = tables.get("erp_peaks", [])
    lines = [
        (
            who(row),
            row["source"],
            row["channel"],
            row["peak"],
            _of(row),
            f"{row['time_ms']:.0f}",
            with_interval(row["mean_uv"], row["low_uv"], row["high_uv"]),
        )
        for row in rows
    ]
    head = ("Participant", "Moves of", "Channel", "Peak", "Mean of", "At (ms)", "Amplitude (µV)")
    note = (
        f"Of error less correct. The interval is that of the mean at this moment, which was picked by its size. {FEW}"
    )
    return Grid("Peaks of the difference wave", head, lines, note=note) if rows else None


def area_tests(tables: Tables) -> list[Grid]:
    """Accuracies by area against each other, and where waveforms differ."""
    grids = []
    rows = tables.get("area_test", [])
    if rows:
        lines = [
            (
                who(row),
                row["map"],
                percent(row["central"]),
                percent(row["edge"]),
                with_interval(*(100 * row[name] for name in ("difference", "low", "high"))),
                f"{row['p']:.3f}",
                f"{row['test']}, {_of(row)}",
            )
            for row in rows
        ]
        head = ("Participant", "Map", "Central", "Edge", "Difference (points)", "p", "Test")
        grids.append(Grid("Right verdicts, central against edge area", head, lines))
    clusters = tables.get("erp_clusters", [])
    if clusters:
        lines = [
            (
                who(row),
                row["source"],
                row["channel"],
                row["comparison"],
                "none" if row["begin_ms"] is None else f"{row['begin_ms']:.0f} to {row['end_ms']:.0f}",
                f"{row['p']:.3f}",
                _of(row),
            )
            for row in clusters
        ]
        head = ("Participant", "Moves of", "Channel", "Comparison", "Differs at (ms)", "p", "Of")
        note = (
            "Cluster-based permutation tests with 1000 permutations; where there is no cluster, p is the least found."
        )
        grids.append(Grid("Where waveforms differ", head, lines, note=note))
    return grids


def levels(tables: Tables) -> Grid | None:
    """Sizes by errors in a row."""
    rows = tables.get("errors_in_a_row", [])
    lines = [
        (
            who(row),
            row["source"],
            level_name(row),
            _of(row),
            with_interval(row["mean"], row["low"], row["high"]),
            number(row["peak_to_peak"]),
        )
        for row in rows
    ]
    head = ("Participant", "Moves of", "Errors in a row", "Mean of", "Mean around the peaks (µV)", "Peak to peak (µV)")
    return Grid("Size of the error potential by errors in a row", head, lines, note=FEW) if rows else None


def _of(row: Row) -> str:
    """What a row's mean or test is of."""
    unit = row["unit"].removesuffix("s")
    return count(row["n"], unit)


def _maps(tables: Tables) -> list[str]:
    return distinct(those(tables["runs"], task="online"), "map")


def _whose(row: Row) -> str:
    return f"{row['participant']} (published)" if row["series"] == PEOPLE else who(row)


def _quiet(rows: Sequence[Row]) -> frozenset[int]:
    return frozenset(place for place, row in enumerate(rows) if row["series"] == PEOPLE)
