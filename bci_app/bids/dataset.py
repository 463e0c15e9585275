"""A BIDS dataset of recorded runs: new ones come in whole or not at all, and nothing in it is ever overwritten."""

import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from filecmp import cmp
from pathlib import Path
from typing import Any

from bci_app import whole
from bci_app.bids import files, tables, words
from bci_app.bids.about import About
from bci_app.bids.columns import COLUMNS
from bci_app.bids.source import NAME, Source, find, read_source, run_of
from bci_app.errors import SetupError
from bci_app.progress import Progress

STAGING = ".bci-app-"
"""Beginning of the folder in which a run is put together."""


def export_bids(
    paths: Sequence[Path], out: Path, about: About, allow_damage: bool, progress: Progress
) -> dict[str, Any]:
    """Put recordings into a dataset, new or begun.

    Returns ``dataset``, ``runs`` (what became of each), ``left_out`` (why some aren't in it), ``notes`` (of whom only
    ``about`` tells) and ``fit``: whether all are in it.

    Raises SetupError where nothing can be written: no recordings, or a folder that is no BIDS dataset.
    """
    found = [path for path in find(paths) if not path.resolve().is_relative_to(out.resolve())]
    is_new = not out.exists() or (out.is_dir() and not any(out.iterdir()))
    _open(out, about)
    runs, left_out = [], []
    for number, path in enumerate(found):
        progress(path.name, number, len(found))
        try:
            runs.append(_add(path, out, about, allow_damage))
        except SetupError as error:
            left_out.append(str(error))
    progress("done", len(found), len(found))
    if is_new and not runs:
        shutil.rmtree(out)  # a dataset of nothing is none
    return {
        "dataset": str(out),
        "runs": runs,
        "left_out": left_out,
        "notes": _strangers(found, out, about),
        "fit": not left_out,
    }


def _strangers(found: Sequence[Path], out: Path, about: About) -> list[str]:
    """Whom the lab tells of, and no recording is of: a slip of the pen leaves the right one without age and sex."""
    here = {match["participant"] for path in found if (match := NAME.fullmatch(path.name))}
    if set(about.participants) <= here:
        return []
    here |= {row["participant_id"].removeprefix("sub-") for row in tables.read(out / "participants.tsv")[1]}
    strangers = sorted(set(about.participants) - here)
    if not strangers:
        return []
    there = ", ".join(sorted(here))
    return [f"--about tells of {', '.join(strangers)}, of whom there is no recording here. There are some of {there}."]


def _open(out: Path, about: About) -> None:
    """See to it that there is a dataset."""
    described = out / "dataset_description.json"
    if out.exists() and not out.is_dir():
        raise SetupError(f"{out} is a file; --out must be a folder, new or of a BIDS dataset.")
    for left in out.glob(f"{STAGING}*"):  # of an export that was killed
        shutil.rmtree(left, ignore_errors=True)
    if out.exists() and any(out.iterdir()) and not described.exists():
        raise SetupError(f"{out} holds something else than a BIDS dataset. Choose a new folder, or an empty one.")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError(f"Can't write into {out}: {error.strerror}. Choose another folder.") from error
    name = words.dataset(about)["Name"]
    if not described.exists():
        from mne_bids import make_dataset_description

        with _staging(out) as scratch:
            make_dataset_description(path=scratch, name=name, dataset_type="raw", verbose="ERROR")
            made = json.loads((scratch / described.name).read_text(encoding="utf-8"))
        # Its placeholders for authors are worse than none.
        _write_json(described, {key: made[key] for key in made if key != "Authors"} | words.dataset(about))
    if not any(out.glob("README*")):
        _write(out / "README.md", words.readme(name))


def _add(path: Path, out: Path, about: About, allow_damage: bool) -> dict[str, Any]:
    """Put one run into the dataset, unless it is there; what became of it."""
    kept = out / "sourcedata" / run_of(path).stem.relative_to(path.parent).parent / path.name
    if kept.exists() and not cmp(path, kept, shallow=False):
        raise SetupError(
            f"{path} is another recording than the one of the same name in {out}. Nothing is overwritten: give it "
            "another run number, or export it into a dataset of its own."
        )
    source = read_source(path, allow_damage)
    if not kept.exists():
        with _staging(out) as scratch:
            _write_run(source, scratch, about, _has_hed(out))
            _move_in(scratch, out, _stem(source))
    _into_tables(source, out, about)
    for companion in source.companions():
        _copy(companion, kept.with_name(companion.name))
    # The recording comes last: where it is, all of the run is.
    state = "there already" if kept.exists() else "written"
    _copy(path, kept)
    return {
        "recording": str(path),
        "eeg": str(_folder(source, out) / f"{_stem(source)}_eeg.vhdr"),
        "state": state,
        "samples": len(source.signals.values),
        "samples_are": source.signals.precision,
        "lost_samples": source.n_lost,
        "events": len(source.events.rows),
        "epochs": source.events.n_epochs,
        "placed": source.events.n_same,
    }


def _stem(source: Source) -> str:
    return source.run.stem.name


def _folder(source: Source, root: Path) -> Path:
    return root / f"sub-{source.run.participant}" / f"ses-{source.run.visit}" / "eeg"


@contextmanager
def _staging(out: Path) -> Iterator[Path]:
    try:
        scratch = Path(tempfile.mkdtemp(prefix=STAGING, dir=out))
    except OSError as error:
        raise SetupError(f"Can't write into {out}: {error.strerror}. Free or unlock the disk.") from error
    try:
        yield scratch
    except OSError as error:
        raise SetupError(f"Can't write into {out}: {error}. Is the disk full?") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write_run(source: Source, scratch: Path, about: About, hed: bool) -> None:
    """A dataset of this run alone, read back and compared sample by sample."""
    from mne_bids import BIDSPath, read_raw_bids, update_sidecar_json, write_raw_bids

    signals, rows = source.signals, source.events.rows
    written = files.write_brainvision(scratch / "written", "raw", signals, rows)
    raw = files.read_back(written)
    raw.set_annotations(None)  # the table of events tells more than markers can
    raw.set_channel_types(dict(zip(signals.names, map(str.lower, signals.kinds), strict=True)), on_unit_change="ignore")
    montage = files.places([name for name, kind in zip(signals.names, signals.kinds, strict=True) if kind == "EEG"])
    if montage is not None:
        raw.set_montage(montage, on_missing="ignore", verbose="ERROR")
    run = source.run
    place = BIDSPath(
        root=scratch / "dataset",
        subject=run.participant,
        session=run.visit,
        task=run.task,
        run=f"{run.number:03d}",
        datatype="eeg",
    )
    write_raw_bids(raw, place, readme=False, verbose="ERROR")
    shutil.rmtree(scratch / "written")
    folder, stem = _folder(source, scratch / "dataset"), _stem(source)
    _write_json(folder / f"{stem}_events.json", COLUMNS | words.presentation(source.sidecar.get("versions", {})))
    (folder / f"{stem}_events.tsv").write_text(files.events_text(rows, hed), encoding="utf-8")
    update_sidecar_json(
        place.copy().update(suffix="eeg", extension=".json"),
        words.eeg(source.told(), source.recording.eeg.name, signals.kinds.count("MISC"), source.start.task, about),
        verbose="ERROR",
    )
    _channels(source, folder / f"{stem}_channels.tsv")
    for path in folder.glob("*_coordsystem.json"):
        _write_json(path, words.places(json.loads(path.read_text(encoding="utf-8"))))
    files.check_same(read_raw_bids(place, verbose="ERROR"), signals)


def _channels(source: Source, path: Path) -> None:
    """Say of each channel what was wrong with it and for how many moves; bad are those that were for half of them."""
    moves = [row for row in source.events.rows if "action" in row]
    faults = [dict(item.split(": ", 1) for item in row["bad_channels"].split("; ") if item) for row in moves]
    columns, rows = tables.read(path)
    for row in rows:
        found = [each[row["name"]] for each in faults if row["name"] in each]
        row |= {"low_cutoff": tables.NONE, "high_cutoff": tables.NONE, "status_description": "n/a"}
        if found:
            kinds = ", ".join(sorted({kind for text in found for kind in text.split(", ")}))
            row["status_description"] = f"{kinds}; repaired in the verdicts on {len(found)} of {len(moves)} moves"
        row["status"] = "bad" if 2 * len(found) >= len(moves) > 0 else "good"
    path.write_text(tables.text(columns, rows), encoding="utf-8")


def _has_hed(out: Path) -> bool:
    path = out / "dataset_description.json"
    try:
        return "HEDVersion" in json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SetupError(f"Can't read {path}: {error}. Restore it.") from error


def _move_in(scratch: Path, out: Path, stem: str) -> None:
    """Move a run's files to their places. Those of its visit (electrodes) are merged."""
    made = scratch / "dataset"
    new = sorted(path for path in made.glob("sub-*/ses-*/eeg/*"))
    for path in new:
        target = out / path.relative_to(made)
        if target.exists() and path.name.endswith("_electrodes.tsv"):
            columns, rows = tables.read(path)
            _write(target, tables.text(*tables.merged(tables.read(target), columns, rows, "name")))
        elif target.exists() and not cmp(path, target, shallow=False):
            raise SetupError(
                f"{target} is there already and differs from what {stem} gives. Nothing is overwritten: remove or "
                "move that run's files, or export into a new folder."
            )
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)


def _into_tables(source: Source, out: Path, about: About) -> None:
    """The run's rows in the tables of the dataset and of its visit, and what their columns mean."""
    run = source.run
    who = about.participants.get(run.participant, {})
    simulated = "yes" if source.simulated else "no"
    row = {"participant_id": f"sub-{run.participant}", "simulated": simulated, **who}
    names = list(row) + [name for name in ("age", "sex", "hand") if name not in row]
    columns = _merge(out / "participants.tsv", names, row, "participant_id")
    _mixed(out / "participants.tsv", row)
    _write_missing(out / "participants.json", words.participants(columns, about))
    scan = {
        "filename": f"eeg/{_stem(source)}_eeg.vhdr",
        "acq_time": None,
        "map": source.start.map,
        "simulated": simulated,
        "ended": source.ended,
        "continues": ", ".join(source.continues),
        "lost_samples": source.n_lost,
    }
    table = _folder(source, out).parent / f"sub-{run.participant}_ses-{run.visit}_scans.tsv"
    _merge(table, list(words.SCANS), scan, "filename")
    _write_missing(out / "scans.json", words.SCANS)


def _mixed(path: Path, row: Mapping[str, Any]) -> None:
    """A participant with runs of both kinds."""
    columns, rows = tables.read(path)
    for each in rows:
        if each["participant_id"] == row["participant_id"] and each.get("simulated") not in (row["simulated"], "some"):
            each["simulated"] = "some"
            _write(path, tables.text(columns, rows))


def _merge(path: Path, columns: Sequence[str], row: Mapping[str, Any], key: str) -> list[str]:
    old = tables.read(path)
    names, rows = tables.merged(old, columns, [row], key)
    if (names, rows) != old:
        _write(path, tables.text(names, rows))
    return names


def _write_missing(path: Path, content: dict[str, Any]) -> None:
    """Describe what isn't described yet."""
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if not set(content) <= set(old):
        _write_json(path, content | old)


def _write_json(path: Path, content: Any) -> None:
    _write(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def _write(path: Path, content: str) -> None:
    whole.renew(path, content.encode())


def _copy(path: Path, target: Path) -> None:
    """A copy, unless it is there: an equal one stays, another is never overwritten."""
    if target.exists():
        if not cmp(path, target, shallow=False):
            raise SetupError(f"{target} differs from {path}. Nothing is overwritten: remove the one that is wrong.")
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    whole.copy(path, target)
