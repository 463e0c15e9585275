"""Parts of all participants put together: the paper's tables, conditions against no ErrP, where verdicts were right.

All rows are made of what is kept of participants (`parts.Kept.head`, `parts`, `stopped`), as plain values. Failed
episodes count with their 60 steps, unless a column says that it is of successes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bci_app.report import FEWEST_PEOPLE, Row, Tables, calibrations, online, published
from bci_app.study.comparing import mean, ratio, share, success

Person = Mapping[str, Any]
"""What is kept of a participant: `participant`, `kind`, `published`, `parts`, `stopped`."""
ALL = "all"
"""Both maps together, or all participants."""


def maps_of(names: Sequence[str]) -> list[str]:
    """Names of maps, of files by their stems."""
    return [Path(name).stem for name in names]


def part(person: Person, condition: str, map_name: str) -> Mapping[str, Any] | None:
    """An online run that is done."""
    found: Mapping[str, Any] | None = person["parts"].get(f"{condition} {map_name}")
    return found


def episodes(person: Person, condition: str, maps: Sequence[str]) -> list[Row]:
    """Of a participant's runs under a condition, all maps or nothing: rows with the map's name."""
    rows = []
    for name in maps:
        found = part(person, condition, name)
        if found is None:
            return []
        rows += [{**row, "map": name} for row in found["episodes"] if row["reason"] in ("goal", "limit")]
    return rows


NONE = "none"
"""The condition that the others are compared with."""
OVER_PAIRS = ("steps_vs_none_low", "steps_vs_none_high", "p", "p_ranks")
OVER_PEOPLE = ("mean_steps_low", "mean_steps_high", *OVER_PAIRS)
"""What is told of three participants or more, and not of fewer."""


def compared(people: Sequence[Person], condition: str, against: str, maps: Sequence[str]) -> Row | None:
    """A condition over participants: success, mean steps, and steps against another condition.

    Participants who lack one of the two don't enter the comparison, and one who lacks the condition enters nothing.
    None where nobody has it.
    """
    own = {each["participant"]: episodes(each, condition, maps) for each in people}
    own = {name: rows for name, rows in own.items() if rows}
    if not own:
        return None
    rows = [row for found in own.values() for row in found]
    other = {each["participant"]: episodes(each, against, maps) for each in people}
    both = [name for name in own if other.get(name)]
    means = [_mean_steps(found) for found in own.values()]
    if len(own) == 1:  # a single participant: over episodes
        interval = mean([row["steps"] for row in rows])
        pairs = _paired(own[both[0]], other[both[0]]) if both else ([], [])
    else:
        interval = mean(means)
        pairs = ([_mean_steps(own[name]) for name in both], [_mean_steps(other[name]) for name in both])
    steps = ratio(*pairs) if pairs[0] else None
    reached = [row["steps"] for row in rows if row["success"]]
    return {
        "participants": len(own),
        "n_episodes": len(rows),
        **success(len(reached) / len(rows), len({_which(row) for row in rows})),
        **interval,
        "mean_steps_of_successes": float(np.mean(reached)) if reached else None,
        "sd_steps_of_successes": float(np.std(reached, ddof=1)) if len(reached) > 1 else None,
        "steps_vs_none": steps.value if steps else None,
        "steps_vs_none_low": steps.low if steps else None,
        "steps_vs_none_high": steps.high if steps else None,
        "p": steps.p if steps else None,
        "p_ranks": steps.p_ranks if steps else None,
        "n_pairs": steps.n if steps else 0,
    }


def _mean_steps(rows: Sequence[Row]) -> float:
    return float(np.mean([row["steps"] for row in rows]))


def _which(row: Row) -> tuple[Any, ...]:
    """Which of the pre-generated episodes it is: map, start and goal."""
    return tuple(row[name] for name in ("map", "start_row", "start_column", "goal_row", "goal_column"))


def _paired(rows: Sequence[Row], others: Sequence[Row]) -> tuple[list[float], list[float]]:
    """Steps of the same episodes."""
    mine = {_which(row): row["steps"] for row in rows}
    theirs = {_which(row): row["steps"] for row in others}
    both = [key for key in mine if key in theirs]
    return [mine[key] for key in both], [theirs[key] for key in both]


def groups(people: Sequence[Person], papers_gate: float) -> dict[str, list[Person]]:
    """All participants, those whom the paper keeps, and those whom it sends home by the accuracy of its classifier;
    those without a calibration in none of the two."""
    known = [each for each in people if "calibration" in each["parts"]]
    accuracy = {each["participant"]: _papers_accuracy(each) for each in known}
    shown = [each for each in people if each.get("published")]
    found = {
        ALL: list(people),
        "of the paper": shown,
        "below the paper's gate": [each for each in known if accuracy[each["participant"]] < papers_gate],
    }
    return {name: group for name, group in found.items() if group}


def _papers_accuracy(person: Person) -> float:
    return float(person["parts"]["calibration"]["paper"]["tenfold"]["accuracy"]["value"])


def headline(people: Sequence[Person], conditions: Sequence[str], maps: Sequence[str], papers_gate: float) -> list[Row]:
    """Each condition by group of participants and map, and on all maps together. Over fewer than
    `FEWEST_PEOPLE` participants there are no intervals and no tests."""
    rows = []
    for group, those in groups(people, papers_gate).items():
        for condition in conditions:
            for name in (*maps, ALL):
                found = compared(those, condition, NONE, maps if name == ALL else [name])
                if found is not None:
                    if found["participants"] < FEWEST_PEOPLE:
                        found |= dict.fromkeys(OVER_PEOPLE)
                    elif found["n_pairs"] < FEWEST_PEOPLE:
                        found |= dict.fromkeys(OVER_PAIRS)
                    rows.append({"group": group, "condition": condition, "map": name, **found})
    return rows


def by_participant(people: Sequence[Person], conditions: Sequence[str], maps: Sequence[str]) -> list[Row]:
    """The same for each participant, over episodes."""
    rows = []
    for person in people:
        for condition in conditions:
            for name in (*maps, ALL):
                found = compared([person], condition, NONE, maps if name == ALL else [name])
                if found is not None:
                    rows.append({"participant": person["participant"], "condition": condition, "map": name, **found})
    return rows


def papers_tables(people: Sequence[Person], conditions: Sequence[str], maps: Sequence[str]) -> Tables:
    """Tables I, II, A1 and A2 for each condition, as `bci-app report` makes them, with the paper's rows below.

    A condition in which nobody heard a verdict has no Table I.
    """
    tables: Tables = {}
    for condition in conditions:
        runs = [_run(each, name) for each in people for name in maps if part(each, condition, name)]
        if not runs:
            continue
        rows = [
            {"participant": each["participant"], "visit": None, **row}
            for each in people
            for name in maps
            for row in episodes(each, condition, [name])
        ]
        scores = [row for each in people for row in _scores(each, condition, maps)]
        if any(row["source"] in maps for row in scores):
            tables[f"table_1_{condition}"] = online.table_one(scores, runs)
        tables[f"table_2_{condition}"] = online.table_two(rows, runs)
        for name in maps:
            tables[f"table_a_{name}_{condition}"] = online.table_a(rows, runs, name)
    return tables


def _run(person: Person, map_name: str) -> Row:
    return {"participant": person["participant"], "visit": None, "task": "online", "map": map_name}


def _scores(person: Person, condition: str, maps: Sequence[str]) -> list[Row]:
    where: Row = {"participant": person["participant"], "visit": None}
    rows = []
    calibration = person["parts"].get("calibration mute" if condition == "mute" else "calibration")
    if calibration and condition == "paper":
        calibration = calibration["paper"]
    if calibration:
        for source in ("tenfold", "contiguous"):
            rows += calibrations.score_rows(calibration[source], source, **where)
    for name in maps:
        found = part(person, condition, name)
        if found and found["scores"]:
            rows += calibrations.score_rows(found["scores"], name, **where)
    return rows


def choices(people: Sequence[Person], conditions: Sequence[str], maps: Sequence[str]) -> list[Row]:
    """Which policy each participant's runs had, and why."""
    rows = []
    for person in people:
        for condition in conditions:
            for name in maps:
                found = part(person, condition, name)
                if found is not None:
                    said = {
                        key: found[key] for key in ("policy", "why", "listens", "n_moves", "n_rejected", "recording")
                    }
                    rows.append({"participant": person["participant"], "condition": condition, "map": name, **said})
    return rows


def where_right(people: Sequence[Person], conditions: Sequence[str], maps: Sequence[str]) -> list[Row]:
    """Share of right verdicts by area, and after errors in a row, of all participants together, with intervals over
    participants."""
    rows = []
    for condition in conditions:
        found = [[run for name in maps if (run := part(each, condition, name)) is not None] for each in people]
        for kind in ("areas", "errors_in_a_row"):
            for level in dict.fromkeys(level for runs in found for run in runs for level in run[kind]):
                counts = [[sum(run[kind][level][place] for run in runs) for place in (0, 1)] for runs in found]
                heard = [each for each in counts if each[1]]
                if heard:
                    right, n = zip(*heard, strict=True)
                    value, low, high = share(right, n)
                    row = {"condition": condition, "of": kind, "level": level, "participants": len(n), "n": sum(n)}
                    rows.append({**row, "right": value, "low": low, "high": high})
    return rows


def unfinished(people: Sequence[Person], wanted: Mapping[str, Sequence[str]]) -> list[Row]:
    """Participants who stopped, failed or haven't come yet, what is lacking of them, and why.

    Parameters
    ----------
    wanted : the parts of each participant.
    """
    rows = []
    for person in people:
        lacking = [name for name in wanted[person["participant"]] if name not in person["parts"]]
        if lacking:
            stopped = person["stopped"]
            why = f"stopped in {stopped['part']}: {stopped['why']}" if stopped else "hasn't come yet"
            if not stopped and person["parts"]:
                why = "interrupted"
            rows.append({"participant": person["participant"], "lacks": ", ".join(lacking), "why": why})
    return rows


def against_published(rows: Sequence[Row]) -> list[Row]:
    """The headline beside the paper's: fewer steps than without ErrP, and success."""
    found: list[Row] = [
        {"series": "paper, people (abstract)", "steps_vs_none": PUBLISHED_PEOPLE},
        {"series": "paper, simulation at 70 % (abstract)", "steps_vs_none": PUBLISHED_SIMULATION},
        *(
            {"series": "paper, people (Table II)", "map": name, "success": share}
            for name, share in published.MEAN_SUCCESS.items()
        ),
    ]
    names = ("group", "condition", "map", "participants", "success", "success_low", "success_high", "mean_steps")
    ends = ("", "_low", "_high")
    for row in rows:
        steps = {f"steps_vs_none{end}": row[f"steps_vs_none{end}"] for end in ends}
        found.append({"series": "ours", **{name: row[name] for name in names}, **steps, "p": row["p"]})
    return found


PUBLISHED_PEOPLE = -0.149
"""Fewer steps than without ErrP, of people (abstract)."""
PUBLISHED_SIMULATION = -0.141
"""The same of the simulation with verdicts right at 70 % (abstract)."""
