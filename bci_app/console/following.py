"""One session that is followed: its streams as they come, what is heard of them, and the console's own stream."""

import logging
from collections.abc import Mapping
from threading import Lock
from typing import Any

from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.console.state import State
from bci_app.errors import LinkLost, SetupError
from bci_app.lsl import EegInfo, EegInlet, MessageInlet, NoStream, find_eeg, local_clock
from bci_app.peer import Peer
from bci_app.protocol import (
    ACTIONS_STREAM,
    AMPLIFIER_NOTES,
    CONSOLE,
    SESSION,
    STIMULUS,
    TRUTH,
    VERDICTS,
    Recall,
    Returned,
    Status,
    StreamSpec,
    simulated_source_id,
)

log = logging.getLogger(__name__)

EEG_BUFFER_S = 120.0
"""Session seconds of EEG that LSL keeps for a console that is held up, at 20 times real speed for 6 s; what is older is
lost to it alone."""
FIND_EEG_S = 0.5
"""Real seconds a look for the amplifier may take."""
ASK_AGAIN_S, ASK_FOR_S = 0.5, 10.0
"""Real seconds after which it is asked again what was said before, and in all."""
TAIL_S = 1.0
"""Real seconds after a run's last message in which its streams are still heard; its processes stay a little longer."""
SPEAKS = (SESSION, STIMULUS, VERDICTS, ACTIONS_STREAM, AMPLIFIER_NOTES)
"""Streams on which something is said twice a second."""


class Following:
    """Follows one session. One thread calls `open`, `hear` and `say`; the state changes only under the lock.

    Parameters
    ----------
    config, parent : as of the console's `Listener`.
    session, clock : its id and its clock, as this computer's own messages are stamped.
    theirs : its clock as the messages are stamped that are heard: of the computer that leads it.
    lock : held while the state is changed.
    """

    def __init__(
        self, config: Config, session: str, clock: Clock, theirs: Clock, lock: Lock, parent: int | None
    ) -> None:
        self.session = session
        self.state = State(session, config, clock.speed)
        self.peer = Peer(CONSOLE, "console", session, clock, parent)
        self._config, self._clock, self._lock = config, theirs, lock
        self._inlets: dict[str, MessageInlet] = {}
        self._eeg: EegInlet | None = None
        self._wants_eeg = True
        self._recall_until = -1.0  # real time; before 0 while it isn't known whether anything was missed
        self._asked_at = 0.0
        self._over_at: float | None = None  # real time at which all was said

    @property
    def source_id(self) -> str:
        """Of the console's own stream."""
        return CONSOLE.source_id(self.session)

    def snapshot(self) -> dict[str, Any]:
        """What the page shows; the lock must be held."""
        return self.state.snapshot(local_clock(), self._clock.now())

    def is_gone(self, found: Mapping[str, EegInfo]) -> bool:
        """Whether nobody of the session is on the network any more, or it said that it is over."""
        alive = any(spec.source_id(self.session) in found for spec in (SESSION, STIMULUS))
        return self.state.course.end is not None or not alive

    def open(self, found: Mapping[str, EegInfo]) -> None:
        """Open the streams that are on the network by now and aren't heard yet, until all was said."""
        if self._over_at is not None:
            return
        for spec in (*SPEAKS, TRUTH):
            info = found.get(spec.source_id(self.session))
            if spec.name not in self._inlets and info is not None:
                self._open(spec, info)
        if self._eeg is None and self._wants_eeg and VERDICTS.name in self._inlets:
            self._open_eeg(found.get(simulated_source_id(self.session)))

    def _open(self, spec: StreamSpec, info: EegInfo) -> None:
        try:
            self._inlets[spec.name] = MessageInlet(info, spec, self.session)
        except LinkLost as error:  # its sender has just died; the next look finds the next
            log.info("%s", error)
            return
        with self._lock:
            self.state.links.opened(spec.name, local_clock(), spec in SPEAKS)

    def _open_eeg(self, simulated: EegInfo | None) -> None:
        try:
            eeg = EegInlet(simulated or find_eeg(self._config.eeg, FIND_EEG_S), EEG_BUFFER_S)
            with self._lock:
                self.state.begin_eeg(eeg.description, local_clock())
        except (NoStream, LinkLost) as error:
            log.info("%s", error)
        except SetupError as error:
            self._wants_eeg = False
            with self._lock:
                self.state.log(self._clock.now(), "console", "warning", f"The EEG isn't shown: {error}")
        else:
            self._eeg = eeg

    def hear(self) -> None:
        """Take in all that came since."""
        for name, inlet in self._inlets.items():
            received = inlet.pull()
            with self._lock:
                for item in received:
                    self.state.take(name, item.stamp, item.message, item.arrived)
                    self._look_for_past(item.message, item.arrived)
                for sentence in inlet.refused:
                    self.state.log(self._clock.now(), "console", "warning", f"Refused a sample on {sentence}")
            inlet.refused.clear()
        if self.state.is_over:
            self._over_at = self._over_at or local_clock()
            if local_clock() - self._over_at > TAIL_S:
                self._inlets.clear()
                self._eeg = None
        if self._eeg is not None:
            samples, stamps = self._eeg.pull(0.0)
            with self._lock:
                self.state.take_eeg(samples, stamps, local_clock())

    def look_at_electrodes(self) -> None:
        """Measure the electrodes' amplitudes."""
        with self._lock:
            self.state.look_at_electrodes()

    def _look_for_past(self, message: object, now: float) -> None:
        """bci-app's first word tells whether the run has begun without us: then what we missed is asked for."""
        match message:
            case Status(role="session") as status if self._recall_until < 0:
                self._recall_until = now + ASK_FOR_S if status.state == "running" else 0.0
            case Recall(role="console"):
                self._recall_until = 0.0

    def say(self) -> None:
        """Tell that this console is there, and ask for what it missed."""
        self.peer.say("ready")
        now = local_clock()
        if now < self._recall_until and now - self._asked_at >= ASK_AGAIN_S:
            self._asked_at = now
            self.peer.push(Returned(session=self.session, role="console"))
