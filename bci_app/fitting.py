"""Recorded calibration in, decoder file out."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.metrics import truths
from bci_app.moves import Move, cut_moves
from bci_app.progress import Progress
from bci_app.protocol import SessionStart
from bci_app.recording import Recording, read
from bci_app.runs import check_untouched, checksum, eeg_type, read_sidecar
from decoder import calibration, model
from decoder.chain import design
from decoder.epochs import Epoch, Rejection
from decoder.judge import Judge, judge_without


def fit(path: Path, config: Config, allow_damage: bool, progress: Progress) -> dict[str, Any]:
    """Fit a decoder on a recorded calibration and save it beside the recording.

    Returns ``calibration`` (n_moves, n_valid, accuracy, balanced_accuracy, auc, evidence ...) and ``model``, the file's
    path. Raises SetupError when the recording is unusable or holds too few valid epochs.
    """
    progress("reading the recording", 0, 3)
    sidecar = read_sidecar(path)
    recording = read(path, allow_damage, eeg_type(sidecar))
    if not allow_damage:
        check_untouched(path, sidecar)
    recording.eeg.check()
    opening = recording.of(SessionStart)
    if not opening:
        raise SetupError(f"{path} holds no SessionStart message: it isn't a whole run of this experiment.")
    if opening[0][1].task != "calibration":
        raise SetupError(f"{path} is an {opening[0][1].task} run; a decoder is fitted on a calibration. Give that one.")
    progress("cutting epochs", 1, 3)
    judge = judge_without(config, recording.eeg, opening[0][1].session)
    moves = cut_moves(recording, judge.shape)
    features, error = _labelled(recording, judge, moves)
    progress("cross-validating", 2, 3)
    result = calibration.calibrate(features, error, config.classifier)
    fitted = model.make_model(
        result,
        error,
        design(config.chain, recording.eeg.sfreq),
        config.classifier,
        participant=opening[0][1].participant,
        channels=recording.eeg.picked,
        n_rejected=len(moves) - len(error),
        recording_sha256=checksum(path),
    )
    target = _free_name(path)
    model.save(fitted, target)
    progress("done", 3, 3)
    figures = {**_figures(result, moves, len(error)), "evidence": asdict(fitted.info.evidence)}
    return {"calibration": figures, "model": str(target)}


def labelled_features(recording: Recording, config: Config) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Features (n_valid, n_features), uV, of a recording's valid epochs, and whether each move was an error."""
    judge = judge_without(config, recording.eeg, "")
    return _labelled(recording, judge, cut_moves(recording, judge.shape))


def _labelled(recording: Recording, judge: Judge, moves: list[Move]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    known = truths(recording)
    valid = [
        (judge.features(move.result), known[move.episode, move.step])
        for move in moves
        if isinstance(move.result, Epoch) and (move.episode, move.step) in known
    ]
    return np.array([row for row, _ in valid]), np.array([error for _, error in valid], dtype=bool)


def _figures(result: calibration.Calibration, moves: list[Move], n_valid: int) -> dict[str, Any]:
    """Plain accuracy flatters where one class is rare, so balanced accuracy and AUC always stand beside it."""
    tenfold, blocked = result.tenfold.as_dict(), result.blocked.as_dict()
    reasons = Counter(move.result.reason for move in moves if isinstance(move.result, Rejection))
    return {
        "n_moves": len(moves),
        "n_valid": n_valid,
        "n_error": result.tenfold.n_error,
        "n_correct": result.tenfold.n_correct,
        **{name: tenfold[name]["value"] for name in ("accuracy", "balanced_accuracy", "auc")},
        **{name: tenfold[name]["value"] for name in ("hit_rate", "correct_rejection_rate")},
        "tenfold": tenfold,
        "blocked": blocked,
        "rejected": dict(reasons),
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
