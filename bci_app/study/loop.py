"""The closed loop in one process: the stimulus, the participant, the decoder and the policy, on a clock that jumps.

These are the live loop's own functions: `Paradigm` moves the agent, a simulated person answers its moves in EEG,
`Judge` makes verdicts of that, `Navigator` chooses the next move. There is no LSL and nothing waits, so a session of an
hour takes half a minute. What a live session owes to the moment are the times of its flips, and when the decoder looked
at the electrodes; all else follows from the seeds. `Moments` are these times: ideal ones, or a live session's.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bci_app.eeg import EegDescription
from bci_app.protocol import (
    Action,
    Electrodes,
    EpisodeStart,
    Message,
    MoveOnset,
    SessionStart,
    Truth,
    Verdict,
)
from decoder.attention import Attention
from decoder.electrodes import RECORDED_S, Examiner
from decoder.epochs import Epoch, Rejection, Shape, cut_one_by_one
from decoder.judge import Judge
from decoder.participant import Person
from policy.navigator import Navigator
from stimulus.paradigm import Paradigm

Array = NDArray[np.float64]
Key = tuple[int, int]
"""(episode, step)."""

LEAD_S = 10.0
"""Session seconds of EEG before the run's first message: the chain's filter and a look at the electrodes need some."""
TAIL_S = 1.0
"""Session seconds of EEG after its last."""
REJECTED_BEFORE_A_LOOK = 2
"""Verdicts rejected in a row after which the electrodes are looked at again, as the live decoder does."""
MARGIN = 8
"""Samples on both sides of an epoch that are looked at to place it (decided)."""


class Moments(Protocol):
    """The times that a live session owes to the moment."""

    def onset(self, due: float) -> float:
        """Session time of the flip of the next move, which is due at `due`, s."""

    def look(self, key: Key, now: float, since: float) -> tuple[float, float]:
        """From after which stamp to which the EEG is looked at for bad electrodes, s."""


class Ideal:
    """Every flip comes when it is due, and the decoder has its samples at once."""

    def onset(self, due: float) -> float:
        """As `Moments`."""
        return due

    def look(self, key: Key, now: float, since: float) -> tuple[float, float]:
        """As `Moments`."""
        return since, now


@dataclass
class AsHeard:
    """Those of a session that took place.

    Attributes
    ----------
    onsets : stamps of its moves, in order, s.
    looks : its decisions on electrodes, by their key.
    sfreq : rate of its EEG, Hz.
    """

    onsets: Iterator[float]
    looks: dict[Key, Electrodes]
    sfreq: float

    def onset(self, due: float) -> float:
        """As `Moments`. Raises StopIteration where that session had made fewer moves."""
        return next(self.onsets)

    def look(self, key: Key, now: float, since: float) -> tuple[float, float]:
        """As `Moments`; nothing where it hadn't looked."""
        heard = self.looks.get(key)
        if heard is None or heard.last_time is None:
            return 0.0, -1.0
        half = 0.5 / self.sfreq
        return heard.last_time - (heard.n_samples - 1) / self.sfreq - half, heard.last_time + half


@dataclass(frozen=True, eq=False)
class Made:
    """A run of the loop in one process, as a recording would hold it.

    Attributes
    ----------
    messages : with their stamps, in order.
    samples, times : float32, (n_times, n_channels), uV, and float64, (n_times,), stamps in s.
    eeg : header of the stream.
    """

    messages: tuple[tuple[float, Message], ...]
    samples: NDArray[np.float32]
    times: Array
    eeg: EegDescription


class Stream:
    """The EEG of a person up to any sample, which is rendered when it is first asked for.

    Parameters
    ----------
    person : who answers; sample 0 is taken at session time `t0`.
    """

    def __init__(self, person: Person, t0: float) -> None:
        self.person, self.t0 = person, t0
        self._held = np.empty((1024, len(person.names)), np.float32)
        self.n = 0

    def number(self, when: float) -> int:
        """The last sample at or before a session time."""
        return int(np.floor((when - self.t0) * self.person.sfreq + 1e-6))

    def upto(self, n: int) -> None:
        """Render the samples before number `n`."""
        if n <= self.n:
            return
        if n > len(self._held):
            grown = np.empty((max(n, 2 * len(self._held)), self._held.shape[1]), np.float32)
            grown[: self.n] = self._held[: self.n]
            self._held = grown
        self._held[self.n : n] = self.person.render(self.n, n - self.n)
        self.n = n

    def window(self, first: int, stop: int) -> tuple[NDArray[np.float32], Array]:
        """Samples from number `first` to before `stop`, and their stamps as an amplifier gives them."""
        self.upto(stop)
        return self._held[first:stop], self.t0 + np.arange(first, stop) / self.person.sfreq

    def epoch(self, onset: float, shape: Shape) -> Epoch | Rejection:
        """The epoch around an onset, s, cut as from a recording."""
        nearest = self.number(onset)
        first = max(0, nearest - shape.n_before - MARGIN)
        samples, times = self.window(first, nearest + shape.n_after + MARGIN)
        return next(cut_one_by_one(samples.astype(np.float64), times, [onset], shape))


def described(person: Person) -> EegDescription:
    """The stream of the simulated amplifier that plays this person."""
    names = tuple(person.names)
    return EegDescription(
        name="SimulatedAmplifier",
        source_id="one-process",
        hostname="",
        channels=names,
        units=("microvolts",) * len(names),
        types=("EEG",) * len(names),
        sfreq=person.sfreq,
    )


@dataclass
class Loop:
    """One run.

    Attributes
    ----------
    paradigm : what happens; nothing in it may wait for a key.
    stream, attention : the participant, and how its ErrP changes within the run. Without a stream nobody has EEG, and
        every verdict is missing.
    judge : makes verdicts of epochs; None without a stream.
    navigator : chooses moves; None in a calibration, whose agent errs on purpose.
    moments : the times a live session owes to the moment.
    """

    paradigm: Paradigm
    stream: Stream | None
    attention: Attention | None
    judge: Judge | None
    navigator: Navigator | None
    moments: Moments = field(default_factory=Ideal)
    messages: list[tuple[float, Message]] = field(default_factory=list)
    _truths: dict[Key, Truth] = field(default_factory=dict)
    _since: float = -np.inf
    _n_rejected: int = 0
    _examiner: Examiner | None = None
    _electrodes: Electrodes | None = None

    def run(self, begin: float) -> tuple[tuple[float, Message], ...]:
        """Make the run, from session time `begin` to its end; its messages in order of their stamps.

        Raises RuntimeError where the run waits for something that can't come.
        """
        now, paradigm = begin, self.paradigm
        paradigm.start(now)
        now = self._deliver(now)
        while not paradigm.done:
            due = paradigm.next_due()
            if paradigm.awaiting_flip:
                now = self.moments.onset(now)
                paradigm.flipped(now)
            elif due is not None:
                now = max(now, due)
                paradigm.update(now)
            else:
                raise RuntimeError(f"the run waits for {paradigm.waiting_for} at {now:.3f}: {paradigm.progress}")
            now = self._deliver(now)
        return tuple(sorted(self.messages, key=lambda item: item[0]))

    def _deliver(self, now: float) -> float:
        """Hand messages to whom they concern, truth first as on the wire; when all have answered."""
        out = self.paradigm.take_messages()
        for item in sorted(out, key=lambda each: each.stream != "truth"):
            self.messages.append((item.stamp, item.message))
            match item.message:
                case Truth() as truth:
                    self._truths[truth.episode, truth.step] = truth
                case SessionStart() as opening:
                    self._since = item.stamp - RECORDED_S
                    if self.attention is not None:
                        self.attention.open(opening.task, opening.layout)
                case EpisodeStart() as start:
                    self._look((start.episode, 0), item.stamp)
                    if self.navigator is not None:
                        self._act(self.navigator.begin(start), item.stamp)
                case MoveOnset() as move:
                    now = self._moved(move, item.stamp)
        return now

    def _moved(self, move: MoveOnset, onset: float) -> float:
        """The person answers, the decoder judges, the policy decides; when that is done."""
        key, now = (move.episode, move.step), onset
        truth, verdict = self._truths.pop(key), None
        if self.stream is not None and self.judge is not None and self.attention is not None:
            if self._n_rejected >= REJECTED_BEFORE_A_LOOK:
                self._look(key, onset)
            self.stream.person.respond(onset, truth.error, self.attention.size(truth, move.position))
            now = onset + self.judge.shape.n_after / self.judge.shape.sfreq
            verdict = self.judge.verdict(key, self.stream.epoch(onset, self.judge.shape), 0.0)
            self._n_rejected = self._n_rejected + 1 if verdict.outcome == "rejected" else 0
            self.messages.append((now, verdict))
            self.paradigm.take_verdict(verdict, now)
        if self.navigator is not None:
            self._act(self._next(self.navigator, move, verdict), now)
        return now

    @staticmethod
    def _next(navigator: Navigator, move: MoveOnset, verdict: Verdict | None) -> Action | None:
        action = navigator.moved(move)
        return navigator.missing() if verdict is None else navigator.judged(verdict) or action

    def _act(self, action: Action | None, now: float) -> None:
        if action is None:
            return
        self.messages.append((now, action))
        refusal = self.paradigm.offer_action(action)
        if refusal is not None:
            raise RuntimeError(f"the stimulus refused an action of its own loop: {refusal}")

    def _look(self, key: Key, now: float) -> None:
        """Decide which electrodes are bad, as the live decoder does at an episode's start."""
        if self.stream is None or self.judge is None:
            return
        if self._examiner is None:
            self._examiner = Examiner(self.paradigm.session, self.stream.person.names, self.stream.person.sfreq)
        after, until = self.moments.look(key, now, self._since)
        stop = self.stream.number(until) + 1
        first = max(0, stop - self._examiner.n_window, self.stream.number(after) + 1)
        samples, times = self.stream.window(first, max(first, stop))
        self._electrodes = electrodes = self._examiner.decide(key, samples.astype(np.float64), times, self._electrodes)
        self.judge = self.judge.with_bad(electrodes.bad)
        self._n_rejected = 0
        self.messages.append((now, electrodes))

    def made(self) -> Made:
        """The run with its EEG. Only of a loop that has a stream."""
        assert self.stream is not None
        first = max(0, self.stream.number(self.messages[0][0] - LEAD_S))
        stop = self.stream.number(max(stamp for stamp, _ in self.messages) + TAIL_S)
        samples, times = self.stream.window(first, stop)
        messages = tuple(sorted(self.messages, key=lambda item: item[0]))
        return Made(messages, samples, times, described(self.stream.person))
