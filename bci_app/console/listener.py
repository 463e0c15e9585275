"""Listens to sessions as the recorder does, one after the other, and says what is asked for at the page.

Only a reader: nobody in the loop waits for it, and where it falls behind, hangs or dies, nobody notices.
"""

import logging
import os
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.console.following import Following
from bci_app.console.state import warm_up
from bci_app.errors import LinkLost, SetupError
from bci_app.lsl import EegInfo, Header, MessageInlet, Watch, local_clock, session_clock
from bci_app.protocol import CONSOLE, SESSION, STIMULUS, Message, StreamSpec

log = logging.getLogger(__name__)

POLL_S = 0.02
"""Real seconds between two looks at the streams: the page is drawn five times a second."""
LOOK_EVERY_S = 1.0
"""Real seconds between two looks at the network, and at the electrodes."""
LOOKS = 2
"""In so many looks one after the other a session must be there, so that a second one isn't missed (decided)."""


class Listener:
    """Runs in a thread of its own.

    Parameters
    ----------
    config : how to find the EEG, and the chain its averages go through.
    session : the one to follow; any if None.
    parent : process that started this one: only its sessions are followed, and this ends with it.
    """

    def __init__(self, config: Config, session: str | None = None, parent: int | None = None) -> None:
        self._config, self._wanted, self._parent = config, session, parent
        self._watch = Watch()
        self._asked: queue.SimpleQueue[Callable[[str], Message]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._following: Following | None = None
        self._headers: dict[str, Header] = {}
        self._apart: dict[str, float] = {}  # seconds by which this computer's clock is ahead of the session's
        self._candidates: list[set[str]] = []  # of the last looks
        self._followed: set[str] = set()
        self._waits_for = f"session {session}" if session else "a session to begin"
        self.ended = threading.Event()
        self.failure: Exception | None = None
        """Why it ended, if not because it was told to."""

    # What the page asks; from another thread.

    def snapshot(self) -> dict[str, Any]:
        """What is known by now: the sections of `State.snapshot`, or only `session` while there is none."""
        with self._lock:
            if self._following is None:
                return {"session": {"phase": "looking", "waits_for": self._waits_for, "can": {}}}
            return self._following.snapshot()

    def average(self, channel: str) -> dict[str, Any]:
        """The averages at a channel. Raises KeyError for one that isn't there."""
        with self._lock:
            if self._following is None or self._following.state.averages is None:
                raise KeyError(channel)
            return self._following.state.averages.at(channel)

    def ask(self, make: Callable[[str], Message]) -> None:
        """Ask bci-app for something; ``make`` makes the message of a session. SetupError where nobody follows."""
        with self._lock:
            state = self._following.state if self._following else None
            if state is None or not state.is_led or state.course.end is not None:
                raise SetupError("No session led by bci-app is running: nobody would follow.")
        self._asked.put(make)

    # The thread.

    def run(self) -> None:
        """Listen until told to end; what goes wrong is kept in `failure`."""
        looked_at = -LOOK_EVERY_S
        try:
            warm_up(self._config)
            while not self.ended.wait(POLL_S):
                if self._parent is not None and os.name == "posix" and os.getppid() != self._parent:
                    raise LinkLost("The program that started this console is gone.")
                if local_clock() - looked_at >= LOOK_EVERY_S:
                    looked_at = local_clock()
                    self._look()
                if self._following is not None:
                    self._speak(self._following)
                    self._following.hear()
        except Exception as error:  # noqa: BLE001 (raised again by who waits for the end)
            self.failure = error
        finally:
            self.ended.set()

    def _look(self) -> None:
        """Find a session to follow, and the streams of the one that is followed that have come since."""
        found = self._watch.found()
        following = self._following
        if following is None or following.is_gone(found):
            session = self._next(self._sessions(found), following)
            if session is not None:
                following = self._follow(session, found)
        if following is not None:
            # Two that were started at the same moment don't see each other before both are there: the older stays.
            mine = following.peer.identity
            others = self._watch.identities(following.source_id)
            if any(other < mine for other in others if other.uid != mine.uid):
                raise _second(following.session)
            following.open(found)
            following.look_at_electrodes()

    def _follow(self, session: str, found: Mapping[str, EegInfo]) -> Following | None:
        if CONSOLE.source_id(session) in found:
            raise _second(session)
        header = self._header(session, found)
        if header is None:
            return self._following
        clock, apart = session_clock(header.speed, header.origin), self._apart[session]
        theirs = Clock(lambda: local_clock() - apart, header.speed, header.origin)
        following = Following(self._config, session, clock, theirs, self._lock, self._parent)
        self._followed.add(session)
        with self._lock:
            self._following = following
        return following

    def _sessions(self, found: Mapping[str, EegInfo]) -> set[str]:
        """Those on the network that may be followed: the one wanted, of this parent, or any."""
        ids = {
            source_id.removeprefix(f"{StreamSpec.PREFIX}/").removesuffix(f"/{spec.name}")
            for spec in (STIMULUS, SESSION)
            for source_id in found
            if source_id.endswith(f"/{spec.name}")
        }
        if self._wanted is not None:
            return ids & {self._wanted}
        if self._parent is None:
            return ids
        headers = {session: self._header(session, found) for session in ids if SESSION.source_id(session) in found}
        return {session for session, header in headers.items() if header and header.process == self._parent}

    def _header(self, session: str, found: Mapping[str, EegInfo]) -> Header | None:
        """Of bci-app's stream if it leads, else of the stimulus's; None where it doesn't answer."""
        spec = SESSION if SESSION.source_id(session) in found else STIMULUS
        info = found.get(spec.source_id(session))
        if info is not None and session not in self._headers:
            try:
                inlet = MessageInlet(info, spec, session)
                self._apart[session], self._headers[session] = inlet.clock_correction(), inlet.header()
            except LinkLost as error:
                log.info("%s", error)
        return self._headers.get(session)

    def _next(self, candidates: set[str], before: Following | None) -> str | None:
        """The session to follow next, once it is clear which. Raises SetupError where several run from the start."""
        candidates = candidates - self._followed
        self._candidates = [*self._candidates[-LOOKS + 1 :], candidates]
        steady = set.intersection(*self._candidates) if len(self._candidates) == LOOKS else set()
        if len(steady) > 1:
            text = f"{len(steady)} sessions are running: {', '.join(sorted(steady))}. Name one with --session."
            if before is None:
                raise SetupError(text)
            log.warning(text)
            return None
        return next(iter(steady), None)

    def _speak(self, following: Following) -> None:
        while not self._asked.empty():
            following.peer.push(self._asked.get()(following.session))
        following.say()


def _second(session: str) -> SetupError:
    return SetupError(
        f"Session {session} has a console already. Open its page, at the address that was printed when it was "
        "started, or end it first."
    )
