"""Tests isolate themselves on LSL: machine scope, a session id of their own, this computer asked directly."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

_LSL = f"""
[lab]
SessionID = errp-bci-tests-{os.getpid()}
KnownPeers = {{127.0.0.1}}
[multicast]
ResolveScope = machine
[tuning]
MulticastMinRTT = 0.02
MulticastMaxRTT = 0.1
[log]
level = -2
"""
_folder = tempfile.TemporaryDirectory()
_file = Path(_folder.name) / "lsl_api.cfg"
_file.write_text(_LSL, encoding="utf-8")
os.environ["LSLAPICFG"] = str(_file)  # before liblsl's first call, and inherited by every process a test starts
os.environ["SDL_VIDEODRIVER"] = "dummy"

import bci_app.threads  # noqa: E402, F401

DATA = Path(os.environ.get("BCI_APP_DATA", Path(__file__).parents[2] / "shared" / "data"))
Cli = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of real recordings; the test skips where it is absent."""
    if not DATA.exists():
        pytest.skip(f"real recordings are not at {DATA} (set BCI_APP_DATA)")
    return DATA


@pytest.fixture(scope="session")
def cli() -> Cli:
    """Run `bci-app` as a user does; returns the finished process."""

    def run(*words: object, timeout: float = 200.0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "bci_app", *map(str, words)],
            capture_output=True,
            text=True,
            timeout=timeout,
            cwd=cwd,
            check=False,
        )

    return run
