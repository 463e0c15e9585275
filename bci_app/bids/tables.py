"""Tab-separated tables as BIDS wants them, and how new rows come into old ones."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bci_app.errors import SetupError

Row = dict[str, str]
NONE = "n/a"


def cell(value: Any) -> str:
    """A value as text: floats survive to the bit, nothing is `n/a`, no tab or line end breaks the table."""
    match value:
        case None | "":
            return NONE
        case bool():
            return "true" if value else "false"
        case float():
            return repr(value) if value == value else NONE
    return " ".join(str(value).split())


def text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """A table with its header line."""
    lines = ["\t".join(columns)]
    lines += ["\t".join(cell(row.get(name)) for name in columns) for row in rows]
    return "\n".join(lines) + "\n"


def read(path: Path) -> tuple[list[str], list[Row]]:
    """Columns and rows of a table; none of both where there is no such file.

    Raises SetupError where it isn't a table.
    """
    if not path.exists():
        return [], []
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"Can't read the table {path}: {error}. Restore or remove it.") from error
    columns = lines[0].split("\t") if lines else []
    rows = [line.split("\t") for line in lines[1:] if line]
    wrong = [number for number, row in enumerate(rows, 2) if len(row) != len(columns)]
    if wrong:
        raise SetupError(
            f"{path}: line {wrong[0]} should have {len(columns)} cells, one for each column. Mend or remove it."
        )
    return columns, [dict(zip(columns, row, strict=True)) for row in rows]


def merged(
    old: tuple[list[str], list[Row]], columns: Sequence[str], rows: Iterable[Mapping[str, Any]], key: str
) -> tuple[list[str], list[Row]]:
    """An old table with new rows: what somebody wrote into a row or a column of their own stays, and only what is
    missing is filled in."""
    names = [*old[0], *(name for name in columns if name not in old[0])]
    kept = [{name: row.get(name, NONE) for name in names} for row in old[1]]
    known = {row.get(key): row for row in kept}
    for row in rows:
        new = {name: cell(row.get(name)) for name in names}
        before = known.get(new[key])
        if before is None:
            kept.append(new)
            known[new[key]] = new
        else:
            before.update({name: value for name, value in new.items() if before[name] == NONE})
    return names, kept
