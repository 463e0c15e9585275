"""`bci-app report`: recordings in, a folder with a page, figures and tables out."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from bci_app.errors import SetupError
from bci_app.progress import Progress
from bci_app.report import Row, Tables, contents, merged, page, sources, study, visits
from bci_app.report.drawing import Written, write
from bci_app.runs import why_not_writable


def make(paths: Sequence[Path], out: Path | None, allow_damage: bool, progress: Progress) -> dict[str, Any]:
    """Make a report of recordings, or of all in a folder.

    Parameters
    ----------
    out : folder of the report; by default ``report`` beside the recordings, numbered from the second on.

    Returns ``report``, the page's path, ``participants``, ``recordings``, ``left_out`` (why recordings in a folder
    aren't in it: they are somebody else's, or of runs that never began), ``errors`` and ``warnings`` (how many things
    went wrong), ``figures``, ``tables`` and ``seconds``.
    Raises SetupError for recordings that can't be used, and for a folder that isn't empty.
    """
    started = perf_counter()
    files = sources.find(paths)
    wanted = sources.visits([sources.source(path) for path in files])
    folder = _folder(out, files, wanted)
    named = {path.absolute() for path in paths}
    looked = [
        visits.see(visit, allow_damage, lambda what, n=number: progress(what, n, len(wanted) + 1), named)  # type: ignore[misc]
        for number, visit in enumerate(wanted)
    ]
    seen = [each for each in looked if each.tables]
    left_out = [sentence for each in looked for sentence in each.left_out]
    if not seen:
        raise SetupError(f"None of the {len(files)} recordings is of this experiment. {left_out[0]}")
    tables = study.complete(merged([each.tables for each in seen]))
    figures = [each.figures for each in seen]
    progress("drawing", len(wanted), len(wanted) + 1)
    written = write_report(folder, tables, figures)
    progress("done", len(wanted) + 1, len(wanted) + 1)
    levels = [row["level"] for row in tables.get("events", [])]
    return {
        "report": str(folder / "report.html"),
        "participants": len({each["participant"] for each in figures}),
        "recordings": len(files) - len(left_out),
        "left_out": left_out,
        "errors": levels.count("error"),
        "warnings": levels.count("warning"),
        "figures": len(written),
        "tables": sum(bool(rows) for rows in tables.values()),
        "seconds": perf_counter() - started,
    }


def write_report(folder: Path, tables: Tables, figures: Sequence[Mapping[str, Any]]) -> dict[str, Written]:
    """Write figures, tables and page into a new folder; the figures by name.

    Parameters
    ----------
    tables : of `report.study.complete`.
    figures : of each participant's session, `report.visits.Seen.figures`.
    """
    try:
        for each in (folder / "figures", folder / "tables"):
            each.mkdir(parents=True)
        written = {}
        for name, draw in contents.drawings(tables):
            drawn = draw()
            if drawn is not None:
                written[name] = write(name, drawn, folder / "figures")
        write_tables(folder / "tables", tables)
        summary = json.dumps({"sessions": list(figures)}, indent=2)
        (folder / "report.json").write_text(summary + "\n", encoding="utf-8")
        text = page.render(
            contents.title(tables), contents.summary(tables, figures), contents.sections(tables, written, figures)
        )
        (folder / "report.html").write_text(text, encoding="utf-8")
    except OSError as error:
        raise SetupError(
            f"Can't write the report into {folder}: {error.strerror}. Free or unlock the disk, or choose another --out."
        ) from error
    return written


def _folder(out: Path | None, files: Sequence[Path], wanted: Sequence[sources.Visit]) -> Path:
    """Where the report goes; that it can go there is better known before an hour of recordings is read."""
    folder = sources.free_folder(sources.folder_of(files, wanted)) if out is None else out
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SetupError(f"{folder} is there already, and nothing is overwritten. Name a new folder with --out.")
    inside = next(each for each in (folder.absolute(), *folder.absolute().parents) if each.exists())
    why = why_not_writable(inside)
    if why:
        raise SetupError(
            f"Can't write the report into {folder}: {inside} isn't a folder that may be written into ({why}). "
            "Choose another --out."
        )
    return folder


def write_tables(folder: Path, tables: Tables) -> None:
    """Each table that has rows as CSV and JSON, into a folder that is there."""
    for name, rows in tables.items():
        if rows:
            _write_table(folder / name, rows)


def _write_table(stem: Path, rows: Sequence[Row]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with stem.with_name(f"{stem.name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    lines = ",\n".join(json.dumps(row) for row in rows)
    stem.with_name(f"{stem.name}.json").write_text(f"[\n{lines}\n]\n", encoding="utf-8")
