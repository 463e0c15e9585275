"""The regular grid that BIDS, BrainVision and EEGLAB know, and where a recording leaves it.

A recording keeps each sample with its own stamp. The other formats number samples: sample `k` is at ``k / sfreq``. So
all samples are kept, in their order, and an event is put at the number of the sample that the decoder took for it.
Where samples are missing, those on either side become neighbours, and the place is marked.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.epochs import Shape, rows_of
from decoder.timeline import find_gap

Array = NDArray[np.float64]

WINDOW_S = 4.2
"""Seconds of stamps that are looked at together: those `find_gap` was measured on."""
_FEWEST = 8  # stamps: fewer tell nothing


@dataclass(frozen=True)
class Gap:
    """Samples that are missing: `n_lost` of them before the sample in `row`; negative where samples came twice or time
    ran backwards."""

    row: int
    n_lost: int


def gaps(times: Array, sfreq: float) -> list[Gap]:
    """The places of a whole recording at which samples are missing, from its raw stamps (n_times,) in s."""
    window, found, start = round(WINDOW_S * sfreq), [], 0
    while start + _FEWEST < len(times):
        stop = min(start + window, len(times))
        here = [Gap(start + row, n_lost) for row, n_lost in _in_window(times[start:stop], sfreq)]
        found += here
        # Windows overlap, for a gap near an edge shows less; but one that was found is never looked at again.
        start = here[-1].row if here else start + window // 2
    return found


def _in_window(times: Array, sfreq: float) -> Iterator[tuple[int, int]]:
    """Rows and sizes of the gaps in one window, the earliest first: the clearest, and those before it."""
    if len(times) < _FEWEST:
        return
    gap = find_gap(times, sfreq)
    if gap is None:
        return
    row, size = gap[0], round(gap[1])
    if 0 < row < len(times):
        yield from _in_window(times[:row], sfreq)
        if size:
            yield row, size


def rows(times: Array, stamps: Sequence[float], shape: Shape) -> list[int]:
    """The row of the sample at each stamp, both on the EEG's clock, in s: the decoder's, and where it has none the one
    whose stamp is nearest, so that what was said before the first sample is at row 0."""
    placed = rows_of(times, stamps, shape)
    return [
        int(np.argmin(np.abs(times - stamp))) if row is None else row for row, stamp in zip(placed, stamps, strict=True)
    ]
