"""What eye movements look like, learnt from EEG: blinks and saccades as sources to be regressed out of every channel.

The eyeball is a dipole; when it turns or the lid passes over it, the same pattern of voltages appears over the head,
only larger or smaller (Croft & Barry 2000, doi:10.1016/S0987-7053(00)00055-1). So a few sources, each a weighted sum of
channels, tell how large, and one weight a channel tells how much of it is seen there; ``identity - weights @ sources``
takes it out (`decoder.spatial.ocular`). It has no time in it, so it folds into the spatial matrix.

Frontal electrodes also see the brain. As ``sources @ weights`` is the identity, the corrected EEG has nothing left of
the sources, and so as many dimensions less. A source low-passed first would spare the brain's faster part, but error
potentials are as slow as blinks (2 to 8 Hz), and it would take a second time operator: not offered.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage, signal

from bci_app.errors import SetupError
from decoder.montage import canonical

Array = NDArray[np.float64]

FRONTAL_PAIRS = (("fp1", "fp2"), ("af7", "af8"))
"""Left and right electrodes above the eyes. A pair's mean follows blinks and vertical, its difference horizontal
movements; two pairs at different heights tell blinks from vertical movements."""
_EOG = ("eog", "veo", "heo")
"""A name with one of these in it is an EOG channel."""
BAND_HZ = (1.0, 8.0)
"""Where eye movements have most of their power; alpha and muscles lie above (of five bands tried on simulated people
the one that left least of the movements)."""
LARGE = 8.0
"""Standard deviations of a quiet source at which it is an eye movement (decided: on simulated people 6 and 8 give much
the same weights)."""
QUIET_S, QUIET_SHARE = 0.5, 0.1
"""How quiet a source can be is its spread in stretches this long, s, exceeded by all but this share of them (decided:
also while somebody moves the eyes on purpose a tenth of the time is quiet)."""
MIN_RATIO = 0.25
"""Power that movements must add along a combination of sources, relative to brain and noise there, for it to be
regressed out: in simulated people blinks and gaze to the side add 14 to 57, gaze upwards beside blinks 0.5, chance
0.05."""
AROUND_S = 0.3
"""Seconds around a large sample that belong to the movement (decided: a blink lasts 0.3 s)."""
POP_UV, POP_AROUND_S = 1000.0, 4.0
"""Band-passed samples beyond this in any channel, uV, are no eye movement; they and the filter's ringing, these seconds
around them, are not learnt from (decided)."""
MIN_S = 3.0
"""Fewest seconds of movement that a source can be learnt from, 5 to 10 blinks; at rest there are 10 to 20 a minute
(decided)."""


@dataclass(frozen=True, eq=False)
class Eyes:
    """Ocular sources and how they spread.

    Attributes
    ----------
    sources : float64, (n_sources, n_channels): ``sources @ sample`` is how large each is, in standard deviations of
        what it is while the eyes rest. Combinations of `ocular_sources`, the strongest first.
    weights : float64, (n_channels, n_sources), uV seen for 1 of a source; ``sources @ weights`` is the identity.
    seconds : time with eye movements in it that was learnt from, s; NaN where that isn't known any more.
    """

    sources: Array
    weights: Array
    seconds: float = np.nan


def ocular_sources(channels: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """Names and (n_sources, n_channels) of the sources that these channels allow.

    EOG channels, taken as bipolar, where there are any. Otherwise mean and difference of pairs of frontal electrodes:
    the mean against all other channels' mean, so that an amplifier's reference, with its brain activity, cancels.
    Raises SetupError where there are neither.
    """
    found = {canonical(name): index for index, name in enumerate(channels)}
    eog = [index for index, name in enumerate(channels) if is_eog(name)]
    if eog:
        return tuple(channels[index] for index in eog), np.eye(len(channels))[eog]
    pairs = [pair for pair in FRONTAL_PAIRS if set(pair) <= set(found)]
    frontal = [found[name] for pair in FRONTAL_PAIRS for name in pair if name in found]
    others = np.setdiff1d(np.arange(len(channels)), frontal)
    if not pairs or not len(others):
        raise SetupError(
            f"Eye movements are learnt from EOG channels or from Fp1 and Fp2 (or AF7 and AF8); the {len(channels)} "
            "channels have neither. Add one of them, or leave the ocular correction out."
        )
    names, rows = [], []
    for left, right in pairs:
        total, difference = np.zeros((2, len(channels)))
        total[others] = -1 / len(others)
        total[[found[left], found[right]]] = 0.5
        difference[[found[left], found[right]]] = 0.5, -0.5
        names += [f"{left} + {right}", f"{left} - {right}"]
        rows += [total, difference]
    return tuple(names), np.array(rows)


def eeg_outputs(channels: Sequence[str]) -> NDArray[np.int64]:
    """Indices of the channels that are no EOG: `outputs` of `decoder.spatial.compose`."""
    return np.flatnonzero([not is_eog(name) for name in channels])


def learn_eyes(samples: NDArray[np.floating], sfreq: float, channels: Sequence[str]) -> Eyes:
    """Learn from continuous EEG, of a calibration or of eye movements made on purpose.

    Parameters
    ----------
    samples : (n_times, n_channels), uV, one stretch without gaps, finite; bad channels repaired
        (``samples @ repair.T``).
    sfreq : rate, Hz; above twice the upper edge of `BAND_HZ`.
    channels : names.

    Notes
    -----
    Least squares of channels on sources over the samples with large sources, where eyes rule. What brain and noise add
    there to the two covariances is estimated where the sources are small, and subtracted: without that, weights are
    biased towards the brain's pattern, and up to a fifth of a movement stays (simulated gaze upwards; now 2 to 5 %).

    Raises SetupError without sources, or where there are too few movements to learn from.
    """
    _, candidates = ocular_sources(channels)
    band = signal.butter(4, BAND_HZ, "bandpass", fs=sfreq, output="sos")
    data = signal.sosfiltfilt(band, np.asarray(samples, dtype=np.float64), axis=0)
    moving, quiet = _movements(data @ candidates.T, np.abs(data).max(axis=1) > POP_UV, sfreq)
    seconds = float(moving.sum() / sfreq)
    if seconds < MIN_S or quiet.sum() < MIN_S * sfreq:
        raise SetupError(
            f"There are {seconds:.1f} s of eye movements and {quiet.sum() / sfreq:.1f} s of rest to learn from; "
            f"{MIN_S:g} s of each are needed. Record blinks and movements to all sides for a minute or two, with rests "
            "between, or leave the ocular correction out."
        )
    resting = _covariance(data[quiet], candidates)
    added = _covariance(data[moving], candidates) - resting
    kept = _strong(candidates @ added, candidates @ resting)
    sources, spread = kept @ candidates, added @ kept.T
    return Eyes(sources, spread @ np.linalg.inv(sources @ spread), seconds)


def _movements(course: Array, popped: NDArray[np.bool_], sfreq: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which samples belong to eye movements and which to none: bool, (n_times,) each; (n_times, n_sources) in uV."""
    length = round(QUIET_S * sfreq)
    stretches = course[: len(course) // length * length].reshape(-1, length, course.shape[1])
    spread = np.quantile(stretches.std(axis=1), QUIET_SHARE, axis=0)
    large = (np.abs(course) > LARGE * spread).any(axis=1)
    moving = _around(large, AROUND_S, sfreq)
    popped = _around(popped, POP_AROUND_S, sfreq)
    return moving & ~popped, ~moving & ~popped


def _around(samples: NDArray[np.bool_], seconds: float, sfreq: float) -> NDArray[np.bool_]:
    """Those samples and all within half of `seconds` from them."""
    return np.asarray(ndimage.maximum_filter1d(samples, 2 * round(seconds / 2 * sfreq) + 1))


def _covariance(data: Array, sources: Array) -> Array:
    """Of each channel with each source: (n_channels, n_sources), uV ** 2. Band-passed data have no mean."""
    covariance: Array = data.T @ (data @ sources.T) / len(data)
    return covariance


def _strong(added: Array, resting: Array) -> Array:
    """Combinations of the sources along which eyes rule, (n_kept, n_sources): scaled to a resting power of 1."""
    floor = 1e-9 * np.trace(resting) * np.eye(len(resting))  # a flat source has no power, and is not kept
    ratio, combinations = linalg.eigh((added + added.T) / 2, resting + floor)
    strongest_first = np.argsort(ratio)[::-1]
    return np.asarray(combinations[:, [i for i in strongest_first if ratio[i] >= MIN_RATIO]].T)


def is_eog(name: str) -> bool:
    """Whether a channel of this name is an EOG channel."""
    return any(part in name.lower() for part in _EOG)
