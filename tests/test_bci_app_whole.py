"""Files that are there whole or not at all."""

import subprocess
import sys
from pathlib import Path

import pytest
from lsl_peers import until

from bci_app.whole import renew, write_new

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


def test_a_new_file_takes_nobodys_place(tmp_path: Path) -> None:
    write_new(tmp_path / "file", b"first")
    with pytest.raises(FileExistsError):
        write_new(tmp_path / "file", b"second")
    assert (tmp_path / "file").read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


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
    path = tmp_path / "file"
    for _ in range(10):
        writer = subprocess.Popen([sys.executable, "-c", WRITING, path])
        until((tmp_path / ".file.partial").exists, 60, "it to write")
        writer.kill()
        writer.wait()
        if path.exists():
            contents = path.read_bytes()
            assert len(contents) == 5_000_000
            assert contents in (b"a" * 5_000_000, b"b" * 5_000_000)
