"""Where jobs run, on this machine's cores through joblib or on a Dask cluster, and how far they are."""

import os
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import joblib
import torch

from bci_app.progress import Progress
from bci_app.watching import Watch, note
from policy import cluster, training
from policy.processor import device
from policy.training import PolicyJob, TeacherJob

Job = TeacherJob | PolicyJob
Pool = Callable[[Sequence[Job], Path], Iterator[tuple[int, bytes | Exception]]]
"""Does jobs, with a folder for notes on how far they are: each job's number and what it made, or why it couldn't."""

POLL_S = 0.5
"""Real seconds between two looks for the process that waits for a worker."""
_ALONE = threading.Lock()
"""Held by a job that runs: a process has one generator of weights and one cache of rounded weights, and a Dask worker
may have several threads. With two jobs at a time the same seed wouldn't give the same weights."""


@dataclass(frozen=True)
class Backend:
    """Where jobs run: ``local`` on ``n_workers`` processes, or ``dask`` at a scheduler's address."""

    name: Literal["local", "dask"] = "local"
    n_workers: int = -1
    scheduler: str | None = None

    @property
    def n_processes(self) -> int:
        """Local processes as joblib counts them: -1 is one a core, but one a GPU where there are some."""
        if self.n_workers == -1 and device().type == "cuda":
            return torch.cuda.device_count()
        return self.n_workers


@contextmanager
def pool_of(backend: Backend) -> Iterator[Pool]:
    """Where jobs run meanwhile. Raises SetupError as `cluster.connected` does."""
    if backend.name == "dask":
        with cluster.connected(backend.scheduler) as client:
            # A cluster's workers can't reach the notes: there only finished jobs count.
            yield lambda jobs, _notes: cluster.results(client, attempt, jobs)
        return

    def locally(jobs: Sequence[Job], notes: Path) -> Iterator[tuple[int, bytes | Exception]]:
        parallel = joblib.Parallel(n_jobs=backend.n_processes, batch_size=1, return_as="generator_unordered")
        results: Iterator[tuple[int, bytes | Exception]] = parallel(
            joblib.delayed(_attempt_here)(number, job, notes, os.getpid()) for number, job in enumerate(jobs)
        )
        return results

    with joblib.parallel_config(backend="loky"), warnings.catch_warnings():
        # Workers keep their memory on purpose, which joblib takes for a leak and mends by starting a fresh one.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        yield locally


def attempt(job: Job, progress: training.Progress = lambda done, of, word: None) -> bytes | Exception:
    """In a worker: what a job makes, or what stopped it, for an error that is raised there would stop the others."""
    with _ALONE:
        try:
            return job.run(progress)
        except Exception as error:  # noqa: BLE001 -- raised by the one who waits
            error.add_note(f"In the worker that trained {job.name}:\n{traceback.format_exc()}")
            return error


def _attempt_here(number: int, job: Job, notes: Path, owner: int) -> tuple[int, bytes | Exception]:
    """In a worker of this machine: the same, with a note of how far it is where the one who waits can read it.

    It ends where the process `owner` that waits for it was killed: nobody would read the result.
    """
    if os.getpid() != owner:  # one worker is none: the job runs in the owner itself
        threading.Thread(target=_end_with, args=(owner,), daemon=True).start()
    if device().type == "cuda":
        torch.cuda.set_device(number % torch.cuda.device_count())
    return number, attempt(job, lambda done, of, _word: note(notes, number, done, of))


def _end_with(owner: int) -> None:
    while os.name == "posix" and os.getppid() == owner:
        time.sleep(POLL_S)
    if os.name == "posix":
        os._exit(1)  # loky would take an exception for the job's, and wait for more jobs


def watch(jobs: Sequence[Job], notes: Path, progress: Progress, what: str) -> Watch:
    """Reports how far all jobs are, weighed by the moves they play, until it is left."""
    total = round(sum(job.cost for job in jobs) / 1000)

    def tell(shares: Sequence[float]) -> None:
        done = sum(share * job.cost for share, job in zip(shares, jobs, strict=True))
        n_ready = sum(share == 1 for share in shares)
        progress(f"{what}, {n_ready} of {len(jobs)} ready, 1000 moves", round(done / 1000), total)

    return Watch(notes, [0.0] * len(jobs), tell)
