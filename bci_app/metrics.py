"""Figures of a recorded run: verdicts against the truth, steps and success of the episodes, latencies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bci_app.one_clock import on_one_clock
from bci_app.protocol import Action, EpisodeEnd, MoveOnset, Truth, Verdict
from bci_app.recording import Recording


@dataclass(frozen=True)
class Confusion:
    """Counts of judged moves; `error` is the positive class."""

    hits: int = 0
    misses: int = 0
    false_alarms: int = 0
    correct_rejections: int = 0

    @property
    def n(self) -> int:
        """Judged moves."""
        return self.hits + self.misses + self.false_alarms + self.correct_rejections

    @property
    def accuracy(self) -> float | None:
        """Share of right verdicts; None without verdicts."""
        return (self.hits + self.correct_rejections) / self.n if self.n else None

    @property
    def hit_rate(self) -> float | None:
        """Share of errors called error."""
        return _share(self.hits, self.misses)

    @property
    def correct_rejection_rate(self) -> float | None:
        """Share of correct moves called correct."""
        return _share(self.correct_rejections, self.false_alarms)

    @property
    def balanced_accuracy(self) -> float | None:
        """Mean of hit rate and correct-rejection rate; None unless both classes occurred."""
        if self.hit_rate is None or self.correct_rejection_rate is None:
            return None
        return (self.hit_rate + self.correct_rejection_rate) / 2


def _share(yes: int, no: int) -> float | None:
    return yes / (yes + no) if yes + no else None


def truths(recording: Recording) -> dict[tuple[int, int], bool]:
    """Whether each move was an error, by (episode, step)."""
    return {(truth.episode, truth.step): truth.error for _, truth in recording.of(Truth)}


def confusion(recording: Recording) -> Confusion:
    """Verdicts against the truth; rejected and unjudged moves don't count."""
    counts = {"hits": 0, "misses": 0, "false_alarms": 0, "correct_rejections": 0}
    names = {
        (True, "error"): "hits",
        (True, "correct"): "misses",
        (False, "error"): "false_alarms",
        (False, "correct"): "correct_rejections",
    }
    known = truths(recording)
    for _, verdict in recording.of(Verdict):
        error = known.get((verdict.episode, verdict.step))
        if error is not None and (error, verdict.outcome) in names:
            counts[names[error, verdict.outcome]] += 1
    return Confusion(**counts)


def online(recordings: Sequence[Recording]) -> dict[str, Any]:
    """Figures of online runs on one map, taken together.

    `mean_steps` counts a failed episode with the steps it took (60 by default); `mean_steps_of_successes` leaves
    failures out, as the paper's Table II does.
    """
    ends = [end for recording in recordings for _, end in recording.of(EpisodeEnd) if end.reason in ("goal", "limit")]
    steps = [end.steps for end in ends]
    reached = [end.steps for end in ends if end.reason == "goal"]
    parts = [confusion(recording) for recording in recordings]
    fields = ("hits", "misses", "false_alarms", "correct_rejections")
    total = Confusion(**{name: sum(getattr(part, name) for part in parts) for name in fields})
    return {
        "n_episodes": len(ends),
        "success": len(reached) / len(ends) if ends else None,
        "mean_steps": float(np.mean(steps)) if steps else None,
        "mean_steps_of_successes": float(np.mean(reached)) if reached else None,
        "n_verdicts": total.n,
        "verdict_accuracy": total.accuracy,
        "verdict_balanced_accuracy": total.balanced_accuracy,
        "hit_rate": total.hit_rate,
        "correct_rejection_rate": total.correct_rejection_rate,
        "n_moves": sum(len(recording.of(MoveOnset)) for recording in recordings),
    }


def latencies(recordings: Sequence[Recording], speed: float) -> dict[str, float | None]:
    """Median and 99th percentile in real ms of what the loop adds to the EEG: of `latency_samples`."""
    found = latency_samples(recordings, speed)
    return {
        f"{name}_p{percent}_ms": float(np.percentile(found[name], percent)) if found[name] else None
        for name in ("verdict", "action")
        for percent in (50, 99)
    }


def latency_samples(recordings: Sequence[Recording], speed: float) -> dict[str, list[float]]:
    """What the loop adds to the EEG, in real ms, one number a move.

    `verdict`: from the arrival of the last needed sample at the decoder to the push of the verdict, as the decoder
    measured it. `action`: from the push of the verdict to the push of the action, by their stamps, so with LSL's way
    between the two processes; none where these are stamps of two machines and the recording doesn't tell how far apart
    their clocks are. `policy`: from the verdict's arrival to the push of the action, as the policy measured
    it. `speed` is the session's.
    """
    found: dict[str, list[float]] = {"verdict": [], "action": [], "policy": []}
    for recording in recordings:
        found["verdict"] += [v.latency_ms for _, v in recording.of(Verdict) if v.latency_ms is not None]
        placed, unknown = on_one_clock(recording)
        comparable = not unknown & {"decoder", "policy"}
        pushed = {(verdict.episode, verdict.step): stamp for stamp, verdict in placed.of(Verdict)}
        for stamp, action in placed.of(Action):
            verdict_at = pushed.get((action.episode, action.step - 1))
            if verdict_at is not None:
                found["action"] += [(stamp - verdict_at) / speed * 1e3] if comparable else []
                found["policy"] += [action.latency_ms] if action.latency_ms is not None else []
    return found
