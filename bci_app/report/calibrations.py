"""What a calibration showed, as rows: of the figures that `bci-app fit` tells, and of what they were computed from."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.report import Row
from decoder.calibration import score, wilson
from decoder.reliability import reliability

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

MEASURES = ("accuracy", "balanced_accuracy", "auc", "hit_rate", "correct_rejection_rate")
FOLDS = {"tenfold": "tenfold", "blocked": "contiguous"}
"""What the figures call them, and the report."""


def score_rows(figures: Mapping[str, Any], source: str, **where: object) -> list[Row]:
    """A row for each measure of `decoder.calibration.Scores` as plain numbers, with its 95 % interval."""
    n = {"n_error": figures["n_error"], "n_correct": figures["n_correct"]}
    return [{**where, "source": source, "measure": name, **figures[name], **n} for name in MEASURES]


def counts_of(figures: Mapping[str, Any], source: str, **where: object) -> Row:
    """The confusion of held-out verdicts: counts, from the rates of `Scores` as plain numbers."""
    n_error, n_correct = figures["n_error"], figures["n_correct"]
    hits = round(figures["hit_rate"]["value"] * n_error)
    rejections = round(figures["correct_rejection_rate"]["value"] * n_correct)
    counts = {"hits": hits, "misses": n_error - hits, "false_alarms": n_correct - rejections}
    return {**where, "source": source, **counts, "correct_rejections": rejections}


def roc_rows(log_odds: Array, error: Labels, source: str, **where: object) -> list[Row]:
    """The ROC curve: shares of errors and of correct moves that are called errors from each log odds on.

    Nothing unless there are both kinds. ``log_odds`` None is the corner where nothing is called an error.
    """
    if error.all() or not error.any():
        return []
    order = np.argsort(-log_odds, kind="stable")
    hits, alarms = np.cumsum(error[order]) / error.sum(), np.cumsum(~error[order]) / (~error).sum()
    last = np.append(np.diff(log_odds[order]) != 0, True)  # of equal values only all together can be called so
    points = [(0.0, 0.0, None), *zip(alarms[last], hits[last], log_odds[order][last], strict=True)]
    return [
        {
            **where,
            "source": source,
            "false_alarm_rate": float(alarm),
            "hit_rate": float(hit),
            "log_odds": None if at is None else float(at),
        }
        for alarm, hit, at in points
    ]


def reliability_rows(found: Mapping[str, Any], source: str, **where: object) -> list[Row]:
    """The bins of `decoder.reliability.Reliability` as plain numbers, with Wilson's intervals."""
    rows = []
    for each in found["bins"]:
        share = wilson(round(each["happened"] * each["n"]), each["n"])
        rows.append({**where, "source": source, **each, "low": share.low, "high": share.high})
    return rows


def curve_rows(found: Mapping[str, Any], **where: object) -> list[Row]:
    """The learning curve: what was known after each block (`decoder.learning_curve.Outlook` as plain numbers)."""
    rows = []
    for outlook in found.values():
        row = {**where, "n_epochs": outlook["n_epochs"]}
        for name in ("balanced_accuracy", "next_gain", "total_gain"):
            row |= {
                f"{name}{'' if key == 'value' else '_' + key}": outlook[name][key] for key in ("value", "low", "high")
            }
        rows.append(row | {"sentence": outlook["sentence"]})
    return rows


def judged_online(log_odds: Array, evidence: Array, error: Labels) -> dict[str, Any] | None:
    """Scores, and reliability where evidence is known, of verdicts given online; None unless both kinds occurred twice.

    ``evidence`` may hold NaN: a decoder of protocol 1 gave none.
    """
    if min(error.sum(), (~error).sum()) < 2:
        return None
    found = score(log_odds, error).as_dict()
    return found | {"reliability": None if np.isnan(evidence).any() else reliability(evidence, error).as_dict()}
