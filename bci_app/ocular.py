"""What a recorded calibration tells of the eyes: the correction that is learnt from it, or why there is none."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import EyesConfig
from bci_app.errors import SetupError
from bci_app.protocol import Electrodes
from bci_app.recording import Recording
from decoder.eyes import Eyes, eeg_outputs, learn_eyes, ocular_sources
from decoder.spatial import repair
from decoder.timeline import segment_starts

GAP_S = 1.0
"""Seconds between two stamps that end a stretch: shorter gaps leave no more trace than a blink (decided)."""


@dataclass(frozen=True, eq=False)
class Learnt:
    """What was learnt.

    Attributes
    ----------
    eyes : the sources to be regressed out, or None.
    reason : how much it was learnt from, or why there is nothing, a sentence.
    alone : float64, (n_sources, n_channels), the ocular sources by themselves; None without ocular electrodes.
    """

    eyes: Eyes | None
    reason: str
    alone: NDArray[np.float64] | None


def learn(recording: Recording, decisions: Mapping[int, Electrodes], config: EyesConfig) -> Learnt:
    """Learn from a recording's longest stretch without gaps.

    Raises SetupError where the configuration says `always` and it can't be done.
    """
    channels = recording.eeg.picked
    try:
        alone: NDArray[np.float64] | None = np.ascontiguousarray(ocular_sources(channels)[1])
    except SetupError as error:
        if config.correct == "always":
            raise
        return Learnt(None, str(error), None)
    if config.correct == "never":
        return Learnt(None, "The configuration leaves the eyes in.", alone)
    try:
        eyes = _learn(recording, decisions, config.learn_s)
    except SetupError as error:
        if config.correct == "always":
            raise
        return Learnt(None, str(error), alone)
    if not len(eyes.sources):
        return Learnt(None, "No movement of the eyes stands out of the EEG.", alone)
    return Learnt(eyes, f"{len(eyes.sources)} sources learnt from {eyes.seconds:.0f} s of eye movements.", alone)


def _learn(recording: Recording, decisions: Mapping[int, Electrodes], seconds: float) -> Eyes:
    eeg = recording.eeg
    stretch = longest_stretch(recording.times, eeg.sfreq)
    n = min(stretch.stop - stretch.start, round(seconds * eeg.sfreq))
    samples = np.asarray(eeg.in_microvolts(recording.samples[stretch.start : stretch.start + n]), dtype=np.float64)
    bad = sorted({name for decision in decisions.values() for name in decision.bad})
    samples[:, [eeg.picked.index(name) for name in bad if name in eeg.picked]] = 0.0  # not even a number, perhaps
    return learn_eyes(samples @ repair(eeg.picked, eeg_outputs(eeg.picked), bad).T, eeg.sfreq, eeg.picked)


def longest_stretch(times: NDArray[np.float64], sfreq: float) -> slice:
    """The longest stretch of samples over which time runs forward and is never missing for `GAP_S`."""
    apart = np.flatnonzero(np.diff(times) > GAP_S) + 1
    edges = np.unique(np.concatenate(([0, len(times)], apart, segment_starts(times))))
    longest = int(np.argmax(np.diff(edges)))
    return slice(int(edges[longest]), int(edges[longest + 1]))
