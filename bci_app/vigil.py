"""Watches over a recording while it is written: that its recorder lives, the file grows, and the disk has room."""

from shutil import disk_usage

from bci_app.recorder import Recorder

GROW_TIMEOUT_S = 2.0
"""Real seconds after which a file that doesn't grow is not being written: LabRecorder writes twice a second."""
DISK_S, DISK_LEAST_S, DISK_LEAST_BYTES = 1.0, 20.0, 4_000_000
"""Real seconds between two looks at the disk; of recording, and bytes, for which there must be room: until the next
rest and the file's end it takes less (decided)."""


class Vigil:
    """One recording, begun at real time `began`."""

    def __init__(self, recorder: Recorder, began: float) -> None:
        self._recorder, self._path = recorder, recorder.path
        self._began = self._grew_at = self._looked_at = began
        self._size = 0

    def lost(self, n_bytes: int, now: float, may_stand: bool) -> str | None:
        """Why the run can't go on, in a sentence; None while all is well.

        Parameters
        ----------
        n_bytes : size of the file.
        now : real time, s.
        may_stand : whether there is nothing to write at present.
        """
        if not self._recorder.alive:
            return f"LabRecorder died; {self._path} holds what it had written until then."
        if n_bytes > self._size or may_stand:
            self._size, self._grew_at = n_bytes, now
        if now - self._grew_at > GROW_TIMEOUT_S:
            self._recorder.kill()  # it hangs, and would hang when it is told to close the file
            return f"{self._path} has stopped growing at {n_bytes} bytes: the disk is full or LabRecorder hangs."
        if now - self._looked_at < DISK_S:
            return None
        self._looked_at = now
        a_second = n_bytes / max(1.0, now - self._began)
        try:
            free = disk_usage(self._path.parent).free
        except OSError as error:
            return f"The folder of {self._path} is gone ({error.strerror}). Look at the disk."
        if free < max(DISK_LEAST_BYTES, a_second * DISK_LEAST_S):
            return f"Only {free / 1e6:.0f} MB are left on the disk of {self._path}. Free some; then --resume."
        return None
