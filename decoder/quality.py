"""Signal quality of raw EEG: which channels of a trailing window are at fault, and what the fault is called.

What a person does (blinks, alpha, a clenched jaw) and what a room does to all channels is nobody's fault: but for what
no EEG can be, a channel is measured against its neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bci_app.errors import SetupError
from decoder.quality_figures import Alone, Array, Compared, Mask, Meter

Fault = Literal[
    "not finite", "too large", "railed", "flat", "too small", "drifting", "jumping", "line noise", "noisy", "unrelated"
]

# Where a reason says "measured": on runs 3, 5, 7 of subject 1 of PhysioNet's eegmmidb (64 channels, 160 Hz) and ten
# made-up people at 500 Hz, windows of 10 s; benchmarks/decoder_quality.py judges on other runs and people.
MIN_S = 4
"""Whole seconds a window must have: medians over fewer are made of blinks (decided)."""
MIN_NEIGHBOURS = 3
"""Fewest sound channels beside a channel for a comparison: with fewer, one bad one would be their median (decided)."""
FLAT_UV = 0.7
"""Root mean square at 2-40 Hz below which there is an amplifier's noise and no EEG, uV: inputs have 0.1 to 0.5, the
quietest EEG 2.9 (measured)."""
FLAT_SHARE = 0.2
"""Share of seconds that may not be flat: an electrode that is off for 2 of 10 s is off (decided)."""
RAIL_UV = 100_000.0
"""A line this far from 0 is the end of an amplifier's range, uV: ranges end between 187,500 (ADS1299 at a gain of 24)
and 400,000, and electrode offsets stay below 50,000 (decided)."""
RAIL_SHARE = 0.005
"""Share of neighbouring samples that may both lie at the window's extreme: 50 ms of 10 s. EEG
in steps of 1 uV has up to 0.0006 (measured), 0.0025 in windows of 5 s."""
LARGE_UV = 150.0
"""Root mean square at 2-40 Hz that no awake head has, uV; blinks and all, up to 105 (measured)."""
LARGE_RATIO = 4.5
SMALL_RATIO = 0.22
"""Amplitude against the neighbours' median: half way, in logarithms, between good channels (0.46 to 2.15, at an ear
near the reference and over an eye; measured) and those whose gain is wrong by ten."""
DRIFT_UV = 200.0
"""Range of the level against the neighbours', uV in 10 s; eyes and ordinary gel give up to 176 (measured)."""
JUMP_UV = 100.0
"""Largest step that is held, beyond the neighbours', uV: averaging 64 electrodes leaves 2 uV of it (decided)."""
JUMP_RATIO = 3.5
"""... and against the largest of the channel's ordinary seconds, so that mere noise doesn't jump: pops of 150 to 600 uV
are above in 96 to 99 % of windows; eyes and muscles reach 2.2 with 64 channels, but once 3.9, at Fpz with 32
(measured)."""
LINE_UV = 10.0
"""Root mean square of line noise, uV, that is harmless on any channel: as much as EEG has (decided)."""
LINE_RATIO = 5.0
"""... and against the neighbours' median: cables differ, by up to 3.6 times in good ones (measured), and what the room
does to the whole head is no channel's fault."""
LINE_MOST_UV = 100.0
"""Line noise that is a fault whatever the neighbours have, uV: ten times the EEG (decided)."""
NOISE_UV = 2.0
"""Root mean square above 25 Hz, uV, that is harmless on any channel (decided)."""
NOISE_RATIO = 3.5
"""... and against the neighbours' median. Jaw muscles give up to 2.8 at T8 (measured); noise of five times the
neighbours' gives 5."""
UNRELATED = 0.86
"""Share of a channel's power that its neighbours may leave unexplained. Up to 0.80 at T10, near the reference (0.85
where its place is not known), otherwise 0.67 even with 8 channels; 98 % of floating channels have 0.91 (measured).
PREP's correlation criterion, at 0.4, allows 0.84 (Bigdely-Shamlo 2015, doi:10.3389/fninf.2015.00016)."""


@dataclass(frozen=True)
class ChannelQuality:
    """One channel in one window; a figure is None where it can't be measured.

    Attributes
    ----------
    name : the channel.
    faults : what is wrong with it; nothing in a good channel.
    n_not_finite : int, samples that are NaN or infinite.
    amplitude : root mean square of an ordinary second, 2-40 Hz, uV.
    line : root mean square of line noise, uV.
    ratio, noise_ratio : amplitude, and the same above 25 Hz, over the neighbours' median.
    drift : range of the level less the neighbours', uV in 10 s or less.
    jump : largest step that stands out, beyond what the neighbours do at that time, uV.
    unexplained : share of the power that no mixture of the neighbours gives, 0 to 1.
    """

    name: str
    faults: tuple[Fault, ...]
    n_not_finite: int
    amplitude: float | None = None
    line: float | None = None
    ratio: float | None = None
    noise_ratio: float | None = None
    drift: float | None = None
    jump: float | None = None
    unexplained: float | None = None

    @property
    def is_bad(self) -> bool:
        """Whether anything is wrong with it."""
        return bool(self.faults)


class Inspector:
    """Judges windows of one stream. Nothing is carried over: the same samples give the same answer.

    Parameters
    ----------
    channels : names. One of known place is compared with the nearest, any other with those most like it.
    sfreq : rate, Hz. Raises SetupError at 90 Hz and less.

    Notes
    -----
    A reference that is recorded as a channel of zeros is called flat, for it is. Faults that half of a channel's
    neighbours share are theirs, not its. Where all channels are bad, "not finite", "flat", "railed", "too large" and
    line noise beyond `LINE_MOST_UV` are still found, each channel by itself.
    """

    def __init__(self, channels: Sequence[str], sfreq: float) -> None:
        self.channels = tuple(channels)
        self._meter = Meter(channels, sfreq)

    @property
    def n_least(self) -> int:
        """Samples that a window must have."""
        return MIN_S * self._meter.n_second

    def inspect(self, samples: Array) -> tuple[ChannelQuality, ...]:
        """Quality of each channel over the whole seconds at the end of `samples`, (n_times, n_channels), uV.

        Raises SetupError for fewer than `n_least` samples, or another number of channels.
        """
        if samples.ndim != 2 or samples.shape[1] != len(self.channels):
            raise SetupError(f"Expected EEG of {len(self.channels)} channels, found an array of {samples.shape}.")
        if len(samples) < self.n_least:
            raise SetupError(
                f"Signal quality needs {self.n_least} samples ({MIN_S} s), found {len(samples)}. Wait for more."
            )
        alone = self._meter.alone(samples)
        faults = _faults_alone(alone)
        sound = ~_any(faults)
        compared: Compared | None = None
        # A channel at fault is no measure for the next: look once more without those found.
        for _ in range(2):
            if sound.sum() <= MIN_NEIGHBOURS:
                break
            compared = self._meter.compare(alone, sound)
            faults = _with_comparison(_faults_alone(alone), alone, compared)
            better = sound & ~_any(faults)
            if (better == sound).all():
                break
            sound = better
        return tuple(self._quality(index, faults, alone, compared) for index in range(len(self.channels)))

    def _quality(
        self, index: int, faults: dict[Fault, Mask], alone: Alone, compared: Compared | None
    ) -> ChannelQuality:
        name = self.channels[index]
        found = tuple(fault for fault, where in faults.items() if where[index])
        n_not_finite = int(alone.n_not_finite[index])
        if not alone.usable[index]:
            return ChannelQuality(name, found, n_not_finite)
        amplitude, line = float(alone.amplitude[index]), float(alone.line[index])
        if compared is None:
            return ChannelQuality(name, found, n_not_finite, amplitude, line)
        columns = (compared.ratio, compared.noise_ratio, compared.drift, compared.jump, compared.unexplained)
        return ChannelQuality(name, found, n_not_finite, amplitude, line, *(float(column[index]) for column in columns))


def _faults_alone(alone: Alone) -> dict[Fault, Mask]:
    """The faults that show without neighbours, each as (n_channels,)."""
    silent = alone.amplitude < FLAT_UV
    far = np.maximum(-alone.low, alone.high) >= RAIL_UV
    railed = alone.usable & np.where(silent, far, alone.at_rail > RAIL_SHARE)
    off = (alone.amplitudes < FLAT_UV).mean(axis=0) >= FLAT_SHARE
    finite = alone.n_not_finite == 0
    return {
        "not finite": ~finite,
        "railed": railed,
        "flat": alone.usable & off & ~railed,
        "too large": (finite & ~alone.usable) | (alone.amplitude > LARGE_UV),
        "line noise": alone.line > LINE_MOST_UV,
    }


def _with_comparison(faults: dict[Fault, Mask], alone: Alone, compared: Compared) -> dict[Fault, Mask]:
    """All faults: those given, and the ones that show against the neighbours."""
    # Of a channel that delivers no EEG at all nothing else is said.
    alive = alone.usable & ~faults["flat"] & (alone.amplitude >= FLAT_UV)
    line_is_own = (alone.line > LINE_UV) & (alone.line > LINE_RATIO * compared.line_around)
    jump_is_sudden = (compared.jump > JUMP_UV) & (compared.jump > JUMP_RATIO * compared.usual_jump)
    return faults | {
        "too large": faults["too large"] | (alive & (compared.ratio > LARGE_RATIO)),
        "too small": alive & (compared.ratio < SMALL_RATIO),
        "drifting": alive & (compared.drift > DRIFT_UV),
        "jumping": alive & jump_is_sudden,
        "line noise": faults["line noise"] | (alive & line_is_own),
        "noisy": alive & (alone.noise > NOISE_UV) & (compared.noise_ratio > NOISE_RATIO),
        "unrelated": alive & (compared.unexplained > UNRELATED),
    }


def _any(faults: dict[Fault, Mask]) -> Mask:
    return np.asarray(np.any(list(faults.values()), axis=0))
