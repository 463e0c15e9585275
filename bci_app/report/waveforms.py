"""Waveforms around moves: single trials at a few channels, means at all of them, by the decoder's own chain.

The chain is linear, so a mean may be taken before it is filtered: that takes one pass over the epochs and one matrix,
whatever the number of moves (`decoder.operator`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ChainConfig
from bci_app.moves import Key, cut_moves
from bci_app.recording import Recording
from bci_app.report import Row
from decoder.chain import design
from decoder.epochs import Epoch, Shape
from decoder.judge import Judge
from decoder.montage import canonical
from decoder.operator import chain_operator

Array = NDArray[np.float64]

BASELINE_MS = (-300.0, 0.0)
"""Whose mean is subtracted (paper, Fig. 9)."""
END_MS = 800.0
"""Last moment shown, ms after the onset (decided: the next countdown begins at 2000)."""
NEAREST = {"Fz": ("Fz", "FCz", "AFz", "Cz"), "FCz": ("FCz", "Fz", "Cz")}
"""Channels looked at, and what stands in where a montage hasn't got them: Fz as in Fig. 9, FCz as in Fig. 11, whose
"Fc" no montage knows."""


@dataclass(frozen=True, eq=False)
class Waveforms:
    """Baseline-corrected waveforms of moves, in uV.

    Attributes
    ----------
    times_ms : float64, (n_times,), after the onset.
    picks : names of the channels with single trials.
    moves : each trial's row of `report.steps.move_rows`.
    error : bool, (n_trials,), the truth.
    trials : float64, (n_trials, n_picks, n_times).
    channels : names of all channels.
    totals : float64, (2, n_channels, n_times), sums over correct (0) and error moves (1).
    n_without : moves that have a truth and no waveform, for samples are missing or the move was rejected.
    """

    times_ms: Array
    picks: tuple[str, ...]
    moves: tuple[Row, ...]
    error: NDArray[np.bool_]
    trials: Array
    channels: tuple[str, ...]
    totals: Array
    n_without: int

    @property
    def difference(self) -> Array | None:
        """Error less correct at all channels, (n_channels, n_times); None unless there are both."""
        if self.error.all() or not self.error.any():
            return None
        return np.asarray(self.totals[1] / self.error.sum() - self.totals[0] / (~self.error).sum())


def waveform_chain(chain: ChainConfig) -> ChainConfig:
    """The decoder's chain without its delay, one sample a window: peaks are where they are in the EEG.

    A decoder that must answer at once filters with minimum phase, which moves what it sees.
    """
    width = 1000 / chain.sfreq
    n = int((END_MS - BASELINE_MS[0]) / width) + 1
    return chain.model_copy(update={"phase": "linear", "start_ms": BASELINE_MS[0], "window_ms": width, "n_windows": n})


def nearest(wanted: str, channels: Sequence[str]) -> str:
    """The channel looked at for `wanted`, among those there are."""
    names = {canonical(name): name for name in reversed(channels)}
    for candidate in NEAREST[wanted]:
        if canonical(candidate) in names:
            return names[canonical(candidate)]
    return channels[0]


def waveforms(
    recording: Recording,
    chain: ChainConfig,
    judge_of: Callable[[Key], Judge],
    moves: Sequence[Row],
) -> Waveforms:
    """Cut and filter a recording's moves.

    Parameters
    ----------
    chain : the decoder's.
    judge_of : from a move to its judge; its spatial matrix repairs, takes the eyes out and averages.
    moves : rows of `report.steps.move_rows`. Those without a truth, and rejected ones, are left out.
    """
    designed = design(waveform_chain(chain), recording.eeg.sfreq)
    operator = chain_operator(designed)
    grid = np.array([window.start for window in designed.windows]) / chain.sfreq
    times_ms = 1e3 * (grid - designed.n_before / recording.eeg.sfreq)
    shape = Shape(recording.eeg.sfreq, designed.n_before, designed.n_after)
    known = {(row["episode"], row["step"]): row for row in moves if row["error"] is not None}
    gathered = _Gathered(judge_of((0, 0)), designed.n_raw)
    for move, result in cut_moves(recording, shape):
        row = known.get(move.key)
        if row is None:
            continue
        judge = judge_of(move.key)
        if isinstance(result, Epoch) and row["verdict"] != "rejected" and judge.unusable is None:
            gathered.take(row, result.data, judge.spatial)
        else:
            gathered.n_without += 1
    return gathered.filtered(operator, times_ms)


class _Gathered:
    """Raw epochs as far as they have been looked at: single trials of the picks, sums of the others."""

    def __init__(self, judge: Judge, n_raw: int) -> None:
        montage = judge.montage
        self.channels = tuple(montage.channels[index] for index in montage.outputs)
        self.picks = tuple(dict.fromkeys(nearest(wanted, self.channels) for wanted in NEAREST))
        self._rows = [self.channels.index(name) for name in self.picks]
        self._n_raw = n_raw
        self._moves: list[Row] = []
        self._raw: list[Array] = []
        self._sums: dict[tuple[int, bool], tuple[Array, Array]] = {}
        self.n_without = 0

    def take(self, move: Row, data: Array, spatial: Array) -> None:
        """One epoch, (n_raw, n_stream), and what acts across its channels."""
        unused = ~spatial.any(axis=0)
        if unused.any():
            data = np.where(unused, 0.0, data)  # may be no numbers
        if not np.isfinite(data).all():
            self.n_without += 1
            return
        self._moves.append(move)
        self._raw.append(data @ spatial[self._rows].T)
        place = id(spatial), bool(move["error"])
        if place in self._sums:
            np.add(self._sums[place][1], data, out=self._sums[place][1])
        else:
            self._sums[place] = spatial, data.copy()

    def filtered(self, operator: Array, times_ms: Array) -> Waveforms:
        """All of them through the chain."""
        base = (times_ms >= BASELINE_MS[0]) & (times_ms < BASELINE_MS[1])
        totals = np.zeros((2, len(self.channels), len(times_ms)))
        for (_, kind), (spatial, data) in self._sums.items():
            totals[int(kind)] += spatial @ (data.T @ operator)
        raw = np.array(self._raw).reshape(-1, self._n_raw, len(self.picks)).transpose(0, 2, 1)
        trials = np.asarray(raw @ operator)
        for part in (totals, trials):
            part -= part[..., base].mean(axis=-1, keepdims=True)
        error = np.array([move["error"] for move in self._moves], dtype=bool)
        return Waveforms(times_ms, self.picks, tuple(self._moves), error, trials, self.channels, totals, self.n_without)


def together(parts: Sequence[Waveforms]) -> Waveforms:
    """Several recordings' waveforms as one; of those with other channels or rates than the first only the count."""
    first = parts[0]
    same = [part for part in parts if part.channels == first.channels and np.array_equal(part.times_ms, first.times_ms)]
    others = sum(len(part.moves) for part in parts if part not in same)
    return Waveforms(
        first.times_ms,
        first.picks,
        tuple(move for part in same for move in part.moves),
        np.concatenate([part.error for part in same]),
        np.concatenate([part.trials for part in same]),
        first.channels,
        np.sum([part.totals for part in same], axis=0),
        others + sum(part.n_without for part in parts),
    )
