"""The report: what recordings of a session or a study show, as tables, figures and one page.

Everything goes through tables, lists of flat rows: what is computed of a recording becomes rows, figures and page are
made of rows and of nothing else, and rows of many participants are those of each put together.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]
"""One line of a table: plain numbers, words and None, by column."""
Tables = dict[str, list[Row]]
"""Tables by name; `docs/report.md` tells their columns."""

FEWEST_PEOPLE = 3
"""Participants below whom means over them have neither interval nor test: Student's t of two is 12.7 (decided)."""

AVERAGED = "mean"
"""What stands for the visit where one participant's visits are taken together."""


def those(rows: list[Row], **wanted: Any) -> list[Row]:
    """The rows that have these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def distinct(rows: list[Row], name: str) -> list[Any]:
    """The values of a column, each once, in the order in which they come."""
    return list(dict.fromkeys(row[name] for row in rows))


def by_person(rows: Sequence[Row], *values: str) -> list[Row]:
    """One row a participant: the means of these columns over the participant's rows, be they of visits or of runs, each
    row counting alike. What isn't known doesn't count; None where nothing is."""
    found = []
    for person in distinct(list(rows), "participant"):
        mine = those(list(rows), participant=person)
        row: Row = {"participant": person}
        for name in values:
            known = [each[name] for each in mine if each.get(name) is not None]
            row[name] = float(np.mean(known)) if known else None
        found.append(row)
    return found


def merged(tables: list[Tables]) -> Tables:
    """The rows of several put together, table by table."""
    return {name: [row for each in tables for row in each.get(name, [])] for each in tables for name in each}


def count(number: int, what: str) -> str:
    """A number of things, whose name comes as one: ``1 gap``, ``2 gaps``."""
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def unit_of(row: Row) -> str:
    """What a mean's ``n`` counts: moves of one participant, or participants."""
    return "participants" if row["participant"] == "all" else "moves"
