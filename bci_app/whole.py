"""Files that are there whole or not at all, whatever dies while they are written.

Where a file system has no links (FAT), whoever is killed at the wrong moment leaves a new file's name empty.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path


def write_new(path: Path, contents: bytes, partial: Path | None = None) -> None:
    """Write a file; FileExistsError when there is one by now, other OSErrors when it can't be.

    Parameters
    ----------
    partial : where it is written first, on the same disk: beside it unless told, where what a writer left that was
        killed is taken over. Several that may write the same file at once need one each.
    """
    partial = partial or path.with_name(f"{path.name}.partial")
    try:
        _to_the_disk(partial, contents)
        try:
            os.link(partial, path)  # unlike a renamed file it never takes another one's place
        except FileExistsError:
            raise
        except OSError:  # a file system without links: take the name first, then replace our own empty file
            path.open("xb").close()
            try:
                partial.replace(path)
            except OSError:
                with suppress(OSError):  # the first error says more
                    path.unlink()
                raise
    finally:
        partial.unlink(missing_ok=True)


def renew(path: Path, contents: bytes) -> None:
    """Write a file or put another in its place: a crash or a power cut leaves the old one or the new one. OSError when
    it can't be, and then the old one stays. A file has one writer at a time.

    What a writer left that was killed is hidden, so that nobody takes it for a file of the folder, and taken over.
    """
    partial = _partial_of(path)
    try:
        _to_the_disk(partial, contents)
        partial.replace(path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def copy(source: Path, target: Path) -> None:
    """As `renew`, but with what another file holds; for recordings, which are large."""
    partial = _partial_of(target)
    try:
        shutil.copyfile(source, partial)
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(target)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def _partial_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.partial")


def _to_the_disk(path: Path, contents: bytes) -> None:
    """Written and not only about to be: else a name may outlive a power cut without what it is the name of."""
    with path.open("wb") as file:
        file.write(contents)
        file.flush()
        os.fsync(file.fileno())
