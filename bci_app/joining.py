"""Several runs of one session as one recording: one that was broken off, and those that went on from it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bci_app.errors import SetupError
from bci_app.protocol import Electrodes, Message, Verdict
from bci_app.recording import Recording, Stamped

BETWEEN_S = 10.0
"""Seconds put between two runs: longer than an epoch, and than what electrodes are judged on (decided). How long it
really was may not be known, for LSL's clock starts anew with the computer."""


def joined(recordings: Sequence[Recording]) -> Recording:
    """One after the other, in the order given: times go on, and episodes are numbered on.

    Raises SetupError when their EEG doesn't agree.
    """
    first = recordings[0]
    if len(recordings) == 1:
        return first
    samples, times, messages = [first.samples], [first.times], list(first.messages)
    for following in recordings[1:]:
        _check_same(first, following)
        shift = float(times[-1].max()) + BETWEEN_S - float(following.times.min())
        offset = 1 + max((getattr(item.message, "episode", -1) for item in messages), default=-1)
        samples.append(following.samples)
        times.append(following.times + shift)
        messages += [Stamped(item.stamp + shift, _moved(item.message, shift, offset)) for item in following.messages]
    damage = tuple(sentence for recording in recordings for sentence in recording.damage)
    return replace(
        first,
        samples=np.concatenate(samples),
        times=np.concatenate(times),
        messages=tuple(messages),
        damage=damage,
    )


def _moved(message: Message, shift: float, offset: int) -> Message:
    changes: dict[str, float] = {}
    if hasattr(message, "episode"):
        changes["episode"] = message.episode + offset
    match message:
        case Electrodes(last_time=float() as last):
            changes["last_time"] = last + shift
        case Verdict(first_time=float() as first):
            changes["first_time"] = first + shift
    return message.model_copy(update=changes) if changes else message


def _check_same(first: Recording, other: Recording) -> None:
    for what, a, b in (
        ("channels", first.eeg.channels, other.eeg.channels),
        ("units", first.eeg.units, other.eeg.units),
        ("rate", first.eeg.sfreq, other.eeg.sfreq),
    ):
        if a != b:
            raise SetupError(
                f"{other.path} can't go on from {first.path}: its EEG has other {what}. Fit the two on their own."
            )
