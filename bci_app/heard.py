"""What bci-app heard of a run: who is ready, how far it is, how it ended. No LSL: messages are handed in."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bci_app.move_set import MoveSet
from bci_app.protocol import (
    Action,
    AnyMessage,
    BlockEnd,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    MoveOnset,
    Note,
    Pause,
    Resume,
    Role,
    SessionEnd,
    SessionStart,
    Status,
    Truth,
    Verdict,
)
from bci_app.recording import Recording
from bci_app.said import place_after


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
    verified : what the check of the closed recording found, in a sentence; empty where there is none.
    outlook : after each block of a calibration, what it was worth so far and what more would be.
    """

    recording: Path
    reason: Literal["complete", "interrupted", "failed"]
    text: str
    moves: int
    verdicts: dict[str, int]
    actions: int
    notes: tuple[str, ...]
    verified: str
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
        self._episodes: set[int] = set()  # that have ended
        self._actions, self._moves, self._judged = MoveSet(), MoveSet(), MoveSet()
        self._outcomes: dict[str, MoveSet] = {}  # those that are judged, by how
        self.start: SessionStart | None = None
        self.end: SessionEnd | None = None
        self.rejected_in_a_row = 0
        self.last_reason: str | None = None
        self.blocks = 0
        """Blocks that are over."""
        self.is_paused = self.is_paused_by_person = False
        """Whether the stimulus waits; and whether for a person's key."""
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
                self.is_paused, self.is_paused_by_person = True, message.by_person
            case Resume():
                self.is_paused = self.is_paused_by_person = False
            case Continued():
                self._drop_void(message)
            case MoveOnset():
                self._moves.add((message.episode, message.step))
            case BlockEnd():
                self.blocks += 1
            case EpisodeEnd():
                self._episodes.add(message.episode)
            case Electrodes():
                self.bad = tuple(message.bad)
            case Verdict():
                self._take_verdict(message)
            case Action():
                self._actions.add((message.episode, message.step))

    def _take_verdict(self, verdict: Verdict) -> None:
        """Of two on one move, from a decoder that was started again, the first counts."""
        key = verdict.episode, verdict.step
        if key in self._judged:
            return
        self._judged.add(key)
        self._outcomes.setdefault(verdict.outcome, MoveSet()).add(key)
        self.last_reason = verdict.reason
        if verdict.outcome != "rejected":
            self.rejected_in_a_row = 0
        elif not verdict.by_time:  # what came too late says nothing about the EEG
            self.rejected_in_a_row += 1

    def _drop_void(self, continued: Continued) -> None:
        place = place_after(continued)
        for moves in (self._moves, self._judged, *self._outcomes.values()):
            moves -= {key for key in moves if key > place}
        self._actions -= {(episode, step) for episode, step in self._actions if (episode, step - 1) > place}

    @property
    def moves(self) -> int:
        """Moves that count."""
        return len(self._moves)

    @property
    def verdicts(self) -> Counter[str]:
        """How many of each outcome."""
        return Counter({outcome: len(moves) for outcome, moves in self._outcomes.items() if moves})

    def all_ready(self) -> bool:
        """Whether every process says that it is connected to those it needs."""
        return all(role in self._states and self._states[role].state == "ready" for role in self._roles)

    def forget(self, role: Role) -> None:
        """A process is started again: what it said of itself doesn't hold any more."""
        self._states.pop(role, None)

    def all_judged(self) -> bool:
        """Whether every move has its verdict."""
        return self._moves <= self._judged

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
        return f"online, {where}{trouble}", len(self._episodes), self.start.n_episodes or 1

    def missing_in(self, recording: Recording, has_truth: bool) -> list[str]:
        """What was heard but is not in the recording, and what is damaged in it, in sentences.

        Where our own stimulus ran, `has_truth`, each of its moves must have a truth and a marker there.
        """
        heard: tuple[tuple[str, MoveSet, type[MoveOnset | Verdict | Action]], ...] = (
            ("moves", self._moves, MoveOnset),
            ("verdicts", self._judged, Verdict),
            ("actions", self._actions, Action),
        )
        lost = []
        for name, keys, kind in heard:
            missing = set(keys) - {(message.episode, message.step) for _, message in recording.of(kind)}
            if missing:
                lost.append(f"{len(missing)} of {len(keys)} {name} are not in it.")
        moves = {(message.episode, message.step): stamp for stamp, message in recording.of(MoveOnset)}
        if has_truth:
            truths = {(message.episode, message.step) for _, message in recording.of(Truth)}
            goals = {message.episode for _, message in recording.of(EpisodeGoal)}
            marked = {stamp for stamp, _ in recording.markers}
            without = {
                "truth": [key for key in moves if key not in truths],
                "marker": [key for key, stamp in moves.items() if stamp not in marked],
                "goal": [key for key in moves if key[0] not in goals],
            }
            lost += [
                f"{len(keys)} of {len(moves)} moves have no {what} in it." for what, keys in without.items() if keys
            ]
        return [*lost, *recording.damage]

    def outcome(self, recording: Path, verified: str = "", outlook: tuple[str, ...] = ()) -> Outcome:
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
            actions=len(self._actions),
            notes=tuple(self.notes),
            verified=verified,
            outlook=outlook,
        )
