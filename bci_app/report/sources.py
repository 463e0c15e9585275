"""Which recordings a report is about: found, told apart by participant and visit, runs that go on put together."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bci_app.errors import SetupError
from bci_app.runs import read_sidecar

NAME = re.compile(r"sub-(?P<participant>[A-Za-z0-9]+)_ses-(?P<visit>[A-Za-z0-9]+)_task-(?P<task>[A-Za-z0-9]+)")
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Source:
    """A recording's file, and what is known of it before it is read: from its sidecar, else from its name."""

    path: Path
    sidecar: dict[str, Any]
    participant: str
    visit: str

    @property
    def before(self) -> list[str]:
        """Names of the recordings that it goes on from."""
        return [str(name) for name in self.sidecar.get("continues") or []]


@dataclass(frozen=True)
class Visit:
    """One participant's session: its runs, each of one recording or of those that go on from each other."""

    participant: str
    visit: str
    runs: tuple[tuple[Source, ...], ...]


def find(paths: Sequence[Path]) -> list[Path]:
    """The recordings named, and those in the folders named, sorted, each once.

    Raises SetupError where there is nothing of the name, or no recording in a folder.
    """
    found: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            inside = sorted(path.rglob("*.xdf"))
            if not inside:
                raise SetupError(f"The folder {path} holds no recording (.xdf). Name recordings or another folder.")
            found |= dict.fromkeys(each.absolute() for each in inside)
        elif path.exists():
            found[path.absolute()] = None
        else:
            raise SetupError(f"There is no recording {path}. Name a recording (.xdf) or a folder that holds some.")
    return sorted(found)


def source(path: Path) -> Source:
    """What is known of a recording before it is read. Raises SetupError for a sidecar that can't be read."""
    sidecar = read_sidecar(path)
    named = NAME.match(path.name)
    participant = sidecar.get("participant") or (named["participant"] if named else UNKNOWN)
    return Source(path, sidecar, str(participant), named["visit"] if named else UNKNOWN)


def visits(sources: Sequence[Source]) -> list[Visit]:
    """Put together by participant and visit, in the order of their names."""
    groups: dict[tuple[str, str], list[Source]] = {}
    for each in sources:
        groups.setdefault((each.participant, each.visit), []).append(each)
    return [Visit(*key, tuple(_runs(group))) for key, group in sorted(groups.items())]


def _runs(sources: list[Source]) -> Iterator[tuple[Source, ...]]:
    """Runs that go on from each other come together, in the order in which they were made."""
    chains: dict[str, list[Source]] = {}
    for each in sorted(sources, key=lambda item: (len(item.before), item.path.name)):
        first = each.before[0] if each.before else each.path.name
        chains.setdefault(first, []).append(each)
    for chain in sorted(chains.values(), key=lambda items: items[0].path.name):
        yield tuple(chain)


def missing(run: Sequence[Source]) -> list[str]:
    """Recordings that these go on from, and that aren't among them: names."""
    given = {each.path.name for each in run}
    return [name for name in dict.fromkeys(name for each in run for name in each.before) if name not in given]


def folder_of(paths: Sequence[Path], sources: Sequence[Visit]) -> Path:
    """Where a report goes: beside a visit's `eeg` folder, or into the folder that all recordings have in common."""
    parents = [path.parent for path in paths]
    common = parents[0]
    while not all(parent.is_relative_to(common) for parent in parents):
        common = common.parent
    return common.parent if len(sources) == 1 and common.name == "eeg" else common


def free_folder(folder: Path) -> Path:
    """``report`` in a folder, numbered from the second on: nothing is overwritten."""
    number, path = 1, folder / "report"
    while path.exists():
        number += 1
        path = folder / f"report-{number}"
    return path
