"""Which processes of a run are well: who hangs, who failed too often, and what the stimulus must wait for.

Pure: what was heard, and when, is handed in. Real times are seconds of LSL's clock, stamps session seconds.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bci_app.protocol import (
    ACTIONS_STREAM,
    STIMULUS,
    STREAMS,
    TRUTH,
    VERDICTS,
    Role,
    Status,
    StreamSpec,
)

HANGS_S = 5.0
"""Real seconds without a word, from a process that speaks twice a second, after which it hangs (decided)."""
STARTING_S = 60.0
"""Real seconds a process that was started again may take to its first word (decided; the slowest loads torch)."""
MOST_FAILURES, WITHIN_S = 3, 60.0
"""Failures of all processes, and real seconds, after which starting them again is no help (decided)."""
LISTENS: dict[Role, tuple[StreamSpec, ...]] = {
    "decoder": (STIMULUS,),
    "policy": (STIMULUS, VERDICTS),
    "amplifier": (STIMULUS, TRUTH),
    "stimulus": (ACTIONS_STREAM,),
}
"""Which streams each process must hear for the run to go on, of those that are there. In a calibration the stimulus
hears verdicts instead of actions."""


@dataclass
class _Known:
    """What is known of one process."""

    status: Status | None = None
    spoke_at: float = 0.0
    may_be_silent_until: float = 0.0
    returned: float = float("-inf")  # stamp at which it was started again


@dataclass
class Wellness:
    """Follows the processes of one run.

    Attributes
    ----------
    roles : the processes that take part.
    is_calibration : whether the stimulus hears the decoder instead of a policy.
    """

    roles: Sequence[Role]
    is_calibration: bool
    _known: dict[Role, _Known] = field(default_factory=dict)
    _failures: deque[float] = field(default_factory=deque)
    _tell: set[Role] = field(default_factory=set)  # who tells what they hear: programs of other people needn't

    def __post_init__(self) -> None:
        self._known = {role: _Known(spoke_at=float("inf")) for role in self.roles}  # none is late before its first word

    def take(self, role: Role, stamp: float, status: Status | None, now: float) -> None:
        """A word of a process, heard at real time `now`; its status, if it was one."""
        known = self._known[role]
        if stamp < known.returned:  # of the process before
            return
        known.spoke_at = now
        if status is not None:
            known.status = status
            if status.hears:
                self._tell.add(role)
            if status.state != "waiting":  # what it loads and looks for may take a while without a word
                known.may_be_silent_until = 0.0

    def failed(self, role: Role, now: float, stamp: float) -> bool:
        """A process has failed and is started again at real time `now`; False where that is of no use any more."""
        while self._failures and now - self._failures[0] > WITHIN_S:
            self._failures.popleft()
        self._failures.append(now)
        self._known[role] = _Known(may_be_silent_until=now + STARTING_S, spoke_at=now, returned=stamp)
        return len(self._failures) < MOST_FAILURES

    def hanging(self, now: float) -> list[Role]:
        """Processes that have spoken, or should have, and are silent."""
        return [
            role
            for role, known in self._known.items()
            if now - known.spoke_at > HANGS_S and now > known.may_be_silent_until
        ]

    def is_back(self, role: Role) -> bool:
        """Whether a process that was started again has spoken."""
        return self._known[role].status is not None

    def lacks_eeg(self) -> bool:
        """Whether the decoder waits for EEG, or the amplifier's process is being started again."""
        if "amplifier" in self.roles and self._known["amplifier"].status is None:
            return True
        decoder = self._known["decoder"].status
        return decoder is None or decoder.state == "waiting"

    def hear_again(self, role: Role) -> bool:
        """Whether everybody who must hear a process that was started again hears the stream on which it speaks."""
        names = {spec.name for spec in STREAMS if spec.role == role and spec.kind == "Events"}
        return not any(
            name in names
            for other in self.roles
            if other != role and (status := self._known[other].status) is not None
            for name in self._unheard(other, status)
        )

    def deaf(self, newest: Mapping[Role, float], stale: float) -> list[str]:
        """Who has lost a stream, in sentences: whose newest word heard there is `stale` session seconds older than the
        ``newest`` that bci-app heard of its sender."""
        found = []
        for role in self.roles:
            status = self._known[role].status
            if status is None or role not in self._tell:
                continue
            found += [
                f"The {role} has lost {spec.name}."
                for spec in self._listens(role)
                if spec.kind == "Events"
                and spec.role in newest
                and newest[spec.role] - status.hears.get(spec.name, float("-inf")) > stale
            ]
        return found

    def troubles(self, has_begun: bool = True) -> list[str]:
        """Why the stimulus must wait, in sentences; none where all is well. Before the run has begun nobody can know
        who hears the truth, for it isn't told yet."""
        found = []
        for role in self.roles:
            status = self._known[role].status
            if status is None:
                found.append(f"The {role} is being started again.")
            elif role != "stimulus" and status.state not in ("ready", "running", "done"):
                found.append(f"The {role} waits {status.text}.")
            else:
                found += [f"The {role} doesn't hear {name} yet." for name in self._unheard(role, status, has_begun)]
        return found

    def _listens(self, role: Role) -> tuple[StreamSpec, ...]:
        return (VERDICTS,) if role == "stimulus" and self.is_calibration else LISTENS.get(role, ())

    def _unheard(self, role: Role, status: Status, has_begun: bool = True) -> list[str]:
        """Streams of processes that were started again and aren't heard by this one yet."""
        return [
            spec.name
            for spec in self._listens(role)
            if spec.role in self.roles
            and (has_begun or spec.kind == "Events")
            and status.hears.get(spec.name, float("-inf")) < self._known[spec.role].returned
        ]
