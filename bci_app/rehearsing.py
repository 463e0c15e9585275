"""A recorded calibration rehearsed: its person without the person, calibrated again and compared."""

import secrets
from dataclasses import asdict, replace
from math import hypot
from pathlib import Path
from typing import Any

from bci_app import fitting, verbs
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.progress import Progress, named
from bci_app.protocol import Truth
from bci_app.recording import Recording
from bci_app.runs import check_label, checksum, free_visit, make_folder
from decoder import rehearsal_file
from decoder.calibration import Calibration, Estimate, calibrate
from decoder.rehearsal import Likeness, learn
from decoder.rehearsal_scale import Watch, scale_for


def rehearse(
    path: Path,
    config: Config,
    participant: str | None,
    map_name: str | None,
    speed: float,
    seed: int | None,
    progress: Progress,
) -> dict[str, Any]:
    """Learn a person from a recorded calibration, calibrate again with that person, and compare.

    Parameters
    ----------
    participant : name of the rehearsal's files; by default the person's with REHEARSAL behind it.
    map_name : of an online run after the calibration; none by default.

    Raises SetupError when the recording is unusable, or has fewer moves than the configuration asks for.
    """
    if map_name is not None:
        load_map(map_name)
    progress("1/4 reading the recording", 0, 1)
    recording, person = fitting.read_calibration(path, allow_damage=False)
    name = check_label(participant if participant is not None else f"{person}REHEARSAL", "--participant")
    if name == person:
        raise SetupError(
            f"--participant {name} is the person themselves: their next session would take the rehearsal's decoder for "
            "theirs. Choose another name."
        )
    visit = free_visit(Path(config.recordings), name)
    wishes = verbs.Wishes(config, name, visit, True, speed, secrets.randbelow(2**31) if seed is None else seed)
    verbs.check(wishes)
    likeness, original = likeness_of(recording, config, named(progress, "1/4 learning the person"))
    file = _save(likeness, config, wishes, person, path)
    simulation = config.simulation.model_copy(update={"rehearse": str(file.absolute()), "background": None})
    wishes = replace(wishes, config=config.model_copy(update={"simulation": simulation}))
    calibrated = verbs.calibrate(wishes, named(progress, "2/4 calibrate"))
    fitted = fitting.fit([Path(calibrated["recording"])], config, False, named(progress, "3/4 fit"))
    outcome = _compared(original, fitted["calibration"]) | {
        "participant": name,
        "errp_size": likeness.scale,
        "errp_spread": likeness.spread,
        "person": str(file),
        "recording": calibrated["recording"],
        "model": fitted["model"],
    }
    if map_name is None:
        return outcome
    wishes = replace(wishes, seed=(wishes.seed or 0) + 1)
    told, _ = verbs.online(wishes, map_name, Path(fitted["model"]), None, True, named(progress, "4/4 online"))
    return outcome | {"online": told["figures"], "online_recording": told["recording"]}


def likeness_of(recording: Recording, config: Config, progress: Progress) -> tuple[Likeness, Calibration]:
    """The person of a calibration, and the calibration's own cross-validation on as many moves as a rehearsal has.

    Raises SetupError when it has fewer moves than that, or no truth.
    """
    if not recording.of(Truth):
        raise SetupError(
            f"{recording.path} doesn't say which moves were errors: it holds no Truth message. Give a recording that "
            "`bci-app calibrate` made."
        )
    progress("cutting epochs", 0, 3)
    epochs = fitting.labelled(recording, config)
    n_asked = config.calibration.n_blocks * config.calibration.moves_per_block
    if len(epochs.moves) < n_asked:
        raise SetupError(
            f"{recording.path} has {len(epochs.moves)} moves, and a rehearsal of {config.calibration.n_blocks} blocks "
            f"x {config.calibration.moves_per_block} moves is asked for: nothing would tell whether it is as good. Set "
            "calibration.n_blocks and calibration.moves_per_block in a --config file, as they were or smaller."
        )
    progress("cross-validating the original", 1, 3)
    n = min(n_asked, len(epochs.error))
    original = calibrate(epochs.features[:n], epochs.error[:n], config.classifier, config.chain.n_windows)
    onsets = [move.onset for move in epochs.valid]
    microvolts = recording.eeg.in_microvolts(recording.samples)
    names = tuple(recording.eeg.picked)
    likeness = learn(microvolts, recording.times, onsets, epochs.error, names, recording.eeg.sfreq)
    progress("finding the ErrP's size", 2, 3)
    # The first moves, as the recording's own decoder looks at them.
    judge_of, valid = epochs.judge_of, epochs.valid
    shape = judge_of(valid[0].key).shape
    watch = Watch(
        onsets[:n], epochs.error[:n], shape, lambda number, epoch: judge_of(valid[number].key).features(epoch)
    )
    accuracy = original.blocked.balanced_accuracy.value
    scale, _ = scale_for(likeness, accuracy, watch, config.classifier, config.chain.n_windows, config.simulation.seed)
    return replace(likeness, scale=scale), original


def _save(likeness: Likeness, config: Config, wishes: verbs.Wishes, person: str, path: Path) -> Path:
    """Into the rehearsal's own visit, for it belongs to that."""
    stem = f"sub-{wishes.participant}_ses-{wishes.visit}"
    folder = Path(config.recordings) / f"sub-{wishes.participant}" / f"ses-{wishes.visit}" / "eeg"
    make_folder(folder, Path(config.recordings))
    file = folder / f"{stem}_person.safetensors"
    rehearsal_file.save(likeness, file, person, checksum(path))
    return file


def _compared(original: Calibration, rehearsal: dict[str, Any]) -> dict[str, Any]:
    """Balanced accuracies over contiguous folds, their difference with its 95 % interval, and whether that has 0 in it.

    The interval is MOVER's, from the two intervals (Zou & Donner 2008, doi:10.1002/sim.3095).
    """
    a = original.blocked.balanced_accuracy
    b = Estimate(**rehearsal["blocked"]["balanced_accuracy"])
    difference = b.value - a.value
    low = difference - hypot(b.value - b.low, a.high - a.value)
    high = difference + hypot(b.high - b.value, a.value - a.low)
    return {
        "original": _flat(a) | {"n_valid": len(original.blocked_log_odds)},
        "rehearsal": _flat(b) | {"n_valid": rehearsal["n_valid"]},
        "difference": _flat(Estimate(difference, low, high)),
        "agrees": low <= 0 <= high,
    }


def _flat(estimate: Estimate) -> dict[str, float]:
    values = asdict(estimate)
    return {"balanced_accuracy": values["value"], "low": values["low"], "high": values["high"]}
