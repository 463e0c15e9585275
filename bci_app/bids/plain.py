"""One run as BrainVision or EEGLAB files, without a dataset around them."""

import json
import tempfile
from pathlib import Path
from typing import Any, Literal

from bci_app.bids import files
from bci_app.bids.columns import COLUMNS
from bci_app.bids.dataset import STAGING
from bci_app.bids.source import read_source
from bci_app.errors import SetupError
from bci_app.progress import Progress

Format = Literal["brainvision", "eeglab"]


def export(path: Path, out: Path, kind: Format, allow_damage: bool, progress: Progress) -> dict[str, Any]:
    """Write a recording as the files of another program, its table of events beside them.

    Returns ``file``, ``samples``, ``events``, ``lost_samples`` and ``samples_are``. Raises SetupError where the
    recording is unusable, or files of that name are there already.
    """
    if not path.is_file():
        raise SetupError(f"There is no recording {path}. Name one (.xdf); export-bids takes folders.")
    if out.exists() and not out.is_dir():
        raise SetupError(f"{out} is a file; --out must be a folder.")
    progress("reading the recording", 0, 3)
    source = read_source(path, allow_damage)
    name, rows = path.stem, source.events.rows
    there = sorted(out.glob(f"{source.run.stem.name}_*")) if out.is_dir() else []
    if there:
        raise SetupError(f"{there[0]} is there already. Nothing is overwritten: choose another folder, or remove it.")
    progress("writing", 1, 3)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=STAGING, dir=out) as scratch:
            write = files.write_eeglab if kind == "eeglab" else files.write_brainvision
            written = write(Path(scratch), name, source.signals, rows)
            progress("reading back", 2, 3)
            files.check_same(files.read_back(written), source.signals)
            for each in sorted(Path(scratch).iterdir()):
                each.replace(out / each.name)
        table = out / f"{source.run.stem.name}_events.tsv"
        table.write_text(files.events_text(rows), encoding="utf-8")
        table.with_suffix(".json").write_text(
            json.dumps(COLUMNS, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise SetupError(f"Can't write into {out}: {error}. Choose another folder, or free the disk.") from error
    progress("done", 3, 3)
    return {
        "file": str(out / written.name),
        "table": str(table),
        "samples": len(source.signals.values),
        "events": len(rows),
        "lost_samples": source.n_lost,
        "samples_are": source.signals.precision,
    }
