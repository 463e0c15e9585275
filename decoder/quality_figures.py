"""The figures behind `decoder.quality`: what channels show by themselves, and what they show against their neighbours.

Measured second by second and taken as the median over seconds, so that a blink or a swallow leaves no trace.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import fft, signal

from bci_app.errors import SetupError
from decoder.montage import directions

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

RATE_HZ = 250.0
"""Windows are averaged down to the lowest rate not below this, Hz: the harmonics at 100 and 120 Hz still fit in."""
EEG_HZ = (2.0, 40.0)
"""Band of the amplitude: above electrode drifts, below the line."""
NOISE_HZ = (26.0, 45.0)
"""Band of broadband noise: EEG is weak there, and the decoder's band-pass (1-50 Hz) lets it through."""
SHARED_HZ = (2.0, 25.0)
"""Band in which volume conduction makes neighbours alike; muscles are stronger above."""
LINES_HZ = (50.0, 60.0)
"""Mains of the world; the harmonic at twice the frequency counts too."""
LEVELS_A_SECOND = 10
"""A second's level is the median of the means of so many parts: a blink of 0.3 s doesn't move it."""
LEVEL_S = 3
"""Seconds over which levels are averaged before their range is taken: eyes come back within 3 s, a drift doesn't."""
DRIFT_S = 10.0
"""Seconds that drifts are told for; those over longer windows are scaled to it."""
JUMP_S = 0.008
"""An electrode jumps within a sample or two; a blink takes 50 ms and more to rise."""
HELD_S = 0.05
"""... and stays there at least so long on either side; a muscle's spike doesn't."""
USUAL = 0.25
"""Quantile over seconds of the largest step in each that is ordinary: seven pops in ten seconds don't touch it."""
OUTSTANDING = 2.0
"""Steps so many times the largest of an ordinary second are looked at: the others are noise (decided)."""
RAIL_TOLERANCE_UV = 0.05
"""Samples this near to the window's extreme are at it, uV: about one step of a 24-bit converter (decided)."""
BEYOND_UV = 1e7
"""No amplifier delivers 10 V: beyond, samples are numbers but no voltages (decided)."""
N_NEIGHBOURS = 8
"""Channels a channel is compared with: those around it in a 10-10 montage. Their median stands three bad ones."""
RIDGE = 1e-3
"""Added to the diagonal of the neighbours' correlations: nearly equal channels need not be told apart (decided)."""


@dataclass(frozen=True, eq=False)
class Alone:
    """What channels show by themselves; (n_channels,) unless said otherwise.

    Attributes
    ----------
    n_not_finite : samples that are NaN or infinite.
    usable : whether all samples are numbers that can be voltages; all else is 0 where they aren't.
    low, high : extremes, uV.
    at_rail : share of pairs of neighbouring samples that both lie at one extreme.
    amplitudes : (n_seconds, n_channels), root mean square in `EEG_HZ`, uV.
    amplitude : the same of an ordinary second.
    noise : root mean square in `NOISE_HZ`, uV.
    line : root mean square of line noise at 50 or 60 Hz, whichever is more, uV.
    levels : (n_levels, n_channels), smoothed over `LEVEL_S`, uV from the window's mean.
    course : (n_seconds, n_per_second, n_channels), the thinned EEG, uV from the window's mean.
    steps : like `course`: change within `JUMP_S` up to each sample, uV.
    spectra : (n_seconds * n_bins, n_channels), complex, in `SHARED_HZ`.
    """

    n_not_finite: Indices
    usable: Mask
    low: Array
    high: Array
    at_rail: Array
    amplitudes: Array
    amplitude: Array
    noise: Array
    line: Array
    levels: Array
    course: Array
    steps: Array
    spectra: NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class Compared:
    """What channels show against their neighbours, (n_channels,) each.

    Attributes
    ----------
    ratio, noise_ratio : amplitude and noise over the neighbours' medians.
    line_around : the neighbours' median line noise, uV.
    drift : range of the level less the neighbours', uV in `DRIFT_S` or less.
    jump : largest step that stands out, beyond what the neighbours do at that time, uV.
    usual_jump : largest step of an ordinary second, uV.
    unexplained : share of the power in `SHARED_HZ` that no mixture of the neighbours gives.
    """

    ratio: Array
    noise_ratio: Array
    line_around: Array
    drift: Array
    jump: Array
    usual_jump: Array
    unexplained: Array


class Meter:
    """Measures windows of one stream; holds what is fixed: bands, taper, who sits next to whom.

    Parameters
    ----------
    channels : names. One of known place has the nearest as neighbours, any other those most like it.
    sfreq : rate, Hz. Raises SetupError when that is too slow for `NOISE_HZ`.
    """

    def __init__(self, channels: Sequence[str], sfreq: float) -> None:
        self._step = max(1, int(sfreq // RATE_HZ))
        self._n_second = round(sfreq / self._step)
        self._hz = fft.rfftfreq(self._n_second, self._step / sfreq)
        if sfreq <= 2 * NOISE_HZ[1]:
            raise SetupError(f"Signal quality needs EEG at more than {2 * NOISE_HZ[1]:g} Hz; this has {sfreq:g} Hz.")
        self._taper = signal.windows.hann(self._n_second, sym=False)[:, None].astype(np.float32)
        where = directions(channels)
        known = np.isfinite(where[:, 0])
        self._placed = known if known.sum() > N_NEIGHBOURS else np.zeros_like(known)
        away = np.nan_to_num(-(where @ where.T), nan=2.0)  # those of unknown place come after all others
        np.fill_diagonal(away, 3.0)
        self._nearest = np.argsort(away, axis=1, kind="stable")[:, :-1]

    @property
    def n_second(self) -> int:
        """Samples of a second."""
        return self._n_second * self._step

    def alone(self, samples: Array) -> Alone:
        """Figures of the newest whole seconds of `samples`, (n_times, n_channels), uV."""
        n_seconds = len(samples) // self.n_second
        samples = samples[len(samples) - n_seconds * self.n_second :]
        with np.errstate(invalid="ignore", over="ignore"):
            means = np.add.reduce(samples.reshape(-1, self._step, samples.shape[1]), axis=1) / self._step
        usable = np.asarray((np.abs(means) < BEYOND_UV).all(axis=0))  # false for NaN, too
        n_not_finite = np.zeros(len(usable), dtype=np.int64)
        n_not_finite[~usable] = (~np.isfinite(samples[:, ~usable])).sum(axis=0)
        points = samples[:: self._step]
        if not usable.all():
            means, points = (np.where(usable, values, 0) for values in (means, points))
        seconds = (means - means.mean(axis=0)).astype(np.float32).reshape(n_seconds, self._n_second, -1)
        power, spectra = self._spectra(seconds)
        amplitudes = np.sqrt(power[:, self._band(EEG_HZ)].sum(axis=1))
        return Alone(
            n_not_finite,
            usable,
            *_extremes(points),
            amplitudes=amplitudes,
            amplitude=np.median(amplitudes, axis=0),
            noise=np.sqrt(np.median(power[:, self._band(NOISE_HZ)].sum(axis=1), axis=0)),
            line=self._line(power),
            levels=_levels(seconds),
            course=seconds,
            steps=_steps(seconds),
            spectra=spectra,
        )

    def compare(self, alone: Alone, sound: Mask) -> Compared:
        """Figures of all channels against neighbours that are `sound`, (n_channels,); at least two must be."""
        # Half way to white, so that neither a blink nor 2 Hz alone makes channels alike: told apart by this, floating
        # channels and the least related real ones lie furthest apart (measured; not at all and wholly are worse).
        usual = np.median(np.abs(alone.spectra[:, sound]), axis=1, keepdims=True)
        correlation = _correlation(alone.spectra / np.sqrt(np.maximum(usual, 1e-9)))
        around = self._neighbours(sound, correlation)
        levels = alone.levels - np.median(alone.levels[:, around], axis=2)
        jump, usual_jump = _jumps(alone.course, alone.steps, around)
        return Compared(
            ratio=alone.amplitude / np.median(alone.amplitude[around], axis=1),
            noise_ratio=alone.noise / np.maximum(np.median(alone.noise[around], axis=1), 1e-6),
            line_around=np.median(alone.line[around], axis=1),
            drift=np.ptp(levels, axis=0) / max(1.0, len(alone.amplitudes) / DRIFT_S),
            jump=jump,
            usual_jump=usual_jump,
            unexplained=_unexplained(correlation, around),
        )

    def _spectra(self, seconds: Array) -> tuple[Array, NDArray[np.complexfloating]]:
        """Power of each second, (n_seconds, n_bins, n_channels) in uV squared, and the spectra in `SHARED_HZ`."""
        centred = seconds - seconds.mean(axis=1, keepdims=True)
        centred *= self._taper
        spectra = fft.rfft(centred, axis=1)
        scale = 2 / (self._n_second * float((self._taper**2).sum()))
        power = (spectra.real**2 + spectra.imag**2) * scale
        return power, spectra[:, self._band(SHARED_HZ)].reshape(-1, spectra.shape[2])

    def _band(self, hz: tuple[float, float]) -> slice:
        # Bins are near whole Hz, not at them, where the rate isn't whole.
        first, last = np.searchsorted(self._hz, (hz[0] - 0.5, hz[1] + 0.5))
        return slice(int(first), int(last))

    def _line(self, power: Array) -> Array:
        """Root mean square at each of `LINES_HZ` and its harmonic above what lies beside, the larger of the two."""
        of_each = []
        for line in LINES_HZ:
            total = np.zeros(power.shape[2])
            for hz in (line, 2 * line):
                peak = int(np.argmin(np.abs(self._hz - hz)))
                if hz + 2 < self._hz[-1]:
                    beside = power[:, [peak - 4, peak - 3, min(peak + 3, power.shape[1] - 1)]].mean(axis=1)
                    excess = power[:, peak - 1 : peak + 2].sum(axis=1) - 3 * beside
                    total += np.median(np.maximum(excess, 0), axis=0)
            of_each.append(np.sqrt(total))
        return np.asarray(np.max(of_each, axis=0))

    def _neighbours(self, sound: Mask, correlation: Array) -> Indices:
        """(n_channels, at most `N_NEIGHBOURS`) indices of sound channels."""
        n_around = min(N_NEIGHBOURS, int(sound.sum()) - 1)
        around = np.empty((len(sound), n_around), dtype=np.int64)
        # A stable sort brings the sound ones of each row to the front, in their order.
        nearest = self._nearest[self._placed]
        first = np.argsort(~sound[nearest], axis=1, kind="stable")[:, :n_around]
        around[self._placed] = np.take_along_axis(nearest, first, axis=1)
        likeness = np.where(sound, np.abs(correlation), -1.0)
        np.fill_diagonal(likeness, -2.0)
        around[~self._placed] = np.argpartition(-likeness[~self._placed], n_around - 1, axis=1)[:, :n_around]
        return around


def _extremes(points: Array) -> tuple[Array, Array, Array]:
    """Lowest, highest, and the share of neighbouring pairs that both lie at one of them."""
    low, high = points.min(axis=0), points.max(axis=0)
    at_low, at_high = points <= low + RAIL_TOLERANCE_UV, points >= high - RAIL_TOLERANCE_UV
    pairs = (np.count_nonzero(at[1:] & at[:-1], axis=0) for at in (at_low, at_high))
    return low, high, np.maximum(*pairs) / (len(points) - 1)


def _levels(seconds: Array) -> Array:
    n_part = seconds.shape[1] // LEVELS_A_SECOND
    parts = seconds[:, : n_part * LEVELS_A_SECOND].reshape(len(seconds), LEVELS_A_SECOND, n_part, -1).mean(axis=2)
    return np.asarray(sliding_window_view(np.median(parts, axis=1), LEVEL_S, axis=0).mean(axis=-1))


def _steps(seconds: Array) -> Array:
    reach = _reach(seconds.shape[1])
    steps = np.zeros_like(seconds)
    run, out = seconds.reshape(-1, seconds.shape[2]), steps.reshape(-1, seconds.shape[2])
    out[reach:] = run[reach:] - run[:-reach]
    return steps


def _reach(n_second: int) -> int:
    return max(1, round(JUMP_S * n_second))


def _jumps(course: Array, steps: Array, around: Indices) -> tuple[Array, Array]:
    """Largest step that stands out, less the neighbours', and the largest of an ordinary second."""
    largest = np.maximum(steps.max(axis=1), -steps.min(axis=1))
    usual = np.quantile(largest, USUAL, axis=0)
    run = course.reshape(-1, course.shape[2])
    jump = np.zeros_like(usual)
    for second, channel in np.argwhere(largest > OUTSTANDING * usual):
        place = int(np.argmax(np.abs(steps[second, :, channel])))
        compared = np.append(around[channel], channel)
        sharp = _beyond_neighbours(steps[second, place, compared])
        held = _beyond_neighbours(_held_step(run[:, compared], second * course.shape[1] + place, course.shape[1]))
        jump[channel] = max(jump[channel], min(sharp, held))
    return jump, usual


def _held_step(run: Array, place: int, n_second: int) -> Array:
    """Level of the `HELD_S` from `place` on, less that of those before the jump that ends there."""
    n_held, reach = max(2, round(HELD_S * n_second)), _reach(n_second)
    before, after = run[max(0, place - reach - n_held + 1) : max(1, place - reach + 1)], run[place : place + n_held]
    return np.asarray(np.median(after, axis=0) - np.median(before, axis=0))


def _beyond_neighbours(values: Array) -> float:
    """How far the last value lies from the median of the others, less three times how far those lie from it."""
    middle = np.median(values[:-1])
    return float(np.abs(values[-1] - middle) - 3 * np.median(np.abs(values[:-1] - middle)))


def _correlation(spectra: NDArray[np.complexfloating]) -> Array:
    real, imaginary = np.ascontiguousarray(spectra.real), np.ascontiguousarray(spectra.imag)
    covariance = (real.T @ real + imaginary.T @ imaginary).astype(np.float64)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-12))
    return np.asarray(covariance / deviation / deviation[:, None])


def _unexplained(correlation: Array, around: Indices) -> Array:
    """One minus the squared multiple correlation of each channel with those around it."""
    among = correlation[around[:, :, None], around[:, None, :]] + RIDGE * np.eye(around.shape[1])
    towards = np.take_along_axis(correlation, around, axis=1)[:, :, None]
    explained = (towards * np.linalg.solve(among, towards)).sum(axis=(1, 2))
    return np.asarray(np.clip(1 - explained, 0, 1))
