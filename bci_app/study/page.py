"""The report of a study: one page and its tables, in a new folder each time."""

from collections.abc import Sequence
from pathlib import Path

from bci_app.errors import SetupError
from bci_app.report import FEWEST_PEOPLE, Row, Tables, count, page, words
from bci_app.report.drawing import percent
from bci_app.report.making import write_tables
from bci_app.report.page import Grid, Section
from bci_app.report.sources import free_folder
from bci_app.study import tables
from bci_app.study.plan import SAID, Condition, Study


def write(
    study: Study,
    through: str,
    people: Sequence[tables.Person],
    rows: Sequence[Row],
    own: Sequence[Row],
    lacking: Sequence[Row],
) -> Path:
    """Write the report; the page's path.

    Parameters
    ----------
    rows, own, lacking : of `tables.headline`, `tables.by_participant` and `tables.unfinished`.

    Raises SetupError where it can't be written.
    """
    maps = tables.maps_of(study.maps)
    papers = tables.papers_tables(people, study.conditions, maps)
    found: Tables = {
        "headline": tables.against_published(rows),
        "participants": list(own),
        "choices": tables.choices(people, study.conditions, maps),
        "where_right": tables.where_right(people, study.conditions, maps),
        "unfinished": list(lacking),
        **papers,
    }
    folder = free_folder(study.home)
    try:
        (folder / "tables").mkdir(parents=True)
        write_tables(folder / "tables", found)
        sections = _sections(study, maps, found, rows, own)
        text = page.render(f"Study {study.name}", _first(study, through, people, rows, lacking), sections)
        (folder / "report.html").write_text(text, encoding="utf-8")
    except OSError as error:
        raise SetupError(f"Can't write the report into {folder}: {error.strerror}. Free or unlock the disk.") from error
    return folder / "report.html"


def _first(
    study: Study, through: str, people: Sequence[tables.Person], rows: Sequence[Row], lacking: Sequence[Row]
) -> list[str]:
    """The page's first sentences."""
    kinds = [person["kind"] for person in people]
    who = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    how = "the real processes over LSL" if through == "processes" else "the same functions in one process, without LSL"
    if through == "processes" and study.speed != 1 and any(kind != "real" for kind in kinds):
        how += f" at {study.speed:g} times the speed" + (" (real ones at 1)" if "real" in kinds else "")
    if study.in_one_process and through == "processes":
        how += f", but for {', '.join(study.in_one_process)} in one process"
    lines = [f"{count(len(people), 'participant')} ({who}), through {how}. Every condition has the same episodes."]
    for row in rows:
        if row["group"] == tables.ALL and row["map"] == tables.ALL and row["condition"] != tables.NONE:
            against = "" if row["steps_vs_none"] is None else f"{_steps(row)} steps against no ErrP, "
            lines.append(f"{_sentence(row['condition'])}: {against}success {percent(row['success'])}.")
    if any(kind == "simulated" for kind in kinds):
        lines.append(
            "Simulated participants are no people: this is what the study would show if people were like them."
        )
    if lacking:
        names = ", ".join(row["participant"] for row in lacking)
        lines.append(f"Not all is done: {names}. Comparisons hold only those who have both conditions.")
    return lines


def _sections(
    study: Study, maps: Sequence[str], found: Tables, rows: Sequence[Row], own: Sequence[Row]
) -> list[Section]:
    shown = [_published(found["headline"]), *_headlines(rows)]
    per_person = [
        (SAID[condition], [_people(own, condition)]) for condition in study.conditions if condition != tables.NONE
    ]
    sections = [
        Section("Steps against no ErrP", shown=shown, folded=per_person),
        Section("Not done", shown=[_lacking(found["unfinished"])] if found["unfinished"] else []),
    ]
    for condition in study.conditions:
        mine = _of_condition(found, condition, maps)
        if mine:
            sections.append(Section(f"Condition {condition}", [f"{_sentence(condition)}."], mine))
    sections += [
        Section("Where verdicts are right", shown=[_where(found["where_right"])]),
        Section("Policies", shown=[_choices(found["choices"])]),
        Section("Files", ["Beside this page: tables/ holds each table as CSV and JSON."]),
    ]
    return [section for section in sections if section.text or section.shown]


def _of_condition(found: Tables, condition: str, maps: Sequence[str]) -> list[Grid]:
    """The paper's tables of a condition, by the report's own words."""
    runs = [{"task": "online", "map": name} for name in maps]
    mine: Tables = {"runs": runs}
    for name in ("table_1", "table_2", *(f"table_a_{each}" for each in maps)):
        if f"{name}_{condition}" in found:
            mine[name] = found[f"{name}_{condition}"]
    grids = [words.table_one(mine)] if "table_1" in mine else []
    second = words.table_two(mine)
    return [*grids, *([second] if second else []), *words.tables_a(mine)]


def _steps(row: Row) -> str:
    if row["steps_vs_none"] is None:
        return "–"
    value, low, high = (row[f"steps_vs_none{end}"] for end in ("", "_low", "_high"))
    text = f"{words.number(100 * value)} %"
    if low is not None and high is not None:
        text += f" [{words.number(100 * low)}, {words.number(100 * high)}]"
    return _together(text)


def _together(text: str) -> str:
    """An interval isn't broken over lines."""
    return text.replace(" %", "\u00a0%").replace(", ", ",\u00a0")


def _sentence(condition: Condition) -> str:
    """What a condition is, as the beginning of a sentence."""
    return SAID[condition][0].upper() + SAID[condition][1:]


def _p(value: float | None) -> str:
    return "–" if value is None else "< 0.001" if value < 0.001 else f"{value:.3f}"


def cells(row: Row) -> tuple[str, ...]:
    """Success, steps and tests of a row of `tables.headline` or `tables.by_participant`, in words."""
    mean = words.number(row["mean_steps"], 2)
    if row["mean_steps_low"] is not None:
        mean = words.with_interval(row["mean_steps"], row["mean_steps_low"], row["mean_steps_high"], 2)
    return (
        _together(words.with_bounds(row, "success")),
        _together(mean),
        words.number(row["mean_steps_of_successes"], 2),
        _steps(row) if row["condition"] != "none" else "–",
        _p(row["p"]) if row["condition"] != "none" else "–",
        _p(row["p_ranks"]) if row["condition"] != "none" else "–",
    )


_HEAD = ("Success", "Mean steps", "Of successes", "Against no ErrP", "p (t)", "p (ranks)")


def _headlines(rows: Sequence[Row]) -> list[Grid]:
    """One table for each group of participants."""
    grids: list[Grid] = []
    for group in dict.fromkeys(row["group"] for row in rows):
        mine = [row for row in rows if row["group"] == group]
        lines = [(row["condition"], row["map"], str(row["participants"]), *cells(row)) for row in mine]
        caption = f"Participants: {group}"
        grids.append(Grid(caption, ("Condition", "Map", "People", *_HEAD), lines, note=_NOTE if not grids else ""))
    return grids


_NOTE = (
    "Success within the limit of steps, with Wilson's interval over the different episodes; mean steps over "
    "participants with Student's, failed episodes with their steps. Against no ErrP: ratio of the means over "
    "participants, each paired with themselves; paired t test, and Wilcoxon's signed-rank test. All intervals are of "
    "95 %. Without verdicts the agent moves the same with everybody, for the episodes are the same: intervals are over "
    f"people, for these episodes. Over fewer than {FEWEST_PEOPLE} participants there is neither interval nor test: "
    "those of each participant are below."
)


def _people(rows: Sequence[Row], condition: Condition) -> Grid:
    lines = [(row["participant"], row["map"], *cells(row)) for row in rows if row["condition"] == condition]
    note = "Intervals and tests over a participant's episodes, each paired with the same episode without ErrP."
    return Grid(f"Each participant, condition {condition}", ("Participant", "Map", *_HEAD), lines, note=note)


def _published(rows: Sequence[Row]) -> Grid:
    lines: list[tuple[str, ...]] = []
    quiet: list[int] = []
    for row in rows:
        ours = row["series"] == "ours"
        if ours and (row["group"] not in (tables.ALL, "of the paper") or row["condition"] == "none"):
            continue
        if not ours:
            quiet.append(len(lines))
        name = f"{row['condition']}, {row['group']}" if ours else row["series"]
        steps = _steps({"steps_vs_none_low": None, "steps_vs_none_high": None, "steps_vs_none": None, **row})
        lines.append((name, row.get("map") or "–", steps, words.with_bounds(row, "success")))
    return Grid(
        "Beside the paper",
        ("Series", "Map", "Against no ErrP", "Success"),
        lines,
        frozenset(quiet),
        "Italics: published.",
    )


def _where(rows: Sequence[Row]) -> Grid:
    said = {"areas": "area", "errors_in_a_row": "errors in a row"}
    lines = [
        (
            row["condition"],
            said[row["of"]],
            "5 or more" if row["level"] == "5" else row["level"],
            f"{row['n']:,}",
            str(row["participants"]),
            words.with_bounds({"right": row["right"], "right_low": row["low"], "right_high": row["high"]}, "right"),
        )
        for row in rows
    ]
    note = f"Of all moves together; intervals are over participants, from {FEWEST_PEOPLE} on."
    head = ("Condition", "By", "Where", "Moves", "People", "Right")
    return Grid("Right verdicts of all participants", head, lines, note=note)


def _choices(rows: Sequence[Row]) -> Grid:
    names = ("participant", "condition", "map", "policy", "why")
    return Grid(
        "Policies", tuple(name.capitalize() for name in names), [tuple(row[name] for name in names) for row in rows]
    )


def _lacking(rows: Sequence[Row]) -> Grid:
    return Grid(
        "Not done", ("Participant", "Why", "Lacks"), [(row["participant"], row["why"], row["lacks"]) for row in rows]
    )
