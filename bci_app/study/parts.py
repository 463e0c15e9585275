"""What is done of a study, a file a participant: written whole after each part, so an interrupted study goes on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from bci_app.errors import SetupError
from bci_app.recording import Recording
from bci_app.report import Row
from bci_app.report.calibrations import judged_online
from bci_app.report.steps import episode_rows, is_right, judged, move_rows
from bci_app.study.plan import Participant, Study, Through
from bci_app.whole import renew
from decoder.model import ModelInfo

CALIBRATION = "calibration"


def part_name(condition: str, map_name: str) -> str:
    """Of an online run."""
    return f"{condition} {Path(map_name).stem}"


@dataclass
class Kept:
    """What is done of one participant.

    Attributes
    ----------
    path : the file.
    head : what it is of: `study`, `participant`, `kind`, `through`, `published`, `digest`.
    parts : what came of each part that is done, by its name.
    recorded : recordings of parts of which more is to be done, by the part's name.
    stopped : the part in which the participant stopped, and why; empty for one who didn't.
    """

    path: Path
    head: dict[str, Any]
    parts: dict[str, dict[str, Any]] = field(default_factory=dict)
    recorded: dict[str, str] = field(default_factory=dict)
    stopped: dict[str, str] = field(default_factory=dict)

    @classmethod
    def new(cls, study: Study, who: Participant, through: Through) -> Self:
        """Of one who hasn't begun."""
        head = {
            "study": study.name,
            "participant": who.name,
            "kind": who.kind,
            "through": through,
            "published": who.published,
            "digest": study.digest(who),
        }
        return cls(study.home / through / f"{who.name}.json", head)

    @classmethod
    def of(cls, study: Study, who: Participant, through: Through) -> Self:
        """What is kept of a participant; nothing yet of one who hasn't begun.

        Raises SetupError where that is of another study, or can't be read.
        """
        kept = cls.new(study, who, through)
        path, head = kept.path, kept.head
        if not path.exists():
            return kept
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            digest, parts, recorded, stopped = (found[name] for name in ("digest", "parts", "recorded", "stopped"))
        except (OSError, ValueError, LookupError, TypeError) as error:
            why = error if isinstance(error, OSError | ValueError) else "a part of it is missing"
            raise SetupError(
                f"{path} should tell what is done of participant {who.name}, and can't be read ({why}). Restore it, "
                "or move it away to begin this participant anew."
            ) from error
        if digest != head["digest"]:
            raise SetupError(
                f"Participant {who.name} was begun with other settings than the study file has now: {path} is of "
                f"{digest}, the file gives {head['digest']}. Undo the change, or name another `folder` in the file."
            )
        return cls(path, head, parts, recorded, stopped)

    def done(self, name: str, result: Mapping[str, Any]) -> None:
        """A part is done."""
        self.parts[name] = dict(result)
        self.recorded.pop(name, None)
        self.save()

    def stop(self, part: str, why: str) -> None:
        """The participant stopped in a part."""
        self.stopped = {"part": part, "why": why}
        self.save()

    def save(self) -> None:
        """Write it so that a crash leaves the old one or the new one, never half of it."""
        content = {**self.head, "stopped": self.stopped, "recorded": self.recorded, "parts": self.parts}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            renew(self.path, f"{json.dumps(content, indent=1)}\n".encode())
        except OSError as error:
            raise SetupError(
                f"Can't keep what is done in {self.path}: {error.strerror}. Free or unlock the disk."
            ) from error


def of_calibration(info: ModelInfo, papers: ModelInfo | None, model: Path, recording: str) -> dict[str, Any]:
    """A calibration's part: the accuracies of `bci-app fit`, and what the policy is told; those of the paper's
    classifier on the same moves as `paper`."""
    return {
        "paper": {"tenfold": papers.tenfold, "contiguous": papers.blocked} if papers else None,
        "n_moves": info.n_error + info.n_correct + info.n_rejected,
        "n_rejected": info.n_rejected,
        "tenfold": info.tenfold,
        "contiguous": info.blocked,
        "information": info.evidence.information,
        "hit": info.evidence.hit,
        "correct_rejection": info.evidence.correct_rejection,
        "model": str(model),
        "recording": recording,
    }


def of_online(recording: Recording, path: str) -> dict[str, Any]:
    """An online run's part: its episodes, its verdicts against the truth, and where and after what they were right."""
    moves = move_rows(recording)
    heard = [move for move in judged(moves) if move["log_odds"] is not None]
    scores = None
    if heard:
        log_odds = np.array([move["log_odds"] for move in heard])
        evidence = np.array([np.nan if move["evidence"] is None else move["evidence"] for move in heard])
        scores = judged_online(log_odds, evidence, np.array([move["error"] for move in heard], dtype=bool))
    if scores is not None:
        scores.pop("reliability")
    places = ("start_row", "start_column", "goal_row", "goal_column")
    kept = ("episode", "distance", *places, "steps", "reason", "success")
    return {
        "episodes": [{name: row[name] for name in kept} for row in episode_rows(recording)],
        "n_moves": len(moves),
        "n_rejected": sum(move["verdict"] == "rejected" for move in moves),
        "scores": scores,
        "areas": {area: _right([move for move in heard if move["area"] == area]) for area in ("central", "edge")},
        "errors_in_a_row": {
            str(level): _right([move for move in heard if min(move["errors_in_a_row"], 5) == level])
            for level in range(1, 6)
        },
        "recording": path,
    }


def _right(moves: list[Row]) -> list[int]:
    """How many verdicts are right, of how many."""
    return [sum(map(is_right, moves)), len(moves)]
