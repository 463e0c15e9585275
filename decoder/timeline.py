"""Sample times as they came: the rate they give, the line they lie on, and the samples missing between them.

Stamps are raw LSL stamps in seconds. Three kinds are met in practice: one even stamp a sample; even stamps within a
chunk whose chunks come a little late; and stamps of arrival, 10 us apart within a chunk and then 35 ms to
the next (App-WearableSensing #4). All three must give the same epochs.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from bci_app.errors import SetupError

Array = NDArray[np.float64]

MAX_JITTER = 0.040
"""Seconds a stamp may lie off the line of its neighbours (decided: a little more than the worst known chunks)."""
GAP_S = 1.0
"""Seconds between two stamps that end a piece: shorter gaps leave no more trace than a blink (decided)."""
_UNEVEN = 0.5  # samples: a step off by more isn't one of a clock that is off by some per cent
_MOSTLY_EVEN = 0.1  # share of such steps below which stamps are even but for packets that are lost (decided)
_ODD = 0.02  # samples: a step between stamps off by more is no clock's drift
_EVEN = 4  # odd steps in a stretch, at most, for its stamps to count as even
_TOGETHER = 0.1  # samples: stamps closer than this are of arrival, 10 us apart, and jitter seldom is
_MOSTLY = 0.4  # share of steps that are so close where all stamps are of arrival: half with chunks of two (decided)
_CHANCE = 24.0  # scatters a single chunk may be late by chance (decided: under 1 % false gaps, see the tests)


def measured_rate(times: Array, sfreq: float) -> float:
    """Samples a second, Hz, from the median time that half the samples take; drop-outs are left out.

    Of a stream of nominally `sfreq` Hz: where its stamps are even, any step of more than a sample is a drop-out.
    """
    steps = np.diff(times)
    odd = np.abs(steps * sfreq - 1) > _UNEVEN
    gap = odd if odd.mean() < _MOSTLY_EVEN else np.abs(steps) > 2 * MAX_JITTER
    steps[gap] = steps[~gap].mean()
    elapsed = np.concatenate(([0.0], np.cumsum(steps)))
    half = len(times) // 2
    return half / float(np.median(elapsed[half:] - elapsed[:-half]))


def check_rate(times: Array, sfreq: float, name: str, tolerance: float) -> float:
    """The measured rate of stream `name`. Raises SetupError where it is off `sfreq` by more than a share `tolerance`,
    and more than its stamps let it be known: those of arrival come a chunk at a time.
    """
    if len(times) < 2 or not times[-1] > times[0]:
        raise SetupError(
            f"Stream '{name}' says {sfreq:g} Hz but its time stands still: {len(times)} samples, all stamped alike. "
            "Check the amplifier's time stamps."
        )
    rate = measured_rate(times, sfreq)
    chunk_s = float(np.quantile(np.abs(np.diff(times)), 0.99))
    if not abs(rate / sfreq - 1) <= tolerance + 2 * chunk_s * sfreq / len(times):
        raise SetupError(
            f"Stream '{name}' says {sfreq:g} Hz but delivers {rate:.1f} Hz (more than {tolerance:.1%} off). Check the "
            "amplifier's rate and its connection, or raise eeg.rate_tolerance."
        )
    return rate


def segment_starts(times: Array, previous: float = -np.inf) -> NDArray[np.int64]:
    """Indices at which a new segment starts: time runs backwards by more than jitter, or on by more than `GAP_S`.

    `previous` is the stamp before the first; one that is later than any makes the first sample start a segment.
    """
    before = np.concatenate(([previous], times[:-1]))
    steps = times - np.where(np.isfinite(before), before, np.where(before > 0, times + 1, times))
    return np.flatnonzero((steps < -MAX_JITTER) | (steps > GAP_S))


def piece_edges(times: Array) -> NDArray[np.int64]:
    """Where pieces begin over which time runs forward and is never missing for `GAP_S`, and the end."""
    return np.unique(np.concatenate(([0, len(times)], segment_starts(times)))).astype(np.int64)


def offset_of_line(times: Array, sfreq: float, origin: int) -> float:
    """Seconds by which the line through `times` passes later than ``times[origin]`` does, robustly.

    The line is ``t_i = a + i / sfreq`` with the nominal rate and `a` the median. Of stamps of arrival only the last of
    each chunk counts: the others had been waiting for it.
    """
    offsets = (times - times[origin]) - (np.arange(len(times)) - origin) / sfreq
    steps = np.diff(times) * sfreq
    if np.mean(np.abs(steps) < _TOGETHER) >= _MOSTLY:
        last = np.flatnonzero(steps > 0.5)
        offsets = offsets[last] if len(last) else offsets
    return float(np.median(offsets))


def find_gap(times: Array, sfreq: float) -> tuple[int, float] | None:
    """A place where samples are missing (or doubled), or None.

    Returns
    -------
    (index of the first sample after the gap, number of samples missing) of the clearest gap.

    Notes
    -----
    Stamps come late, never early. So the lowest residuals from the even line, the floor, hardly move while chunks come
    late and catch up, but a lost sample lifts the floor for good. Compared are the floors of the second before and the
    second after each place. Where stamps are even, any step of more than half a sample is a gap. Where they come late
    all the time, a step must also be more than late chunks give by chance, which is little with many chunks each side.

    Measured on stretches of 4.2 s (128 to 2048 Hz, drift to 100 ppm): one sample lost from even stamps is always found;
    of late chunks, a loss of one chunk and at least 5 samples, 0.4 s from both ends, in 100 %. One sample lost from
    late chunks, 1 s from both ends, is found in

    ======================  ==============  ==============  ==============
    lateness of a chunk     blocks of 1, 2  blocks of 5     blocks of 16
    ======================  ==============  ==============  ==============
    up to 1 ms              100 %           100 %           96 to 100 %
    up to 5 ms              100 %           90 to 100 %     1 to 9 %
    exponential, 1 ms       100 %           100 %           72 to 98 %
    exponential, 3 ms       100 %           94 to 100 %     0 to 15 %
    exponential, 10 ms      78 to 100 %     0 to 8 %        0 %
    ======================  ==============  ==============  ==============

    and from stamps of arrival every 35 +- 1 ms in 82 to 100 % to 500 Hz, 46 to 50 % at 1000 Hz, 5 to 12 % at 2048 Hz.
    """
    residual = (times - times[0]) * sfreq - np.arange(len(times))
    change = np.diff(residual)
    if not np.any(np.abs(change) > 0.5):
        return None
    if np.count_nonzero(np.abs(change) > _ODD) > _EVEN:
        gap = _gap_between_chunks(residual, np.flatnonzero(change > _ODD), sfreq)
    else:
        gap = _gap_in_even(residual, change, sfreq)
    return gap or _stray(residual, sfreq)


def _gap_in_even(residual: Array, change: Array, sfreq: float) -> tuple[int, float] | None:
    """The largest step of the floor where `change`, from stamp to stamp, is odd; the clock's drift is taken out."""
    level = residual - np.median(change) * np.arange(len(residual))
    step = np.where(np.abs(change) > _ODD, _floor_steps(level, round(sfreq)), 0.0)
    k = int(np.argmax(np.abs(step)))
    return (k + 1, float(step[k])) if abs(step[k]) > 0.5 else None


def _gap_between_chunks(residual: Array, last: NDArray[np.int64], sfreq: float) -> tuple[int, float] | None:
    """The clearest step of the floor between chunks that come late, given the `last` sample of each.

    A chunk arrives when its last sample is there, so that stamp is its lowest. The earliest of `n` chunks is late by
    about ``1 / n`` of what one is. Samples after the last whole chunk are left out.
    """
    level = residual[last]
    if len(level) < 2:
        return None
    reach = int(np.clip(round(len(level) * sfreq / len(residual)), 1, len(level) - 1))
    step = _floor_steps(level, reach)
    n_before = np.arange(1, len(level))
    n_chunks = np.minimum(np.minimum(n_before, n_before[::-1]), reach)
    excess = np.abs(step) - _CHANCE * _scatter(level, reach) / n_chunks
    k = int(np.argmax(excess))
    return (int(last[k]) + 1, float(step[k])) if excess[k] > 0.5 else None


def _scatter(level: Array, reach: int) -> float:
    """How far apart two chunks lie, in the median: neighbours, or half a `reach` apart where the level creeps."""
    return max(float(np.median(np.abs(level[apart:] - level[:-apart]))) for apart in (1, max(1, reach // 2)))


def _floor_steps(level: Array, reach: int) -> Array:
    """The lowest of the `reach` levels after each place between two levels, less the lowest of those before it."""
    shift = (reach - 1) // 2
    before = minimum_filter1d(level, reach, mode="nearest", origin=shift)
    after = minimum_filter1d(level[::-1], reach, mode="nearest", origin=shift)[::-1]
    steps: Array = after[1:] - before[:-1]
    return steps


def _stray(residual: Array, sfreq: float) -> tuple[int, float] | None:
    """The first stamp further off the line than any jitter."""
    off = residual - np.median(residual)
    stray = np.flatnonzero(np.abs(off) > MAX_JITTER * sfreq)
    return (int(stray[0]), float(off[stray[0]])) if len(stray) else None
