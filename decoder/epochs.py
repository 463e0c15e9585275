"""Epochs cut from raw samples by raw time stamps: live through `EpochBuffer`, from a recording through `cut_recording`.

Both end in `locate`, which looks at samples at fixed places around the onset and at nothing else, so an epoch is the
same to the bit however the samples were chunked, whenever the marker came, and whatever else is buffered. Only times
are looked at, for gaps; what is in the samples is the affair of `decoder.judge`.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError
from decoder.timeline import MAX_JITTER, find_gap, offset_of_line, segment_starts

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Shape:
    """What an epoch must look like.

    Attributes
    ----------
    sfreq : float, nominal rate, Hz.
    n_before, n_after : int, samples before the onset's sample, and from it on.
    """

    sfreq: float
    n_before: int
    n_after: int

    @property
    def n_raw(self) -> int:
        """Samples in an epoch."""
        return self.n_before + self.n_after


@dataclass(frozen=True, eq=False)
class Epoch:
    """The raw EEG around one onset.

    Attributes
    ----------
    data : float64, (n_raw, n_channels), uV, C-contiguous; row ``n_before`` is the sample nearest to the onset. From a
        float64 recording it is a view of it: 2000 epochs of an hour don't fill the memory.
    first_time, last_time : float, raw stamps of the first and last sample, s.
    """

    data: Array
    first_time: float
    last_time: float

    @property
    def n_samples(self) -> int:
        """Samples in the epoch."""
        return len(self.data)


@dataclass(frozen=True)
class Rejection:
    """An onset without an epoch, and why; `by_time` when it was not the samples but when they, or it, came."""

    reason: str
    by_time: bool = False


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of a stream over which time runs forward and is never missing for a second, or what is
    still buffered of it.

    Attributes
    ----------
    samples : (n_times, n_channels), uV.
    times : float64, (n_times,), raw stamps, s.
    latest : float64, (n_times,), running maximum of the segment's stamps: sorted even where stamps jitter.
    first_time : float, stamp of the segment's first sample, buffered or not.
    trimmed : whether the segment's beginning is no longer buffered.
    follows : whether there was another before it.
    closed : whether no sample can follow any more.
    """

    samples: NDArray[np.floating]
    times: Array
    latest: Array
    first_time: float
    trimmed: bool
    follows: bool
    closed: bool


def locate(segments: Sequence[Segment], onset: float, shape: Shape) -> Epoch | Rejection | None:
    """The epoch around an onset, or why there is none, or None while samples are still to come.

    The onset belongs to the first segment that runs from before it to after it.
    """
    for segment in segments:
        if segment.first_time < onset <= segment.latest[-1]:
            return _cut(segment, onset, shape)
    # What runs on here may still come back, for clocks are set: a replay knows of that, and then finds an epoch.
    if segments and onset <= segments[-1].first_time:
        begins = "gap: the EEG goes on" if segments[-1].follows else "the EEG begins"
        return Rejection(f"{begins} {segments[-1].first_time - onset:.3f} s after the onset", by_time=True)
    return None


def cut_recording(
    samples: NDArray[np.floating], times: Array, onsets: Sequence[float], shape: Shape
) -> list[Epoch | Rejection]:
    """As `cut_one_by_one`, all at once: as large as the recording in float64."""
    return list(cut_one_by_one(samples, times, onsets, shape))


def cut_one_by_one(
    samples: NDArray[np.floating], times: Array, onsets: Sequence[float], shape: Shape
) -> Iterator[Epoch | Rejection]:
    """Cut a whole recording: (n_times, n_channels) uV and raw stamps; one result an onset, in order, each made when it
    is asked for.

    `onsets` are on the clock of the EEG's stamps, s.
    """
    segments = [segment for _, segment in _segments_of(samples, times)]
    never = Rejection("the EEG ends before the onset")
    for onset in onsets:
        yield locate(segments, onset, shape) or never


def rows_of(times: Array, onsets: Sequence[float], shape: Shape) -> list[int | None]:
    """The row of a recording's sample that is nearest to each onset, placed as an epoch's is; None where an epoch
    couldn't be placed, for the stamps end, begin or leave a gap there."""
    segments = list(_segments_of(np.empty((len(times), 0)), times))
    found: list[int | None] = []
    for onset in onsets:
        row = None
        for start, segment in segments:
            if segment.first_time < onset <= segment.latest[-1]:
                placed = _row_of(segment, onset, shape)
                row = start + placed if isinstance(placed, int) else None
                break
        found.append(row)
    return found


def _segments_of(samples: NDArray[np.floating], times: Array) -> Iterator[tuple[int, Segment]]:
    """A recording's segments, and the row at which each begins."""
    for a, b in pairwise([0, *segment_starts(times).tolist(), len(times)]):
        if b > a:
            latest = np.maximum.accumulate(times[a:b])
            yield a, Segment(samples[a:b], times[a:b], latest, float(times[a]), False, a > 0, True)


def _cut(segment: Segment, onset: float, shape: Shape) -> Epoch | Rejection | None:
    row = _row_of(segment, onset, shape)
    if not isinstance(row, int):
        return row
    stretch = slice(row - shape.n_before, row + shape.n_after)
    outside = _outside(segment, stretch, onset)
    if outside is not None:
        return outside
    if stretch.stop > len(segment.times):
        return None
    return _whole(segment.samples[stretch], segment.times[stretch], shape)


def _row_of(segment: Segment, onset: float, shape: Shape) -> int | Rejection | None:
    """The segment's row that is nearest to the onset, or why there is none, or None while samples are still to come."""
    crossing = int(np.searchsorted(segment.latest, onset))
    # Half a second on either side places the onset: symmetric, so that a rate slightly off nominal hardly matters.
    half = round(0.5 * shape.sfreq)
    around = slice(crossing - min(half, shape.n_before), crossing + min(half, shape.n_after))
    outside = _outside(segment, around, onset)
    if outside is not None:
        return outside
    if around.stop > len(segment.times):
        return None
    offset = offset_of_line(segment.times[around], shape.sfreq, crossing - around.start)
    late = float(segment.times[crossing] + offset - onset)
    if abs(late) > MAX_JITTER + 0.5 / shape.sfreq:
        return Rejection(f"gap: no sample within {MAX_JITTER * 1000:.0f} ms of the onset")
    return crossing - round(late * shape.sfreq)


def _outside(segment: Segment, stretch: slice, onset: float) -> Rejection | None:
    """Samples that are not there and never will be."""
    missing = max(0, -stretch.start)
    if missing and segment.trimmed:
        return Rejection(f"the onset came too late: {missing} of its samples are no longer buffered", by_time=True)
    if missing and segment.follows:
        return Rejection(f"gap: the EEG goes on only {onset - segment.first_time:.3f} s before the onset")
    if missing:
        return Rejection(f"the EEG begins only {onset - segment.first_time:.3f} s before the onset", by_time=True)
    if stretch.stop > len(segment.times) and segment.closed:
        return Rejection(f"gap: the EEG ends, or its time jumps, {segment.latest[-1] - onset:.3f} s after the onset")
    return None


def _whole(samples: NDArray[np.floating], times: Array, shape: Shape) -> Epoch | Rejection:
    gap = find_gap(times, shape.sfreq)
    if gap is not None:
        place = (gap[0] - shape.n_before) / shape.sfreq
        # How long a stream was away depends on who reconnected when, and that a replay can't know.
        size = f"{gap[1]:+.1f} samples" if abs(gap[1]) < shape.sfreq else "more than a second"
        return Rejection(f"gap: {size} {place:+.3f} s from the onset")
    return Epoch(np.ascontiguousarray(samples, dtype=np.float64), float(times[0]), float(times[-1]))


class EpochBuffer(Generic[Key]):
    """The trailing seconds of a stream, and the onsets whose epochs are still to be cut from it.

    Parameters
    ----------
    shape : what an epoch must look like.
    n_channels : channels of the stream.
    capacity_s : seconds of samples kept; SetupError when an epoch and two seconds don't fit.
    """

    def __init__(self, shape: Shape, n_channels: int, capacity_s: float) -> None:
        self._capacity = round(capacity_s * shape.sfreq)
        if self._capacity < shape.n_raw + 2 * shape.sfreq:
            raise SetupError(
                f"A buffer of {capacity_s:g} s is too short for epochs of {shape.n_raw / shape.sfreq:.2f} s and two "
                "seconds more. Raise eeg.buffer_s."
            )
        self._shape = shape
        self._samples = np.empty((2 * self._capacity, n_channels))
        self._times = np.empty(2 * self._capacity)
        self._latest = np.empty(2 * self._capacity)
        self._end = 0  # of the filled rows
        self._starts: list[tuple[int, float]] = []  # row and first stamp of each segment; negative rows are gone
        self._n_starts = 0  # segments there have been
        self._waiting: dict[Key, float] = {}
        self._known: set[Key] = set()
        self._finished: list[tuple[Key, Epoch | Rejection]] = []

    def push(self, samples: NDArray[np.floating], times: Array) -> None:
        """Take in a chunk: (n_times, n_channels) in uV and (n_times,) raw stamps in s."""
        piece = max(1, round(self._shape.sfreq))  # epochs are cut before a long chunk could push them out
        for start in range(0, len(times), piece):
            self._append(samples[start : start + piece], times[start : start + piece])
            self._settle()

    def expect(self, key: Key, onset: float) -> bool:
        """Cut an epoch around `onset` (s, on the clock of the stamps). False, and ignored, for a key known already.

        An onset that the stream's clock never reaches waits until `abandon`.
        """
        if key in self._known:
            return False
        self._known.add(key)
        self._waiting[key] = onset
        self._settle()
        return True

    def know(self, key: Key) -> None:
        """A move that needs no epoch any more: `expect` will ignore it."""
        self._known.add(key)

    def done_with(self, is_over: Callable[[Key], bool]) -> None:
        """Moves so long ago that nobody announces them again: those that wait for nothing needn't be known any more."""
        self._known = {key for key in self._known if key in self._waiting or not is_over(key)}

    def forget(self, void: Callable[[Key], bool]) -> None:
        """Moves that haven't happened: their epochs aren't cut, and their keys may be used anew."""
        self._known = {key for key in self._known if not void(key)}
        self._waiting = {key: onset for key, onset in self._waiting.items() if not void(key)}
        self._finished = [(key, result) for key, result in self._finished if not void(key)]

    def poll(self) -> list[tuple[Key, Epoch | Rejection]]:
        """What has been finished since the last call."""
        finished, self._finished = self._finished, []
        return finished

    def abandon(self, reason: str) -> None:
        """Reject every onset still waiting; `poll` returns them."""
        self._finished += [(key, Rejection(reason, by_time=True)) for key in self._waiting]
        self._waiting.clear()

    def trailing(self, n: int) -> tuple[NDArray[np.floating], Array]:
        """The newest samples over which time runs forward, up to `n`: (n_times, n_channels) and (n_times,), views."""
        kept = max(0, self._end - self._capacity, self._end - n, self._starts[-1][0] if self._starts else 0)
        return self._samples[kept : self._end], self._times[kept : self._end]

    @property
    def n_waiting(self) -> int:
        """Onsets whose samples are still to come."""
        return len(self._waiting)

    def _append(self, samples: NDArray[np.floating], times: Array) -> None:
        n_new = len(times)
        if self._end + n_new > len(self._times):
            self._move_to_front()
        new = slice(self._end, self._end + n_new)
        self._samples[new], self._times[new] = samples, times
        previous = self._times[self._end - 1] if self._end else np.inf  # the very first sample starts a segment
        for row in (self._end + segment_starts(self._times[new], previous)).tolist():
            self._starts.append((row, float(self._times[row])))
            self._n_starts += 1
        self._end += n_new
        self._update_latest(new)

    def _update_latest(self, new: slice) -> None:
        starts = {row for row, _ in self._starts}
        edges = sorted({new.start, new.stop} | {row for row in starts if row > new.start})
        for a, b in pairwise(edges):
            np.maximum.accumulate(self._times[a:b], out=self._latest[a:b])
            if a not in starts:
                np.maximum(self._latest[a:b], self._latest[a - 1], out=self._latest[a:b])

    def _move_to_front(self) -> None:
        drop = self._end - self._capacity
        for array in (self._samples, self._times, self._latest):
            array[: self._capacity] = array[drop : self._end]
        self._end = self._capacity
        moved = [(row - drop, first) for row, first in self._starts]
        # Of the segments that begin before the kept rows only the last one reaches into them.
        self._starts = moved[max(0, sum(row <= 0 for row, _ in moved) - 1) :]

    def _segments(self) -> list[Segment]:
        """The buffered parts, oldest first; exactly the trailing capacity, whatever else is in memory."""
        kept = max(0, self._end - self._capacity)
        segments, n_gone = [], self._n_starts - len(self._starts)
        for i, (row, first_time) in enumerate(self._starts):
            closed = i + 1 < len(self._starts)
            rows = slice(max(row, kept), self._starts[i + 1][0] if closed else self._end)
            if rows.start < rows.stop:
                views = self._samples[rows], self._times[rows], self._latest[rows]
                segments.append(Segment(*views, first_time, row < kept, n_gone + i > 0, closed))
        return segments

    def _settle(self) -> None:
        if not self._waiting or not self._end:
            return
        segments = self._segments()
        for key, onset in list(self._waiting.items()):
            result = locate(segments, onset, self._shape)
            if result is not None:
                del self._waiting[key]
                # A copy: the buffer's rows are going to be used again.
                kept = replace(result, data=result.data.copy()) if isinstance(result, Epoch) else result
                self._finished.append((key, kept))
