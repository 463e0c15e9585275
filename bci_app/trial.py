"""A few moves for real, before a participant comes: the lab's EEG through every process and into a recording."""

import secrets
import shutil
import tempfile
from pathlib import Path
from typing import Any

from bci_app import metrics, verbs
from bci_app import replay as replaying
from bci_app.config import Config, changed
from bci_app.errors import LinkLost, SetupError
from bci_app.progress import Progress
from bci_app.protocol import Verdict
from bci_app.recording import read

PARTICIPANT = "DOCTOR"
N_MOVES = 3
"""Moves of the trial, each of some three seconds."""
SOON_MS = 100.0
"""Milliseconds from a move's last sample to its verdict, at most (decided: a tenth of the time the policy has)."""


def check(what: str, ok: bool, text: str) -> dict[str, Any]:
    """One finding of the doctor's."""
    return {"check": what, "ok": ok, "text": text}


def run(config: Config, model: Path | None, progress: Progress) -> list[dict[str, Any]]:
    """Checks (`check`, `ok`, `text`) of one short run into a folder of its own: a calibration or, with a decoder, an
    online run. The folder is kept where something went wrong."""
    folder = Path(tempfile.mkdtemp(prefix="bci-app-doctor-"))
    short: dict[str, Any] = {
        "recordings": str(folder),
        "stimulus": {"person": False},
        "calibration": {"n_blocks": 1, "moves_per_block": N_MOVES},
        "online": {"distances": [2, 2], "max_steps": N_MOVES},
    }
    session = f"doctor-{secrets.token_hex(3)}"  # two set-ups of one computer may be looked at at once
    wishes = verbs.Wishes(changed(config, short), PARTICIPANT, session=session)
    what = "a few moves through all processes into a recording"
    try:
        if model is None:
            told = verbs.calibrate(wishes, progress)
        else:
            told, _ = verbs.online(wishes, "open", model, "told", True, progress)
    except (SetupError, LinkLost) as error:
        return [check(what, False, f"{error} (kept in {folder})")]
    recording = read(Path(told["recording"]))
    counts = replaying.replay(recording.path, None, None, False, progress)
    figures = metrics.latencies([recording], 1.0)
    rejected = [str(verdict.reason) for _, verdict in recording.of(Verdict) if verdict.outcome == "rejected"]
    n_moves = told["moves"]
    checks = [
        check(what, told["reason"] == "complete", f"{n_moves} moves, {sum(told['verdicts'].values())} verdicts"),
        check("epochs can be judged", not rejected, "; ".join(rejected) or f"{n_moves} of {n_moves}"),
        check("the recording replays to the bit", replaying.is_equal(counts), _compared(counts["replay"])),
        check("a verdict is soon there", (figures["verdict_p99_ms"] or 0.0) < SOON_MS, _latency(figures)),
    ]
    if all(each["ok"] for each in checks):
        shutil.rmtree(folder)
    else:
        checks[-1]["text"] += f" (kept in {folder})"
    return checks


def _compared(counts: dict[str, int]) -> str:
    return ", ".join(
        f"{counts[f'{what}_equal']} of {counts[what]} {what}" for what in ("electrodes", "verdicts", "actions")
    )


def _latency(figures: dict[str, float | None]) -> str:
    parts = [
        f"{name} {figures[f'{name}_p50_ms']:.1f} ms" for name in ("verdict", "action") if figures[f"{name}_p50_ms"]
    ]
    return ", ".join(parts) or "no verdict"
