"""Recorded calibration in, decoder file out."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.joining import joined, lacks
from bci_app.lookout import Seen
from bci_app.metrics import truths
from bci_app.moves import Key, Move, cut_moves, electrodes, judges
from bci_app.ocular import Learnt, learn, sources
from bci_app.progress import Progress
from bci_app.recording import Recording, read, read_run
from bci_app.runs import checksum, why_not_writable
from decoder import calibration, learning_curve, model
from decoder.chain import design
from decoder.epochs import Epoch, Rejection
from decoder.evidence import held_out_evidence
from decoder.eyes import Eyes, eeg_outputs
from decoder.judge import Judge, judge_without
from decoder.operator import features
from decoder.reliability import predict_session, reliability


def fit(paths: Sequence[Path], config: Config, allow_damage: bool, progress: Progress) -> dict[str, Any]:
    """Fit a decoder on a recorded calibration and save it beside the recording.

    Several are the runs of one that was broken off and gone on with.

    Returns ``calibration`` (n_moves, n_valid, accuracy, balanced_accuracy, auc, evidence ...), ``notes``, what it lacks
    where it was broken off, and ``model``, the file's path.
    Raises SetupError when the recording is unusable or holds too few valid epochs, or no file can be made beside it.
    """
    _check_files(paths)
    progress("reading the recording", 0, 3)
    recording, participant = read_calibrations(paths, allow_damage)
    progress("cutting epochs and cross-validating", 1, 3)
    epochs, result, fitted = decoder_of(recording, participant, config, " ".join(map(checksum, paths)))
    figures = figures_of(epochs, result, fitted.info, config)
    # Saved last: whatever fails before leaves no decoder behind.
    target = _free_name(paths[-1])
    model.save(fitted, target)
    progress("done", 3, 3)
    return {
        "participant": participant,
        "notes": lacks(paths, recording, len(epochs.error)),
        "calibration": figures,
        "advice": _advice(result, config),
        "model": str(target),
    }


def _check_files(paths: Sequence[Path]) -> None:
    """Raise SetupError for what is known before the work: a folder instead of a file, and nowhere to put a decoder."""
    for path in paths:
        if path.is_dir():
            found = sorted(map(str, path.rglob("*_task-calibration_*_eeg.xdf")))
            more = f" and {len(found) - 10} more" if len(found) > 10 else ""
            listed = f"In it are {', '.join(found[:10])}{more}: name one" if found else "There is no calibration in it"
            raise SetupError(f"{path} is a folder; expected the recording of a calibration (.xdf). {listed}.")
    folder = paths[-1].parent
    why = why_not_writable(folder) if folder.is_dir() else ""
    if why:
        raise SetupError(
            f"Can't write a decoder into {folder}: {why}. Unlock the folder, or fit a copy of the recording and its "
            ".json in another one."
        )


@dataclass(frozen=True, eq=False)
class Analysis:
    """A calibration as `fit` looks at it: its epochs, their cross-validation, and the figures that `fit` prints."""

    epochs: "Labelled"
    result: calibration.Calibration
    figures: dict[str, Any]


def analysed(recording: Recording, participant: str, config: Config) -> Analysis:
    """All that `fit` tells, of a recording that is read, and no file of a decoder. Raises SetupError as it does."""
    epochs, result, fitted = decoder_of(recording, participant, config)
    return Analysis(epochs, result, figures_of(epochs, result, fitted.info, config))


def decoder_of(
    recording: Recording, participant: str, config: Config, sha256: str = ""
) -> tuple["Labelled", calibration.Calibration, model.DecoderModel]:
    """The decoder that a calibration gives, with its epochs and their cross-validation. Raises SetupError as `fit`."""
    epochs = labelled(recording, config)
    result = calibration.calibrate(epochs.features, epochs.error, config.classifier, config.chain.n_windows)
    return epochs, result, _model(recording, participant, epochs, result, config, sha256)


def _model(
    recording: Recording,
    participant: str,
    epochs: "Labelled",
    result: calibration.Calibration,
    config: Config,
    sha256: str,
) -> model.DecoderModel:
    return model.make_model(
        result,
        epochs.error,
        design(config.chain, recording.eeg.sfreq),
        config.classifier,
        participant=participant,
        channels=_used(recording.eeg.picked, epochs.eyes.eyes),
        n_rejected=len(epochs.moves) - len(epochs.error),
        eyes=epochs.eyes.eyes,
        on_eyes=epochs.eyes.reason,
        ocular=_by_eyes_alone(epochs, config),
        recording_sha256=sha256,
    )


def figures_of(
    epochs: "Labelled", result: calibration.Calibration, info: model.ModelInfo, config: Config
) -> dict[str, Any]:
    """What `fit` tells of a calibration, in plain numbers."""
    return _figures(result, epochs) | {
        "evidence": asdict(info.evidence),
        "eyes": {"correction": info.eyes, "seen_by": epochs.eyes.seen_by, "alone": info.ocular},
        "reliability": reliability(held_out_evidence(result.blocked_log_odds, epochs.error), epochs.error).as_dict(),
        "session": _session(result, epochs.error, config),
        "learning_curve": _by_block(epochs, config),
    }


def _advice(result: calibration.Calibration, config: Config) -> str:
    gate, balanced = config.policy.gate_accuracy, result.blocked.balanced_accuracy.value
    if balanced >= gate:
        return ""
    return (
        f"The balanced accuracy of {balanced:.1%} over contiguous folds is below the gate of {gate:.0%}: online the "
        "agent will search without verdicts. Look at the electrodes and calibrate again, or go on without."
    )


def read_calibrations(paths: Sequence[Path], allow_damage: bool) -> tuple[Recording, str]:
    """The runs of one calibration as one recording, and the participant's name.

    One that a later one of them went on from may end anywhere. Raises SetupError as `read_calibration` does.
    """
    last = [read_calibration(path, allow_damage or path != paths[-1]) for path in paths]
    names = sorted({name for _, name in last})
    if len(names) > 1:
        raise SetupError(f"These are calibrations of several participants: {', '.join(names)}. Fit them on their own.")
    return joined([recording for recording, _ in last]), names[0]


def read_calibration(path: Path, allow_damage: bool) -> tuple[Recording, str]:
    """A recorded calibration and the participant's name. Raises SetupError when it is unusable, or another task's."""
    recording, opening, _ = read_run(path, allow_damage)
    recording.eeg.check()
    if opening.task != "calibration":
        raise SetupError(f"{path} is an {opening.task} run; a decoder is fitted on a calibration. Give that one.")
    return recording, opening.participant


def _used(channels: list[str], eyes: Eyes | None) -> list[str]:
    """Those a decoder needs of a stream: EOG channels only where the eyes are regressed out by them."""
    return channels if eyes else [channels[index] for index in eeg_outputs(channels)]


@dataclass(frozen=True, eq=False)
class Labelled:
    """A recording's valid epochs with their truth.

    Attributes
    ----------
    moves : all moves; `reasons` why some have no epoch that can be judged.
    valid : those that have one, and a truth.
    features, error : float64, (n_valid, n_features), uV, and bool, (n_valid,), whether each move was an error.
    eyes : the ocular correction that was applied.
    ocular : float64, (n_valid, n_sources * n_windows), the same windows of the ocular sources alone.
    judge_of : from a move's key to the judge that gave its features.
    """

    moves: list[Move]
    reasons: Counter[str]
    valid: list[Move]
    features: NDArray[np.float64]
    error: NDArray[np.bool_]
    eyes: Learnt
    ocular: NDArray[np.float64]
    judge_of: Callable[[Key], Judge]


def labelled(recording: Recording, config: Config) -> Labelled:
    """Cut a calibration's epochs, with the electrodes repaired that were found bad and the eyes regressed out."""
    decisions, known = electrodes(recording), truths(recording)
    eyes = learn(recording, decisions, config.eyes)
    judge = judge_without(config, recording.eeg, "", eyes.eyes)
    judge_of, sources_of = judges(judge, decisions), sources(recording, decisions, eyes)
    moves, valid, rows, by_eyes, error, reasons = [], [], [], [], [], Counter[str]()
    # Stamps that left the clock find samples of another time; whatever came at the wrong time was repeated anyway.
    untimely = {key: verdict.reason or "" for key, verdict in recording.verdicts.items() if verdict.by_time}
    for move, result in cut_moves(recording, judge.shape):
        moves.append(move)
        if move.key in untimely:
            reasons[untimely[move.key]] += 1
            continue
        row = judge_of(move.key).features(result)
        if isinstance(row, Rejection):
            reasons[row.reason] += 1
        elif move.key in known and isinstance(result, Epoch):
            valid.append(move)
            rows.append(row)
            error.append(known[move.key])
            alone = sources_of(move.key)
            if alone is not None:
                by_eyes.append(features(result.data, judge.operator, alone))
    return Labelled(
        moves, reasons, valid, np.array(rows), np.array(error, dtype=bool), eyes, np.array(by_eyes), judge_of
    )


def _by_eyes_alone(epochs: Labelled, config: Config) -> calibration.Scores | None:
    """What the eyes alone tell, in contiguous folds; None without ocular electrodes."""
    if not len(epochs.ocular):
        return None
    folds = calibration.contiguous_folds(epochs.error, config.classifier)
    log_odds = calibration.held_out_log_odds(
        epochs.ocular, epochs.error, config.classifier, folds, config.chain.n_windows
    )
    return calibration.score(log_odds, epochs.error)


def _session(result: calibration.Calibration, error: NDArray[np.bool_], config: Config) -> dict[str, Any]:
    """What an online run may expect, from contiguous folds: `decoder.reliability.Prediction`."""
    stretches = [test for _, test in calibration.contiguous_folds(error, config.classifier)]
    right = (result.blocked_log_odds > 0) == error
    online = config.online
    return predict_session(right, error, stretches, online.expected_moves, online.expected_errors).as_dict()


def look_ahead(paths: Sequence[Path], config: Config) -> Seen:
    """What a calibration whose last run is still being recorded promises. Raises SetupError where it can't be read."""
    recording = joined([read(path, True, config.eeg.stream_type) for path in paths])
    epochs = labelled(recording, config)
    outlook = _outlook(epochs, len(epochs.error), config)
    if outlook is None:
        return Seen("There are too few moves of a kind yet to tell what the calibration is worth.", "")
    worthwhile = config.calibration.worthwhile
    accuracy, gain = outlook.balanced_accuracy.value, 100 * outlook.total_gain.value
    short = f"decoder {accuracy:.0%}, {gain:.1f} points to gain"
    # A decoder at chance has a flat curve too, but there more electrodes, or other ones, may help: the person decides.
    passes = outlook.balanced_accuracy.value >= config.policy.gate_accuracy
    return Seen(learning_curve.sentence(outlook, worthwhile), short, passes and outlook.is_clear(worthwhile))


def _outlook(epochs: Labelled, n: int, config: Config) -> learning_curve.Outlook | None:
    """From the first `n` valid epochs; None where a class has too few, or all of them in one stretch."""
    features, error = epochs.features[:n], epochs.error[:n]
    if min(error.sum(), (~error).sum()) < config.classifier.min_per_class:
        return None
    block = config.calibration.moves_per_block
    try:
        points = learning_curve.measure(features, error, config.classifier, config.chain.n_windows)
    except SetupError:
        return None
    n_left = max(0, block * config.calibration.n_blocks - len(error))
    return learning_curve.outlook(points, len(error), block, n_left)


def _by_block(epochs: Labelled, config: Config) -> dict[str, Any]:
    """What was known after each block's worth of valid epochs: `decoder.learning_curve.Outlook` and a sentence."""
    block, found = config.calibration.moves_per_block, {}
    for n in range(block, len(epochs.error) + 1, block):
        outlook = _outlook(epochs, n, config)
        if outlook is not None:
            sentence = learning_curve.sentence(outlook, config.calibration.worthwhile)
            found[f"after_{n}"] = outlook.as_dict() | {"sentence": sentence}
    return found


def _figures(result: calibration.Calibration, epochs: Labelled) -> dict[str, Any]:
    """Plain accuracy flatters where one class is rare, so balanced accuracy and AUC always stand beside it."""
    tenfold, blocked = result.tenfold.as_dict(), result.blocked.as_dict()
    return {
        "n_moves": len(epochs.moves),
        "n_valid": len(epochs.error),
        "n_error": result.tenfold.n_error,
        "n_correct": result.tenfold.n_correct,
        **{name: tenfold[name]["value"] for name in ("accuracy", "balanced_accuracy", "auc")},
        **{name: tenfold[name]["value"] for name in ("hit_rate", "correct_rejection_rate")},
        "tenfold": tenfold,
        "blocked": blocked,
        "rejected": dict(epochs.reasons),
    }


def _free_name(recording: Path) -> Path:
    """`..._decoder.safetensors` beside the recording, numbered from the second on: nothing is overwritten."""
    stem = recording.name.removesuffix(".xdf").removesuffix("_eeg")
    number = 1
    while True:
        ending = "" if number == 1 else f"-{number}"
        path = recording.with_name(f"{stem}_decoder{ending}{model.SUFFIX}")
        if not path.exists():
            return path
        number += 1
