"""The epochs of a recorded run, cut by the very functions that cut them live."""

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

from bci_app.protocol import Electrodes, MoveOnset
from bci_app.recording import Recording
from decoder.epochs import Epoch, Rejection, Shape, cut_one_by_one
from decoder.judge import Judge

Key = tuple[int, int]
"""(episode, step)."""
Decisions = Mapping[Key, Electrodes]
"""What was decided about the electrodes, by the first move each decision is for; nothing by a decoder that didn't."""
Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Move:
    """One recorded move: its (episode, step), and its onset on the EEG's clock, which is off the stimulus's, in s."""

    key: Key
    onset: float
    clock_offset: float


def cut_moves(recording: Recording, shape: Shape) -> Iterator[tuple[Move, Epoch | Rejection]]:
    """Each distinct move with its epoch, in order of onset; one at a time, for all are as large as the recording.

    The offset between the clocks of stimulus and EEG is the one the decoder used and wrote into its verdict; without
    a verdict (a run without our decoder) the clocks are taken as one, as they are on one machine.
    """
    offsets = {key: verdict.clock_offset for key, verdict in recording.verdicts.items()}
    onsets: dict[tuple[int, int], float] = {}
    for stamp, move in recording.of(MoveOnset):
        onsets.setdefault((move.episode, move.step), stamp)
    keys = list(onsets)
    times = [onsets[key] + offsets.get(key, 0.0) for key in keys]
    microvolts = recording.eeg.in_microvolts(recording.samples)
    results = cut_one_by_one(microvolts, recording.times, times, shape)
    for key, onset, result in zip(keys, times, results, strict=True):
        yield Move(key, onset, offsets.get(key, 0.0)), result


def by_bad(decisions: Decisions, make: Callable[[tuple[str, ...]], Made]) -> Callable[[Key], Made]:
    """From a move to what ``make`` makes of the channels that were bad at it; made once for each set of them."""
    decided, made = sorted(decisions), cache(make)

    def of(key: Key) -> Made:
        place = bisect_right(decided, key)
        return made(tuple(sorted(decisions[decided[place - 1]].bad)) if place else ())

    return of


def judges(judge: Judge, decisions: Decisions) -> Callable[[Key], Judge]:
    """From a move to its judge: `judge`, with the electrodes repaired that were found bad before it."""
    return by_bad(decisions, judge.with_bad)


def electrodes(recording: Recording) -> dict[Key, Electrodes]:
    """What was decided about the electrodes, by (episode, step) of the first move each decision is for."""
    return {(decision.episode, decision.step): decision for _, decision in recording.of(Electrodes)}
