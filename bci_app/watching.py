"""How far jobs are that other processes do: each leaves notes in a folder, and whoever waits for them reads these."""

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

POLL_S = 0.5
"""Real seconds between two looks at the notes (decided)."""
NEARLY = 0.99
"""The most a note says: a job is done once what it made is kept."""

Tell = Callable[[Sequence[float]], None]
"""Called with the share, 0 to 1, that is done of each job."""


def note(folder: Path, number: int, done: int, of: int) -> None:
    """In a job's process: so much of it is done.

    Windows replaces no file that is being read, and the folder goes when the one who waits is interrupted. The next
    note will do: nothing that is only shown may stop the work.
    """
    partial = folder / f"{number}.partial"
    with suppress(OSError):
        partial.write_text(f"{done} {of}", encoding="ascii")
        partial.replace(folder / str(number))


class Watch:
    """Tells how far all jobs are, until it is left.

    Parameters
    ----------
    folder : of the notes. A cluster's machines may not reach it: then only finished jobs count.
    shares : what is done already of each job, numbered from 0.
    """

    def __init__(self, folder: Path, shares: Sequence[float], tell: Tell) -> None:
        self._folder, self._tell = folder, tell
        self._shares = list(shares)
        self._changing = threading.Lock()
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Self:
        self._tell(self._shares)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join()
        self._tell(self._shares)

    def finished(self, number: int) -> None:
        """What a job made is kept."""
        self._goes_on(number, 1.0)

    def _goes_on(self, number: int, share: float) -> None:
        """Never back: a note may be read while its job is finished."""
        with self._changing:
            self._shares[number] = max(self._shares[number], share)

    def _look(self) -> None:
        while not self._left.wait(POLL_S):
            for number in range(len(self._shares)):
                self._goes_on(number, self._noted(number))
            self._tell(self._shares)

    def _noted(self, number: int) -> float:
        try:
            done, of = (self._folder / str(number)).read_text(encoding="ascii").split()
        except OSError:  # none yet, or Windows is just replacing it: the next look will do
            return 0.0
        return min(int(done) / int(of), NEARLY)
