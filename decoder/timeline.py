"""Sample times as they came: the rate they give, the line they lie on, and the samples missing between them.

Stamps are raw LSL stamps in seconds. Three kinds are met in practice: one even stamp a sample; even stamps within a
chunk whose chunks start a little early or late; and stamps of arrival, 10 us apart within a chunk and then 35 ms to
the next (App-WearableSensing #4). All three must give the same epochs.
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError

Array = NDArray[np.float64]

MAX_JITTER = 0.040
"""Seconds a stamp may lie off the line of its neighbours (decided: a little more than the worst known chunks)."""
_JITTERED = 5  # stamps a second that come late by half a sample, above which a stretch counts as jittered
_LEAST_CHUNKS = 3  # on each side of a gap between jittered chunks


def measured_rate(times: Array) -> float:
    """Samples a second, Hz, from the median time that half the samples take; drop-outs are left out."""
    steps = np.diff(times)
    gap = np.abs(steps) > 2 * MAX_JITTER
    steps[gap] = steps[~gap].mean()
    elapsed = np.concatenate(([0.0], np.cumsum(steps)))
    half = len(times) // 2
    return half / float(np.median(elapsed[half:] - elapsed[:-half]))


def check_rate(times: Array, sfreq: float, name: str, tolerance: float) -> float:
    """The measured rate of stream `name`. Raises SetupError where it is off `sfreq` by more than a share `tolerance`.

    Give it several seconds: stamps of arrival are known to half a chunk only.
    """
    if len(times) < 2 or not times[-1] > times[0]:
        raise SetupError(
            f"Stream '{name}' says {sfreq:g} Hz but its time stands still: {len(times)} samples, all stamped alike. "
            "Check the amplifier's time stamps."
        )
    rate = measured_rate(times)
    if not abs(rate / sfreq - 1) <= tolerance:
        raise SetupError(
            f"Stream '{name}' says {sfreq:g} Hz but delivers {rate:.1f} Hz (more than {tolerance:.1%} off). Check the "
            "amplifier's rate and its connection, or raise eeg.rate_tolerance."
        )
    return rate


def segment_starts(times: Array, previous: float = -np.inf) -> NDArray[np.int64]:
    """Indices at which time runs backwards by more than jitter, so that a new segment starts.

    `previous` is the stamp before the first.
    """
    before = np.concatenate(([previous], times[:-1]))
    return np.flatnonzero(times < before - MAX_JITTER)


def offset_of_line(times: Array, sfreq: float, origin: int) -> float:
    """Seconds by which the line through `times` passes later than ``times[origin]`` does, robustly.

    The line is ``t_i = a + i / sfreq`` with the nominal rate and `a` the median, so it takes the middle of a chunk.
    """
    index = np.arange(len(times)) - origin
    return float(np.median((times - times[origin]) - index / sfreq))


def find_gap(times: Array, sfreq: float) -> tuple[int, float] | None:
    """A place where samples are missing (or doubled), or None.

    Returns
    -------
    (index of the first sample after the gap, number of samples missing) of the clearest gap.

    Notes
    -----
    A stamp's residual from the even line stays the same while nothing is missing. Where a step between stamps is off
    by more than half a sample, the medians of the residuals before and after are compared: they come back after a
    chunk that was late, and don't after a lost sample. Where stamps come late all the time, only the last stamp of
    each chunk is compared, since a chunk arrives when its last sample is there.
    """
    uneven = np.flatnonzero(np.abs(np.diff(times) * sfreq - 1) > 0.5) + 1
    if not len(uneven):
        return None
    residual = (times - times[0]) * sfreq - np.arange(len(times))
    ends = np.flatnonzero(np.diff(times) * sfreq > 1.5)  # the last samples of chunks, the next one being late
    if len(ends) > _JITTERED * len(times) / sfreq:
        step = _step_between_chunks(residual, ends, sfreq)
    else:
        step = _largest_step(residual, uneven, reach=max(1, round(0.1 * sfreq)))
    return step if step is not None and abs(step[1]) > 0.5 else _stray(residual, sfreq)


def _largest_step(
    residual: Array, splits: NDArray[np.int64], reach: int, least: int = 1, scatter: float = 0.0
) -> tuple[int, float] | None:
    """The split with the largest step of the median over `reach` residuals, with at `least` so many on each side.

    A step is only counted as far as it exceeds four times what residuals of this `scatter` give by chance.
    """
    worst = (0, 0.0)
    for k in splits[(splits >= least) & (splits <= len(residual) - least)].tolist():
        before, after = residual[max(0, k - reach) : k], residual[k : k + reach]
        step = float(np.median(after) - np.median(before))
        step = np.copysign(max(0.0, abs(step) - 4 * scatter * sqrt(1 / len(before) + 1 / len(after))), step)
        worst = max(worst, (k, step), key=lambda place: abs(place[1]))
    return worst if worst[1] else None


def _step_between_chunks(residual: Array, ends: NDArray[np.int64], sfreq: float) -> tuple[int, float] | None:
    """The largest step between chunks, given their last samples."""
    if len(ends) < 2 * _LEAST_CHUNKS:
        return None
    of_chunks = residual[ends]
    scatter = float(np.median(np.abs(np.diff(of_chunks))))
    one_second = max(_LEAST_CHUNKS, round(len(ends) * sfreq / len(residual)))
    step = _largest_step(of_chunks, np.arange(len(ends)), one_second, _LEAST_CHUNKS, scatter)
    return (int(ends[step[0] - 1]) + 1, step[1]) if step else None


def _stray(residual: Array, sfreq: float) -> tuple[int, float] | None:
    """The first stamp further off the line than any jitter."""
    off = residual - np.median(residual)
    stray = np.flatnonzero(np.abs(off) > MAX_JITTER * sfreq)
    return (int(stray[0]), float(off[stray[0]])) if len(stray) else None
