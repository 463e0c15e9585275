"""The processes of a run: started, watched and ended together."""

import logging
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from bci_app.errors import LinkLost, SetupError
from bci_app.protocol import Role

log = logging.getLogger(__name__)

BESIDE_TIMEOUT_S = 5.0
"""Real seconds the console may take to exit."""
END_TIMEOUT_S = 15.0
"""Real seconds a process may take to exit after it was asked to."""


class Crew:
    """The processes of a run, each in its own group so that Ctrl-C reaches only bci-app."""

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._processes: dict[Role, subprocess.Popen[bytes]] = {}
        self._files: list[IO[bytes]] = []

    def start(self, role: Role, arguments: list[str]) -> None:
        """Start a process, also one that ran before; what it logs goes to its own file."""
        path = self._logs / f"{role}.log"
        try:
            file = path.open("ab")
        except OSError as error:
            raise LinkLost(f"Can't write {path}: {error.strerror}. Is the folder gone, or the disk full?") from error
        self._files.append(file)
        self._processes[role] = subprocess.Popen(
            [sys.executable, "-m", "bci_app", role, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def check(self, may_be_mended: bool = False) -> dict[Role, str]:
        """Processes that have ended on their own, and how, where that `may_be_mended` by starting them again.

        Raises SetupError for the user's mistake, LinkLost for what can't be mended.
        """
        found: dict[Role, str] = {}
        for role, process in self._processes.items():
            code = process.poll()
            if code in (None, 0):
                continue
            failure = self._failure(role, int(code))
            if code in (SetupError.exit_code, LinkLost.exit_code) or not may_be_mended:
                raise failure
            found[role] = str(failure)
        return found

    def kill(self, role: Role) -> None:
        """End a process that doesn't listen."""
        self._processes[role].kill()
        self._processes[role].wait()

    def stop(self, role: Role) -> None:
        """Have a process hang, for a drill."""
        self._processes[role].send_signal(signal.SIGSTOP)

    def _failure(self, role: Role, code: int) -> Exception:
        path = self._logs / f"{role}.log"
        if code < 0:
            return LinkLost(f"The {role} process was killed by signal {-code} (log: {path}).")
        lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        said = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")] or lines
        last = said[-1] if said else "it said nothing"
        if code == SetupError.exit_code:
            return SetupError(last)
        return LinkLost(f"The {role} process ended with code {code}: {last} (log: {path}).")

    def ended(self) -> set[Role]:
        """Roles whose process is not running any more."""
        return {role for role, process in self._processes.items() if process.poll() is not None}

    def end(self) -> None:
        """Ask those that still run to end, then wait; kill what doesn't listen."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for role, process in self._processes.items():
            _await_end(role, process, END_TIMEOUT_S)
        for file in self._files:
            file.close()


@contextmanager
def beside(role: Role, arguments: list[str] | None) -> Iterator[None]:
    """A process that runs beside a verb, unless `arguments` are None: nobody waits for it, nobody minds its death, and
    it ends with the verb. What it says goes to stderr."""
    if arguments is None:
        yield
        return
    process = subprocess.Popen(
        [sys.executable, "-m", "bci_app", role, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=sys.__stderr__,
        start_new_session=True,
    )
    try:
        yield
    finally:
        process.terminate()
        _await_end(role, process, BESIDE_TIMEOUT_S)


def _await_end(role: Role, process: "subprocess.Popen[bytes]", seconds: float) -> None:
    """Wait for a process that was asked to end; kill it where it doesn't within so many real seconds."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        log.warning("The %s process doesn't end; killing it.", role)
        process.kill()
        process.wait()
