"""A simulated participant as a worker's job, on this machine or on a cluster."""

import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib

from bci_app.errors import SetupError
from bci_app.study.apart import apart
from bci_app.study.conduct import go_through
from bci_app.study.parts import Kept
from bci_app.study.plan import Participant, Study, Through
from bci_app.watching import note
from policy import cluster


@dataclass(frozen=True)
class Job:
    """One simulated participant, for a worker: plain values only, so that any machine can take it.

    Attributes
    ----------
    number, notes : of the job, and the folder on this machine for notes on how far it is; None on a cluster.
    is_beside_others : whether it needs LSL ports of its own.
    """

    study: str
    participant: str
    through: Through
    number: int = 0
    notes: str | None = None
    is_beside_others: bool = False


@dataclass(frozen=True)
class Made:
    """What came of a job: `kept` is what is done of the participant by now, where that can be read.

    An error is that participant's, and no other's: `refusal` is what is wrong with what is kept, or with the cluster,
    and `crash` an error that nobody foresaw.
    """

    kept: dict[str, Any] | None = None
    refusal: str | None = None
    crash: str | None = None


def attempt(job: Job) -> Made:
    """In a worker: all that is left to do of a participant."""

    def part_done(done: int, of: int) -> None:
        if job.notes is not None:
            note(Path(job.notes), job.number, done, of)

    try:
        if job.is_beside_others:
            apart()
        study, who = _whose(job)
        return Made(_plain(go_through(study, who, job.through, lambda what, done, of: None, part_done)))
    except SetupError as error:
        return Made(refusal=str(error))
    except Exception:  # noqa: BLE001 (raised again by `run`)
        crash = traceback.format_exc()
    try:
        return Made(_plain(Kept.of(*_whose(job), job.through)), crash=crash)
    except (SetupError, OSError, ValueError) as error:
        return Made(refusal=str(error), crash=crash)


def _whose(job: Job) -> tuple[Study, Participant]:
    study = Study.model_validate_json(job.study)
    return study, study.participant(job.participant)


def _plain(kept: Kept) -> dict[str, Any]:
    return {"parts": kept.parts, "stopped": kept.stopped}


def made_of(jobs: Sequence[Job], n: int, backend: str, scheduler: str | None) -> Iterator[tuple[int, Made]]:
    """Each job's number and what came of it, as they get ready."""
    if backend == "dask":
        with cluster.connected(scheduler) as client:
            for number, made in cluster.results(client, attempt, jobs):
                yield number, Made(refusal=str(made)) if isinstance(made, SetupError) else made
        return
    if n == 1 or len(jobs) == 1:
        yield from map(_numbered, jobs)
        return
    parallel = joblib.Parallel(n_jobs=n, batch_size=1, return_as="generator_unordered", backend="loky")
    yield from parallel(joblib.delayed(_numbered)(job) for job in jobs)


def _numbered(job: Job) -> tuple[int, Made]:
    return job.number, attempt(job)
