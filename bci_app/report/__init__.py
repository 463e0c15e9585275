"""The report: what recordings of a session or a study show, as tables, figures and one page.

Everything goes through tables, lists of flat rows: what is computed of a recording becomes rows, figures and page are
made of rows and of nothing else, and rows of many participants are those of each put together.
"""

from typing import Any

Row = dict[str, Any]
"""One line of a table: plain numbers, words and None, by column."""
Tables = dict[str, list[Row]]
"""Tables by name; `docs/report.md` tells their columns."""


def those(rows: list[Row], **wanted: Any) -> list[Row]:
    """The rows that have these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def distinct(rows: list[Row], name: str) -> list[Any]:
    """The values of a column, each once, in the order in which they come."""
    return list(dict.fromkeys(row[name] for row in rows))


def merged(tables: list[Tables]) -> Tables:
    """The rows of several put together, table by table."""
    return {name: [row for each in tables for row in each.get(name, [])] for each in tables for name in each}
