"""Files that are there whole or not at all."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from lsl_peers import until

from bci_app.whole import copy, renew, write_new

FULL = """
import resource, signal, sys
from pathlib import Path
from bci_app import whole
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))
try:
    getattr(whole, sys.argv[1])(Path(sys.argv[2]), b"x" * 100)
except OSError as error:
    print(error.strerror)
"""
SIZE = 5_000_000
WRITING = """
import sys
from pathlib import Path
from bci_app.whole import renew
while True:
    for letter in (b"a", b"b"):
        renew(Path(sys.argv[1]), letter * 5_000_000)
"""


def test_a_renewed_file_is_the_new_one_alone(tmp_path: Path) -> None:
    (tmp_path / ".file.partial").write_bytes(b"of somebody who was killed")
    for contents in (b"first", b"second"):
        renew(tmp_path / "file", contents)
        assert (tmp_path / "file").read_bytes() == contents
        assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize("links", [True, False])
def test_a_new_file_takes_nobodys_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    if not links:
        monkeypatch.setattr(os, "link", refuse)
    write_new(tmp_path / "file", b"first")
    with pytest.raises(FileExistsError):
        write_new(tmp_path / "file", b"second")
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"file": b"first"}


def test_a_name_that_was_taken_in_vain_is_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(PermissionError):
        write_new(tmp_path / "file", b"first")
    assert list(tmp_path.iterdir()) == []


def refuse(*_: object) -> None:
    """As a file system does that has no such thing."""
    raise PermissionError("not here")


def test_a_copy_is_equal_and_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"contents")
    (tmp_path / "folder").mkdir()
    copy(tmp_path / "file", tmp_path / "folder" / "copy")
    assert {each.name: each.read_bytes() for each in (tmp_path / "folder").iterdir()} == {"copy": b"contents"}
    with pytest.raises(FileNotFoundError):
        copy(tmp_path / "absent", tmp_path / "folder" / "other")
    assert [each.name for each in (tmp_path / "folder").iterdir()] == ["copy"]


@pytest.mark.skipif(sys.platform == "win32", reason="a limit to files' sizes is POSIX's")
@pytest.mark.parametrize(("how", "before"), [("renew", True), ("renew", False), ("write_new", False)])
def test_where_it_cant_be_written_all_is_as_before(tmp_path: Path, how: str, before: bool) -> None:
    path = tmp_path / "file"
    if before:
        path.write_bytes(b"old")
    found = subprocess.run([sys.executable, "-c", FULL, how, path], capture_output=True, text=True, check=True)
    assert found.stdout == "File too large\n"
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == ({"file": b"old"} if before else {})


def test_whoever_is_killed_while_writing_leaves_a_whole_file(tmp_path: Path) -> None:
    path, partial = tmp_path / "file", tmp_path / ".file.partial"
    for k in range(10):
        path.unlink(missing_ok=True)
        partial.unlink(missing_ok=True)
        writer = subprocess.Popen([sys.executable, "-c", WRITING, path])
        until(path.exists, 60, "the first file")
        until(lambda size=k * SIZE // 10: partial.exists() and size_of(partial) >= size, 60, "the next to be written")
        writer.kill()
        writer.wait()
        assert path.read_bytes() in (b"a" * SIZE, b"b" * SIZE)


def size_of(path: Path) -> int:
    """Of a file that may just have got another name."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0
