"""After each block of a calibration: how good the decoder is by now, and what more blocks would make of it.

Looked at is the recording that is being written, in a thread: the loop and the conductor go on meanwhile.
"""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from bci_app.config import Config

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Seen:
    """What was found: a sentence, a few words of it for a progress line, and whether no more blocks are needed."""

    sentence: str
    short: str
    is_clear: bool = False


Look = Callable[[Sequence[Path], Config], Seen]
"""Looks at the runs of a calibration, of which the last is still being recorded."""


class Lookout:
    """Looks at one calibration, one look at a time."""

    def __init__(self, look: Look, paths: Sequence[Path], config: Config) -> None:
        self._look_at, self._paths, self._config = look, paths, config
        self._thread = ThreadPoolExecutor(1, "lookout")
        self._look: Future[Seen] | None = None

    def begin(self) -> bool:
        """Look now; False where a look is under way."""
        if self._look is not None:
            return False
        self._look = self._thread.submit(self._look_at, self._paths, self._config)
        return True

    def take(self) -> Seen | None:
        """What the last look found, once, when it is over. One that failed says so: a run doesn't end by that."""
        if self._look is None or not self._look.done():
            return None
        look, self._look = self._look, None
        error = look.exception()
        if error is None:
            return look.result()
        log.error("The calibration so far can't be looked at.", exc_info=error)
        return Seen(f"What the calibration is worth so far can't be told: {error}", "")

    def close(self) -> None:
        """Nobody waits for a look under way any more."""
        self._thread.shutdown(wait=False, cancel_futures=True)
