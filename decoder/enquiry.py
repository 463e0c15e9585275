"""A question to a stream that takes a while: a thread asks it, so that samples are pulled and judged meanwhile."""

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import Generic, TypeVar

Answer = TypeVar("Answer")


class Enquiry(Generic[Answer]):
    """One question, asked again and again, one at a time.

    Parameters
    ----------
    ask : blocks until it has the answer; runs in a thread of its own, for which the process's end doesn't wait.
    """

    def __init__(self, ask: Callable[[], Answer]) -> None:
        self._ask = ask
        self._asked: tuple[int, Future[Answer]] | None = None

    def begin(self, circumstances: int) -> None:
        """Ask, unless that is being done already; what is found holds as long as the circumstances are the same."""
        if self._asked is None or self._asked[0] != circumstances:
            self._asked = circumstances, Future()
            Thread(target=self._answer, args=(self._asked[1],), name="enquiry", daemon=True).start()

    def _answer(self, asked: Future[Answer]) -> None:
        try:
            asked.set_result(self._ask())
        except Exception as error:  # noqa: BLE001 (raised again by `take`)
            asked.set_exception(error)

    def take(self, circumstances: int) -> Answer | None:
        """The answer, once; None while there is none. Raises what asking raised.

        What was asked under other circumstances is worth nothing, whether it is an answer or an exception.
        """
        if self._asked is None or not self._asked[1].done():
            return None
        (before, found), self._asked = self._asked, None
        return found.result() if before == circumstances else None
