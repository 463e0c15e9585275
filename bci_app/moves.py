"""The epochs of a recorded run, cut by the very functions that cut them live."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from bci_app.protocol import Electrodes, MoveOnset, Verdict
from bci_app.recording import Recording
from decoder.epochs import Epoch, Rejection, Shape, cut_recording
from decoder.judge import Judge


@dataclass(frozen=True, eq=False)
class Move:
    """One recorded move: its key, where its onset lies on the EEG's clock, and its epoch."""

    episode: int
    step: int
    clock_offset: float
    result: Epoch | Rejection


def cut_moves(recording: Recording, shape: Shape) -> list[Move]:
    """One `Move` for each distinct (episode, step), in order of onset.

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
    results = cut_recording(microvolts, recording.times, times, shape)
    return [Move(*key, offsets.get(key, 0.0), result) for key, result in zip(keys, results, strict=True)]


def judges(judge: Judge, decisions: dict[int, Electrodes]) -> Callable[[int], Judge]:
    """From an episode to the judge of its moves: `judge`, with the electrodes repaired that were found bad before it.

    Parameters
    ----------
    decisions : by episode; none where the decoder that recorded made none.
    """
    decided = sorted(decisions)

    @cache
    def without(bad: tuple[str, ...]) -> Judge:
        return judge.with_bad(bad)

    def of(episode: int) -> Judge:
        place = bisect_right(decided, episode)
        return without(tuple(sorted(decisions[decided[place - 1]].bad))) if place else judge

    return of


def electrodes(recording: Recording) -> dict[int, Electrodes]:
    """What was decided about the electrodes before each episode."""
    return {decision.episode: decision for _, decision in recording.of(Electrodes)}
