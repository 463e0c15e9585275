"""The running average of the responses to errors and to correct moves, as the decoder sees them, at every channel.

It goes through the decoder's own chain (resampling, minimum-phase FIR, common average) by the decoder's own functions,
in windows of 10 ms instead of 30: what is averaged here is what verdicts are made of. The eyes aren't taken out, bad
channels not repaired but left out. Pure: no LSL, no clock.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ChainConfig, EegConfig
from decoder.chain import design
from decoder.epochs import EpochBuffer, Rejection, Shape
from decoder.eyes import eeg_outputs
from decoder.operator import chain_operator, features

Key = tuple[int, int]
START_MS, WINDOW_MS, N_WINDOWS = -300.0, 10.0, 100
"""From 300 ms before the move, as the paper's figures, to 700 after; 10 ms are two or three samples of the chain."""
BASELINE_MS = 300.0
"""The mean of so much before the move is taken off (paper, Fig. 9)."""
BUFFER_S = 20.0
"""Session seconds of EEG that are kept: a truth may come late, at many times real speed."""
CLASSES = ("correct", "error")


class Averages:
    """Averages over the moves of one run, from the stream's samples and what is known of each move.

    Parameters
    ----------
    channels : of the stream, EOG too.
    sfreq : rate, Hz.
    chain : the decoder's settings; their windows are replaced.
    limits : an epoch that leaves them is left out, as the decoder rejects it.

    Attributes
    ----------
    times_ms : middle of each window, from the move on, ms.
    version : grows with every epoch that is taken in.
    """

    def __init__(self, channels: list[str], sfreq: float, chain: ChainConfig, limits: EegConfig) -> None:
        windows = {"start_ms": START_MS, "window_ms": WINDOW_MS, "n_windows": N_WINDOWS, "phase": "minimum"}
        designed = design(chain.model_copy(update=windows), sfreq)
        self.channels = channels
        self.times_ms = START_MS + WINDOW_MS * (np.arange(N_WINDOWS) + 0.5)
        self.version = 0
        self.n_left_out = 0
        """Epochs that were not whole, or beyond the limits."""
        self._operator, self._limits = chain_operator(designed), limits
        self._buffer: EpochBuffer[Key] = EpochBuffer(
            Shape(sfreq, designed.n_before, designed.n_after), len(channels), BUFFER_S
        )
        self._eeg = eeg_outputs(channels)
        self._waiting: dict[Key, tuple[bool, frozenset[str]]] = {}
        self._sums = np.zeros((len(CLASSES), len(channels), N_WINDOWS))
        self._counts = np.zeros((len(CLASSES), len(channels)), int)

    def push(self, samples: NDArray[np.floating], times: NDArray[np.float64]) -> None:
        """Take in EEG: (n_times, n_channels) in uV and raw stamps."""
        self._buffer.push(samples, times)
        self._settle()

    def expect(self, key: Key, onset: float, error: bool, bad: frozenset[str]) -> None:
        """Average the epoch of a move: its onset on the EEG's clock, its truth, and the channels that are bad."""
        if self._buffer.expect(key, onset):
            self._waiting[key] = error, bad
            self._settle()

    def forget(self, void: Callable[[Key], bool]) -> None:
        """Moves that are void may come once more; what was averaged of them stays."""
        self._buffer.forget(void)
        self._waiting = {key: known for key, known in self._waiting.items() if not void(key)}

    def newest(self, seconds: float, sfreq: float) -> NDArray[np.floating]:
        """The newest EEG, up to so many session seconds: (n_times, n_channels), a view."""
        return self._buffer.trailing(round(seconds * sfreq))[0]

    def counts(self) -> dict[str, int]:
        """Epochs of each kind, at the channel that has most."""
        return {name: int(self._counts[index].max(initial=0)) for index, name in enumerate(CLASSES)}

    def at(self, channel: str) -> dict[str, Any]:
        """Averages at one channel, uV, with the baseline taken off: `correct`, `error` and `difference` (error minus
        correct), None where there are no epochs, with `n` of each and `times_ms`.

        Raises KeyError for a channel that isn't there.
        """
        if channel not in self.channels:
            raise KeyError(channel)
        place = self.channels.index(channel)
        before = slice(0, round(BASELINE_MS / WINDOW_MS))
        means: dict[str, NDArray[np.float64] | None] = {}
        for index, name in enumerate(CLASSES):
            count = self._counts[index, place]
            mean = self._sums[index, place] / count if count else None
            means[name] = mean - mean[before].mean() if mean is not None else None
        error, correct = means["error"], means["correct"]
        difference = error - correct if error is not None and correct is not None else None
        curves = means | {"difference": difference}
        return {
            "channel": channel,
            "times_ms": self.times_ms.tolist(),
            "n": {name: int(self._counts[index, place]) for index, name in enumerate(CLASSES)},
            **{name: None if curve is None else np.round(curve, 3).tolist() for name, curve in curves.items()},
        }

    def _settle(self) -> None:
        for key, epoch in self._buffer.poll():
            error, bad = self._waiting.pop(key)
            if isinstance(epoch, Rejection):
                self.n_left_out += 1
                continue
            used = np.array([place for place in self._eeg if self.channels[place] not in bad], int)
            if not len(used) or not np.isfinite(epoch.data[:, used]).all():
                self.n_left_out += 1
                continue
            average = np.zeros((len(self.channels), len(self.channels)))
            average[np.ix_(used, used)] = np.eye(len(used)) - 1 / len(used)
            response = features(epoch.data, self._operator, average).reshape(len(self.channels), N_WINDOWS)
            if np.abs(response).max() > self._limits.max_band_uv:
                self.n_left_out += 1
                continue
            self._sums[int(error)] += response
            self._counts[int(error), used] += 1
            self.version += 1
