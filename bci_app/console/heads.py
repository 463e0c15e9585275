"""Where electrodes are on the head map, and how large what they deliver is. Pure."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from decoder.eyes import is_eog
from decoder.montage import directions

LOOK_S = 2.0
"""Session seconds of EEG that amplitudes are measured on (decided)."""


def places(channels: Sequence[str]) -> list[tuple[float, float] | None]:
    """(right, front) of each electrode seen from above: the vertex at (0, 0), the head's rim, through the ears, at 1.

    Azimuthal equidistant, as EEG maps are drawn: the distance from the middle is the angle from the vertex. None for
    EOG and names that aren't of the 10-05 system.
    """
    found: list[tuple[float, float] | None] = []
    for name, (right, front, up) in zip(channels, directions(channels), strict=True):
        if not np.isfinite(up) or is_eog(name):
            found.append(None)
            continue
        radius = np.arccos(np.clip(up, -1, 1)) / (np.pi / 2)
        azimuth = np.arctan2(front, right)
        found.append((round(float(radius * np.cos(azimuth)), 3), round(float(radius * np.sin(azimuth)), 3)))
    return found


def amplitudes(samples: NDArray[np.floating]) -> list[float | None]:
    """Standard deviation of each channel about its own line, uV: (n_times, n_channels) in; None where not finite."""
    if len(samples) < 2:
        return [None] * samples.shape[1]
    finite = np.isfinite(samples).all(axis=0)
    deviation = np.full(samples.shape[1], np.nan)
    if finite.any():
        deviation[finite] = signal.detrend(np.asarray(samples[:, finite], np.float64), axis=0).std(axis=0)
    return [round(float(value), 2) if np.isfinite(value) else None for value in deviation]


def head(
    channels: Sequence[str],
    where: Sequence[tuple[float, float] | None],
    uv: Sequence[float | None],
    bad: dict[str, list[str]],
) -> list[dict[str, Any]]:
    """One row an electrode: its name, place, amplitude and faults."""
    return [
        {"name": name, "place": place, "uv": amplitude, "faults": bad.get(name, [])}
        for name, place, amplitude in zip(channels, where, uv, strict=True)
    ]
