"""What a recorded calibration tells of the eyes: the correction that is learnt from it, or why there is none."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import EyesConfig
from bci_app.errors import SetupError
from bci_app.moves import Decisions, Key, by_bad
from bci_app.recording import Recording
from decoder.eyes import Eyes, eeg_outputs, is_eog, learn_eyes, ocular_sources
from decoder.spatial import repair
from decoder.timeline import piece_edges


@dataclass(frozen=True, eq=False)
class Learnt:
    """What was learnt.

    Attributes
    ----------
    eyes : the sources to be regressed out, or None.
    reason : how much it was learnt from, or why there is nothing, a sentence.
    alone : float64, (n_sources, n_channels), the ocular sources by themselves; None without ocular electrodes.
    seen_by : which electrodes these are, in words: only EOG channels see the eyes alone.
    """

    eyes: Eyes | None
    reason: str
    alone: NDArray[np.float64] | None
    seen_by: str = ""


def learn(recording: Recording, decisions: Decisions, config: EyesConfig) -> Learnt:
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
    eog = [name for name in channels if is_eog(name)]
    seen_by = f"EOG channels {', '.join(eog)}" if eog else "frontal electrodes, which see the brain too"
    if config.correct == "never":
        return Learnt(None, "The configuration leaves the eyes in.", alone, seen_by)
    try:
        eyes = _learn(recording, decisions, config.learn_s)
    except SetupError as error:
        if config.correct == "always":
            raise
        return Learnt(None, str(error), alone, seen_by)
    if not len(eyes.sources):
        return Learnt(None, "No movement of the eyes stands out of the EEG.", alone, seen_by)
    number = len(eyes.sources)
    reason = f"{number} source{'' if number == 1 else 's'} learnt from {eyes.seconds:.0f} s of eye movements."
    return Learnt(eyes, reason, alone, seen_by)


def sources(recording: Recording, decisions: Decisions, learnt: Learnt) -> Callable[[Key], NDArray[np.float64] | None]:
    """From a move to the ocular sources by themselves, with what is bad repaired; None without."""
    channels, alone = recording.eeg.picked, learnt.alone

    def repaired(bad: tuple[str, ...]) -> NDArray[np.float64] | None:
        return None if alone is None else np.ascontiguousarray(alone @ repair(channels, eeg_outputs(channels), bad))

    return by_bad(decisions, repaired)


def _learn(recording: Recording, decisions: Decisions, seconds: float) -> Eyes:
    """Channels that are bad most of the time are repaired; what is no number in the others ends a stretch."""
    eeg = recording.eeg
    times_bad = Counter(name for decision in decisions.values() for name in decision.bad)
    bad = sorted(name for name, n in times_bad.items() if n > len(decisions) / 2)
    good = [index for index, name in enumerate(eeg.picked) if name not in bad]
    microvolts = eeg.in_microvolts(recording.samples)
    strange = np.flatnonzero(~np.isfinite(microvolts)[:, good].all(axis=1))
    stretch = longest_stretch(recording.times, strange)
    n = min(stretch.stop - stretch.start, round(seconds * eeg.sfreq))
    samples = np.asarray(microvolts[stretch.start : stretch.start + n], dtype=np.float64)
    samples[:, [eeg.picked.index(name) for name in bad]] = 0.0  # not even a number, perhaps
    return learn_eyes(samples @ repair(eeg.picked, eeg_outputs(eeg.picked), bad).T, eeg.sfreq, eeg.picked)


def longest_stretch(times: NDArray[np.float64], strange: NDArray[np.int64]) -> slice:
    """The longest stretch over which time runs forward and is never missing for long, without `strange` samples."""
    edges = np.unique(np.concatenate((piece_edges(times), strange, strange + 1)))
    longest = int(np.argmax(np.diff(edges)))
    return slice(int(edges[longest]), int(edges[longest + 1]))
