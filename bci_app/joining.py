"""Several runs of one session as one recording: one that was broken off, and those that went on from it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bci_app.errors import SetupError
from bci_app.protocol import Electrodes, Message, SessionEnd, Verdict
from bci_app.recording import Recording, Stamped
from bci_app.runs import read_sidecar

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


def lacks(paths: Sequence[Path], recording: Recording, n_valid: int) -> list[str]:
    """What a calibration lacks that was broken off, or of whose runs only some are given: a sentence, or none.

    Parameters
    ----------
    paths, recording : its runs that are given, and them as one.
    n_valid : moves of it with an epoch that can be judged.
    """
    sidecar, names, last = read_sidecar(paths[-1]), {path.name for path in paths}, paths[-1]
    beside = {path.name: _continues(path) for path in last.parent.glob("*_task-calibration_*_eeg.xdf")}
    others = {name for path in paths for name in _continues(path)}
    others |= {name for name, before in beside.items() if names & set(before)}
    planned = _planned(sidecar)
    holds = f"{n_valid} valid moves" + (f" of the {planned} that were planned" if planned else "")
    if others - names:
        runs = " ".join(str(last.with_name(name)) for name in sorted(others | names))
        return [f"This is a part of a calibration, {holds}. Fit its runs together: bci-app fit {runs}"]
    ends = recording.of(SessionEnd)
    if (ends and ends[-1][1].reason == "complete") or (planned and n_valid >= planned):
        return []
    if sidecar.get("reason") == "complete":
        return [f"The end of the calibration is missing: there are {holds}. Restore a copy of {last}."]
    return [
        f"The calibration was broken off: it holds {holds}. The same `bci-app calibrate` with --resume goes on with "
        "it; then fit its runs together."
    ]


def _continues(path: Path) -> list[str]:
    """Names of the recordings that a run went on from."""
    try:
        return [str(name) for name in read_sidecar(path).get("continues") or []]
    except SetupError:  # of a run beside, which isn't asked for
        return []


def _planned(sidecar: Mapping[str, Any]) -> int | None:
    """Valid moves that a calibration was to have; None where its sidecar doesn't tell."""
    try:
        settings = sidecar["config"]["calibration"]
        return int(settings["n_blocks"]) * int(settings["moves_per_block"])
    except (KeyError, TypeError, ValueError):
        return None


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
