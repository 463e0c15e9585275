"""Keeps a run going: starts again what dies, tells it what it missed, and has the stimulus wait meanwhile."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from bci_app.attention import Attention
from bci_app.clock import Clock
from bci_app.crew import Crew
from bci_app.errors import LinkLost
from bci_app.heard import Heard
from bci_app.lsl import Received, local_clock
from bci_app.peer import Peer
from bci_app.protocol import (
    ACTIONS_STREAM,
    AMPLIFIER_NOTES,
    STIMULUS,
    STREAMS,
    VERDICTS,
    Command,
    Returned,
    Role,
    Status,
    StreamSpec,
)
from bci_app.said import Memory
from bci_app.wellness import HANGS_S, MOST_FAILURES, WITHIN_S, Wellness
from bci_app.xdf import Follower

STREAM_OF: dict[Role, StreamSpec] = {
    "stimulus": STIMULUS,
    "decoder": VERDICTS,
    "policy": ACTIONS_STREAM,
    "amplifier": AMPLIFIER_NOTES,
}
"""On which stream each process speaks."""
EEG_PAUSE_S = 1.2
"""Real seconds without EEG in the file that are no accident of its writing, every half second (decided)."""
DEAF_S = 4.0
"""Real seconds by which what a process hears may be older than what bci-app hears: LSL reconnects in two (decided)."""
SETTLE_S = 4.0
"""Real seconds after a process was started again before the first message until the run begins: the recorder reconnects
to streams on which nothing is said yet in two (decided)."""
UNRECORDED_S = 60.0
"""Real seconds the recorder may take to find a stream again that is back (decided: LSL reconnects in two)."""
AGAIN_S = 0.5
"""Real seconds after which a command that had no effect yet is said again."""


@dataclass(frozen=True)
class Recorded:
    """The EEG stream that is recorded.

    Attributes
    ----------
    source_id, sfreq, fingerprint : of the stream; Hz.
    lead_s : session seconds of it that must be recorded, without a gap, when the stimulus goes on.
    """

    source_id: str
    sfreq: float
    fingerprint: str
    lead_s: float


class Supervisor:
    """Follows one run's messages and acts on them.

    Parameters
    ----------
    roles : the processes that take part.
    remote : those of them that were started by hand and can't be started again from here.
    arguments : the command line of each.
    peer : says what is wrong, and commands the stimulus.
    follower : tells which streams come into the recording.
    attention : how long bci-app has listened by now: what it didn't hear while it was stopped is nobody's silence.
    """

    def __init__(
        self,
        roles: Sequence[Role],
        remote: frozenset[Role],
        arguments: Callable[[Role], list[str]],
        peer: Peer,
        crew: Crew,
        heard: Heard,
        follower: Follower,
        attention: Attention,
    ) -> None:
        self._roles, self._remote, self._arguments = roles, remote, arguments
        self._peer, self._crew, self._heard, self._follower = peer, crew, heard, follower
        self._clock: Clock = peer.clock
        self._attention = attention
        self.eeg: Recorded | None = None
        """What is recorded; None until it is."""
        self._n_eeg = 0  # samples of it in the file,
        self._eeg_grew_at = 0.0  # when the last came,
        self._eeg_since = 0.0  # and when the first of them was acquired since it was away
        self._is_eeg_short = False  # in the file, before the next move
        self._wellness = Wellness(roles, "policy" not in roles)
        self.memory = Memory(peer.session)
        self._newest: dict[Role, float] = {}  # stamp of the last word of each process
        self._returned: dict[Role, float] = {}  # stamps at which processes asked what they had missed
        self._awaited: dict[str, int] = {}  # by source id: samples that must be in the file; -1 where not known yet
        self._commanded_at = 0.0
        self.mended_at = float("-inf")
        """When a process was last started again, as bci-app listens."""
        self._unrecorded_since: float | None = None
        self._is_waited_for = False
        self.waits_for: str | None = None
        """Why the stimulus must wait, in a sentence; None while it needn't."""
        self.went_on_at = 0.0
        """Real time at which the stimulus last went on after it had to wait."""

    @property
    def lacks_eeg(self) -> bool:
        """Whether there is no EEG to record at present."""
        return self._wellness.lacks_eeg()

    def take(self, role: Role, item: Received) -> None:
        """Take in a message of a process."""
        message = item.message
        self._newest[role] = item.stamp
        self._wellness.take(role, item.stamp, message if isinstance(message, Status) else None, self._attention.now())
        self.memory.take(item.stamp, message)
        if isinstance(message, Returned):
            self._returned.setdefault(message.role, item.stamp)

    def tend(self) -> None:
        """Do what is to be done now. Raises SetupError or LinkLost for what can't be mended."""
        now = self._attention.now()
        self._follow_file(now)
        for role, how in self._failures(now).items():
            self._start_again(role, how, now)
        self._answer()
        self._pause_or_resume(now)

    def _follow_file(self, now: float) -> None:
        if self.eeg is not None:
            self._follow_eeg(self.eeg, now)
            self._follow_messages()

    def _follow_eeg(self, eeg: Recorded, now: float) -> None:
        """The recorder may find a stream that was gone later than the decoder does."""
        n_new = self._follower.n_samples[eeg.source_id] - self._n_eeg
        was_away = now - self._eeg_grew_at > EEG_PAUSE_S
        if n_new:
            if was_away:  # the recorder had these before it wrote them
                self._eeg_since = now - n_new / eeg.sfreq / self._clock.speed
            self._n_eeg, self._eeg_grew_at = self._n_eeg + n_new, now
        elif was_away:
            self._is_eeg_short = True
            return
        if now - self._eeg_since > eeg.lead_s / self._clock.speed:
            self._is_eeg_short = False

    def mend(self) -> None:
        """Before the run's first message: start again what dies; there is nothing to tell it. Raises as `tend` does.

        Who is silent here may be loading.
        """
        now = self._attention.now()
        for role, how in self._crew.check(may_be_mended=not self._remote).items():
            self._start_again(role, how, now)
        self._follow_file(now)

    @property
    def may_begin(self) -> bool:
        """Whether all are ready, and what they say is recorded, some time after the last was started again."""
        is_settled = self._attention.now() - self.mended_at > SETTLE_S
        return (
            is_settled
            and self._heard.all_ready()
            and not self._wellness.troubles(has_begun=False)
            and not self._unrecorded()
        )

    def _failures(self, now: float) -> dict[Role, str]:
        """Processes that have died, or hang and have been ended, and how."""
        # What was said when is told by stamps, and those of several computers can't be compared.
        may_be_mended = not self._remote
        failed = self._crew.check(may_be_mended)
        for role in self._wellness.hanging(now):
            if not may_be_mended:
                raise LinkLost(f"No word from the {role} process for {HANGS_S:g} s: it hangs or is cut off.")
            if role not in failed and role not in self._crew.ended():
                self._crew.kill(role)
                failed[role] = f"The {role} process said nothing for {HANGS_S:g} s and was ended."
        return failed

    def _start_again(self, role: Role, how: str, now: float) -> None:
        if not self._wellness.failed(role, now, self._clock.now()):
            raise LinkLost(f"{how} That was failure {MOST_FAILURES} within {WITHIN_S:g} s; no more are mended.")
        self._note("error", f"{how} It is started again.")
        self._heard.forget(role)
        self._returned.pop(role, None)
        has_begun, self.mended_at = self._heard.start is not None, now
        if self.eeg is not None:
            # Before the first message nothing is said but on the streams of events.
            specs = [spec for spec in STREAMS if spec.role == role and (has_begun or spec.kind == "Events")]
            self._awaited |= {spec.source_id(self._peer.session): -1 for spec in specs}
        is_returning = has_begun and role != "amplifier"
        words = ["--returning"] if is_returning else []
        if role == "decoder" and self.eeg is not None:
            words += ["--eeg", self.eeg.fingerprint]  # another amplifier's may be there by now
        self._crew.start(role, [*self._arguments(role), *words])

    def _answer(self) -> None:
        """Tell those who have returned what they missed, once all that was said before they were connected is here.

        A stream's messages come in order: one that was sent after the question comes after all that was sent before.
        """
        for role, stamp in list(self._returned.items()):
            others = [other for other in self._roles if other != role and self._wellness.is_back(other)]
            is_all_here = all(self._newest.get(other, stamp) > stamp for other in others)
            # Its answer to what it is told must reach everybody, and the recording.
            is_recorded = STREAM_OF[role].source_id(self._peer.session) not in self._awaited
            # Once the run has ended the others only wait to be ended, and hear nobody.
            is_heard = self._heard.end is not None or self._wellness.hear_again(role)
            if is_all_here and is_heard and is_recorded:
                self._peer.push(self.memory.recall(role))
                del self._returned[role]

    def _pause_or_resume(self, now: float) -> None:
        """The stimulus goes on only while everybody hears everybody and all of it is recorded."""
        if self._heard.start is None or self._heard.end is not None:
            return
        deaf = self._wellness.deaf(self._newest, DEAF_S * self._clock.speed)
        troubles = self._wellness.troubles() + deaf + self._unrecorded()
        if troubles and self.waits_for is None:
            self._note("warning", f"The session waits. {troubles[0]}")
        if bool(troubles) != (self.waits_for is not None):
            self._commanded_at = 0.0
        self.waits_for = troubles[0] if troubles else None
        if troubles:
            self._is_waited_for = True
        elif self._is_waited_for and not self._heard.is_paused:
            self._is_waited_for, self.went_on_at = False, local_clock()
        is_to_go_on = self._heard.is_paused and not self._heard.is_paused_by_person
        if (troubles or is_to_go_on) and now - self._commanded_at > AGAIN_S:
            self._commanded_at = now
            command: Literal["pause", "resume"] = "pause" if troubles else "resume"
            self._peer.push(Command(session=self._peer.session, command=command, text=self.waits_for or ""))

    def _follow_messages(self) -> None:
        """Which streams of processes that were started again have come into the file."""
        found = self._follower.n_samples
        for source, n_samples in self._awaited.items():
            role = next(spec.role for spec in STREAMS if spec.source_id(self._peer.session) == source)
            if n_samples < 0 and self._wellness.is_back(role):
                self._awaited[source] = found[source] + 1  # what is written from now on is the new process's
        self._awaited = {source: n for source, n in self._awaited.items() if n < 0 or found[source] < n}

    def _unrecorded(self) -> list[str]:
        """What the recording lacks, in sentences."""
        names = [source.rsplit("/")[-1] for source in self._awaited] + (["the EEG"] if self._is_eeg_short else [])
        now = self._attention.now()
        if not names or self.lacks_eeg:
            self._unrecorded_since = None
        elif self._unrecorded_since is None:
            self._unrecorded_since = now
        elif now - self._unrecorded_since > UNRECORDED_S:
            raise LinkLost(f"The recorder hasn't found {', '.join(names)} again for {UNRECORDED_S:g} s.")
        return [f"The recorder doesn't hear {name} yet." for name in names]

    def _note(self, level: Literal["warning", "error"], text: str) -> None:
        self._peer.note(level, text)
        self._heard.notes.append(f"session: {text}")
