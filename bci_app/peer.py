"""A process of the loop as the others see it: its own message stream, its heartbeat, and when it must stop."""

import logging
import math
import os
import time
from collections.abc import Callable, Sequence
from typing import Literal

from bci_app.clock import Clock
from bci_app.errors import LinkLost
from bci_app.lsl import Identity, MessageInlet, MessageOutlet, Received, local_clock
from bci_app.protocol import SESSION, Message, Note, Recall, Returned, Role, Status, StreamSpec

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5
"""Real seconds between two `Status` messages of an unchanged state."""
POLL_S = 0.01
"""Real seconds between two rounds while lingering."""
LINGER_S = 2.0
"""Real seconds a process without a parent stays after its last message, so that every listener gets it."""
State = Literal["waiting", "ready", "running", "done", "failed"]


class Peer:
    """Owns the process's message stream. Every loop of a process calls `say` once a round.

    Parameters
    ----------
    spec : the stream this process publishes on.
    role : what it is.
    session, clock : of the run it belongs to.
    parent : process id of the program that started it; when that is gone, so is the reason to go on.
    """

    def __init__(self, spec: StreamSpec, role: Role, session: str, clock: Clock, parent: int | None = None) -> None:
        self.session = session
        self.clock = clock
        self._role: Role = role
        self._parent = parent
        self._outlet = MessageOutlet(spec, session, clock)
        self._said: tuple[State, str] | None = None
        self._said_at = 0.0
        self._hears: dict[str, float] = {}

    @property
    def identity(self) -> Identity:
        """What tells its stream from another one with the same source id."""
        return self._outlet.identity

    def close(self) -> None:
        """Take the stream off the network."""
        self._outlet.close()

    def push(self, message: Message, stamp: float | None = None) -> None:
        """Publish a message; its stamp is now unless given (session seconds)."""
        self._outlet.push(message, self.clock.now() if stamp is None else stamp)

    def say(self, state: State, text: str = "") -> None:
        """Tell the others how this process is doing and whom it hears; repeated every `HEARTBEAT_S`."""
        # On Windows a virtual environment's python.exe is itself a parent in between, so this can't be told there.
        if self._parent is not None and os.name == "posix" and os.getppid() != self._parent:
            raise LinkLost("The program that started this process is gone; nothing is left to do here.")
        now = local_clock()
        if (state, text) != self._said or now - self._said_at >= HEARTBEAT_S:
            if self._said is None or state != self._said[0]:
                log.info("%s: %s", state, text)
            self._said, self._said_at = (state, text), now
            hears = self._hears.copy()
            self.push(Status(session=self.session, role=self._role, state=state, text=text, hears=hears))

    def note(self, level: Literal["info", "warning", "error"], text: str) -> None:
        """Tell a reader of the recording, and the log, that something happened."""
        log.log(getattr(logging, level.upper()), text)
        self.push(Note(session=self.session, role=self._role, level=level, text=text))

    def wait_for(self, spec: StreamSpec) -> MessageInlet:
        """Connect to another process's stream, waiting as long as it takes and saying so."""
        while True:
            self.say("waiting", f"for the {spec.role}'s stream '{spec.name}' of session '{self.session}'")
            try:
                inlet = MessageInlet.find(spec, self.session, timeout=HEARTBEAT_S)
            except LinkLost as error:  # it died between being found and answering: it may be started again
                log.info("%s", error)
                continue
            if inlet is not None:
                return inlet

    def remember(self) -> Recall:
        """What was said before this process was started again, from bci-app. It must hear all others by now."""
        session = self.wait_for(SESSION)
        asked_at = -math.inf
        while True:
            self.say("waiting", "for what was said so far")
            if local_clock() - asked_at >= HEARTBEAT_S:
                asked_at = local_clock()
                self.push(Returned(session=self.session, role=self._role))
            for item in self.hear(session, timeout=POLL_S):
                match item.message:
                    case Recall(role=self._role) as recall:
                        return recall

    def hear(self, inlet: MessageInlet, timeout: float = 0.0) -> Sequence[Received]:
        """Pull messages; samples that are none of this session's are refused in a note, never mixed in."""
        received = inlet.pull(timeout)
        if received:
            # What is said once more has the stamp it had.
            newest = max(item.stamp for item in received)
            self._hears[inlet.name] = max(newest, self._hears.get(inlet.name, newest))
        for sentence in inlet.refused:
            self.note("error", f"Refused a sample on {sentence}")
        inlet.refused.clear()
        return received

    def rest(self, seconds: float) -> None:
        """Let `seconds` of real time pass: how long a round of a process's loop may take at most."""
        time.sleep(max(0.0, seconds))

    def linger(self, work: Callable[[], None] | None = None) -> None:
        """Stay after the last message, doing `work`: until the parent says so, or long enough for every listener."""
        started = local_clock()
        try:
            while self._parent is not None or local_clock() - started < LINGER_S:
                self.say("done")
                if work is not None:
                    work()
                self.rest(POLL_S)
        except KeyboardInterrupt:
            log.info("Told to end.")
