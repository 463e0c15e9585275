"""From the clocks of a run's computers to the EEG's: the decoder measured the stimulus's, LabRecorder the others."""

from bisect import bisect_left

import numpy as np

from bci_app.protocol import STREAMS, MoveOnset, Role
from bci_app.recording import Recording, SenderClock

_STREAM = {spec.role: spec.name for spec in reversed(STREAMS) if spec.string}
"""On which stream each role speaks: the first of it."""


class Clocks:
    """The clocks of one recording."""

    def __init__(self, recording: Recording) -> None:
        onsets: dict[tuple[int, int], float] = {}
        for stamp, move in recording.of(MoveOnset):
            onsets.setdefault((move.episode, move.step), stamp)
        verdicts = recording.verdicts.items()
        # By the onset, for the verdict's own stamp may be of another clock.
        measured = sorted((onsets[key], verdict.clock_offset) for key, verdict in verdicts if key in onsets)
        self._onsets = [onset for onset, _ in measured]
        self._offsets = [offset for _, offset in measured]
        self._clocks = recording.clocks
        self._eeg = recording.clocks.get(recording.eeg.name)

    def is_the_stimulus_s(self, role: Role) -> bool:
        """Whether a role ran on the stimulus's computer, and so had its clock. All did where no computers are told."""
        one, other = self._clocks.get(_STREAM["stimulus"]), self._clocks.get(_STREAM[role])
        return one is None or other is None or one.hostname == other.hostname

    def offset(self, role: Role, stamp: float) -> float:
        """Seconds to add to a role's stamp to put it on the EEG's clock.

        The stimulus's is the decoder's: of the verdict on the move that follows, else on the last one; 0 without any.
        That of a role on another computer is LabRecorder's; 0 where it measured none.
        """
        if not self.is_the_stimulus_s(role):
            return _between(self._clocks[_STREAM[role]], self._eeg, stamp)
        place = bisect_left(self._onsets, stamp)
        return self._offsets[min(place, len(self._offsets) - 1)] if self._offsets else 0.0


def _between(own: SenderClock, eeg: SenderClock | None, stamp: float) -> float:
    """By way of the recorder's clock, to which both were measured."""
    if not own.offsets or eeg is None or not eeg.offsets:
        return 0.0
    recorded = stamp + np.interp(stamp, own.times, own.offsets)
    return float(recorded - np.interp(recorded, np.add(eeg.times, eeg.offsets), eeg.offsets) - stamp)
