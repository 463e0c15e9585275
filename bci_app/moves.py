"""The epochs of a recorded run, cut by the very functions that cut them live."""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

from bci_app.protocol import Electrodes, MoveOnset, Verdict
from bci_app.recording import Recording
from decoder.epochs import Epoch, Rejection, Shape, cut_one_by_one
from decoder.judge import Judge


@dataclass(frozen=True, eq=False)
class Move:
    """One recorded move: its (episode, step), and its onset on the EEG's clock, which is off the stimulus's, in s."""

    key: tuple[int, int]
    onset: float
    clock_offset: float


def cut_moves(recording: Recording, shape: Shape) -> Iterator[tuple[Move, Epoch | Rejection]]:
    """Each distinct move with its epoch, in order of onset; one at a time, for all are as large as the recording.

    The offset between the clocks of stimulus and EEG is the one the decoder used and wrote into its verdict; without
    a verdict (a run without our decoder) the clocks are taken as one, as they are on one machine.
    """
    offsets = {(verdict.episode, verdict.step): verdict.clock_offset for _, verdict in recording.of(Verdict)}
    onsets: dict[tuple[int, int], float] = {}
    for stamp, move in recording.of(MoveOnset):
        onsets.setdefault((move.episode, move.step), stamp)
    keys = list(onsets)
    times = [onsets[key] + offsets.get(key, 0.0) for key in keys]
    microvolts = recording.eeg.in_microvolts(recording.samples)
    results = cut_one_by_one(microvolts, recording.times, times, shape)
    for key, onset, result in zip(keys, times, results, strict=True):
        yield Move(key, onset, offsets.get(key, 0.0)), result


def judges(judge: Judge, decisions: dict[tuple[int, int], Electrodes]) -> Callable[[tuple[int, int]], Judge]:
    """From a move's (episode, step) to its judge: `judge`, with the electrodes repaired that were found bad before it.

    Parameters
    ----------
    decisions : by (episode, step) of the first move each is for; none where the decoder that recorded made none.
    """
    decided = sorted(decisions)

    @cache
    def without(bad: tuple[str, ...]) -> Judge:
        return judge.with_bad(bad)

    def of(key: tuple[int, int]) -> Judge:
        place = bisect_right(decided, key)
        return without(tuple(sorted(decisions[decided[place - 1]].bad))) if place else judge

    return of


def electrodes(recording: Recording) -> dict[tuple[int, int], Electrodes]:
    """What was decided about the electrodes, by (episode, step) of the first move each decision is for."""
    return {(decision.episode, decision.step): decision for _, decision in recording.of(Electrodes)}
