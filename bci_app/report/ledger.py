"""The latency ledger: what the loop adds between a move and the next, stage by stage."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bci_app.metrics import latency_samples
from bci_app.one_clock import on_one_clock
from bci_app.protocol import ACTION_CODES, Action, LateFrame, MoveOnset, Verdict
from bci_app.recording import Recording
from bci_app.report import Row

WHAT = {
    "verdict": "from the arrival of a move's last EEG sample at the decoder to its verdict",
    "action": "from the verdict to the action, each as it was sent",
    "policy": "from the verdict's arrival at the policy to the action",
    "verdict after onset": "from the flip to the verdict, in session time (N ms a real one at speed N): 600 are needed",
    "time left": "from the action to the flip of its move, in session time: what the loop had to spare",
    "marker": "of the int32 marker from the flip, in session time",
    "late frame": "pictures that came later than they were due",
}
"""The ledger's entries, in words. Real ms where nothing else is said."""


def samples(recording: Recording, speed: float) -> dict[str, list[float]]:
    """Each entry's numbers, ms; `speed` is the session's. What a recording can't tell is empty, as what lies between
    two machines' stamps whose clocks it doesn't compare."""
    placed, unknown = on_one_clock(recording)
    onsets = {(move.episode, move.step): stamp for stamp, move in placed.of(MoveOnset)}
    said = {(verdict.episode, verdict.step): stamp for stamp, verdict in placed.of(Verdict)}
    acted = {(action.episode, action.step): stamp for stamp, action in placed.of(Action)}
    if unknown & {"stimulus", "decoder"}:
        said = {}
    if unknown & {"stimulus", "policy"}:
        acted = {}
    # A calibration's moves aren't waited for: the stimulus chooses them.
    return latency_samples([recording], speed) | {
        "verdict after onset": [1e3 * (said[key] - onset) for key, onset in onsets.items() if key in said],
        "time left": [1e3 * (onset - acted[key]) for key, onset in onsets.items() if key in acted],
        "marker": _markers(recording, np.array([stamp for stamp, _ in recording.of(MoveOnset)])),
        "late frame": [late.late_ms for _, late in recording.of(LateFrame)],
    }


def ledger_rows(found: Sequence[dict[str, list[float]]], **where: object) -> list[Row]:
    """One row an entry, of all `samples` together: how many, median, 95th and 99th percentile, least and most, ms."""
    rows = []
    for name in WHAT:
        values = np.array([value for each in found for value in each.get(name, [])])
        if len(values):
            median, most, nearly_all = np.percentile(values, (50, 95, 99)).tolist()
            spread = {"min_ms": float(values.min()), "max_ms": float(values.max())}
            numbers = {"n": len(values), "p50_ms": median, "p95_ms": most, "p99_ms": nearly_all}
            spread = {"min_ms": float(values.min()), "max_ms": float(values.max())}
            rows.append({**where, "what": name, **numbers, **spread})
    return rows


def _markers(recording: Recording, onsets: NDArray[np.float64]) -> list[float]:
    """How far each move's marker, the nearest of a move, is stamped from its flip."""
    stamps = np.array([stamp for stamp, code in recording.markers if code in ACTION_CODES.values()])
    if not len(stamps):
        return []
    return [float(1e3 * np.abs(stamps - onset).min()) for onset in onsets]
