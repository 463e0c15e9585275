"""What bci-app heard of a run: who is ready, how far it is, how it ended. No LSL: messages are handed in."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bci_app.protocol import (
    Action,
    AnyMessage,
    BlockEnd,
    Electrodes,
    EpisodeEnd,
    MoveOnset,
    Note,
    Pause,
    Resume,
    Role,
    SessionEnd,
    SessionStart,
    Status,
    Verdict,
)
from bci_app.recording import Recording


@dataclass(frozen=True)
class Outcome:
    """How a run went, by what was heard while it ran.

    Attributes
    ----------
    recording : the XDF.
    reason, text : why it ended.
    moves, actions : how many were heard of.
    verdicts : how many of each outcome.
    notes : warnings and errors of all processes, in words.
    outlook : after each block of a calibration, what it was worth so far and what more would be.
    """

    recording: Path
    reason: Literal["complete", "interrupted", "failed"]
    text: str
    moves: int
    verdicts: dict[str, int]
    actions: int
    notes: tuple[str, ...]
    outlook: tuple[str, ...]


class Heard:
    """Takes in the messages of a run, in the order they came.

    Parameters
    ----------
    roles : the processes that take part.
    """

    def __init__(self, roles: Sequence[Role]) -> None:
        self._roles = roles
        self._states: dict[str, Status] = {}
        self._episodes = 0
        self._actions = 0
        self.start: SessionStart | None = None
        self.end: SessionEnd | None = None
        self.moves = 0
        self.verdicts: Counter[str] = Counter()
        self.rejected_in_a_row = 0
        self.last_reason: str | None = None
        self.blocks = 0
        """Blocks that are over."""
        self.is_paused = False
        """Whether the stimulus waits, for a person or for a process."""
        self.bad: tuple[str, ...] = ()
        """Channels that are repaired at present."""
        self.ending: tuple[Literal["interrupted", "failed"], str] | None = None
        """Why bci-app itself ended the run; the stimulus, told to stop, can't know."""
        self.notes: list[str] = []

    def take(self, message: AnyMessage) -> None:
        """Take in one message."""
        match message:
            case Status():
                self._states[message.role] = message
            case Note(level="warning" | "error"):
                self.notes.append(f"{message.role}: {message.text}")
            case SessionStart():
                self.start = message
            case SessionEnd():
                self.end = message
            case Pause():
                self.is_paused = True
            case Resume():
                self.is_paused = False
            case MoveOnset():
                self.moves += 1
            case BlockEnd():
                self.blocks += 1
            case EpisodeEnd():
                self._episodes += 1
            case Electrodes():
                self.bad = tuple(message.bad)
            case Verdict():
                self.verdicts[message.outcome] += 1
                self.rejected_in_a_row = self.rejected_in_a_row + 1 if message.outcome == "rejected" else 0
                self.last_reason = message.reason
            case Action():
                self._actions += 1

    def all_ready(self) -> bool:
        """Whether every process says that it is connected to those it needs."""
        return all(role in self._states and self._states[role].state == "ready" for role in self._roles)

    def forget(self, role: Role) -> None:
        """A process is started again: what it said of itself doesn't hold any more."""
        self._states.pop(role, None)

    def all_judged(self) -> bool:
        """Whether every move has its verdict."""
        return self.verdicts.total() >= self.moves

    def whereabouts(self) -> str:
        """One sentence on where each process is, for when it doesn't go on."""
        parts = []
        for role in self._roles:
            status = self._states.get(role)
            parts.append(f"{role} is {status.state} {status.text}".strip() if status else f"{role} was not heard of")
        return "; ".join(parts) + "."

    def progress(self) -> tuple[str, int, int]:
        """(what is going on, done, of how many)."""
        if self.start is None:
            return "waiting for the stimulus to begin", 0, 1
        stimulus = self._states.get("stimulus")
        rejected = self.verdicts["rejected"]
        trouble = f", {rejected} rejected" if rejected else ""
        trouble += f", bad: {' '.join(self.bad)}" if self.bad else ""
        if self.start.n_moves:
            return f"calibration{trouble}", self.moves - rejected, self.start.n_moves
        where = stimulus.text if stimulus else ""
        return f"online, {where}{trouble}", self._episodes, self.start.n_episodes or 1

    def missing_in(self, recording: Recording) -> list[str]:
        """What was heard but is not in the recording, and what is damaged in it, in sentences."""
        counts = (
            ("moves", self.moves, len(recording.of(MoveOnset))),
            ("verdicts", self.verdicts.total(), len(recording.of(Verdict))),
            ("actions", self._actions, len(recording.of(Action))),
        )
        lost = [f"{heard - found} of {heard} {name} are not in it." for name, heard, found in counts if found < heard]
        return [*lost, *recording.damage]

    def outcome(self, recording: Path, outlook: tuple[str, ...] = ()) -> Outcome:
        """How it went, once it is over."""
        end = self.end
        told = (end.reason, end.text) if end else ("failed", "The stimulus never said that it ended.")
        reason, text = self.ending or told
        return Outcome(
            recording=recording,
            reason=reason,
            text=text,
            moves=self.moves,
            verdicts=dict(self.verdicts),
            actions=self._actions,
            notes=tuple(self.notes),
            outlook=outlook,
        )
