"""Training many policies: a sweep over jobs through joblib, on this machine's cores or on a Dask cluster.

Workers return the contents of files and this process writes them, each whole or not at all; so a sweep that was
interrupted goes on with what is missing, and a cluster needs no shared disk.
"""

import json
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import joblib

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.progress import Progress
from policy import teachers
from policy.actor_critic import ActorCriticSettings
from policy.checkpoint import SUFFIX, check_fits, read_card, write
from policy.distillation import DistillationSettings
from policy.planner import PlannerSettings
from policy.recitation import RecitationSettings
from policy.training import MISSING, PolicyJob, TeacherJob
from policy.verdicts import Verdicts

Job = TeacherJob | PolicyJob

ACCURACIES = tuple(round(0.55 + 0.05 * number, 2) for number in range(10))
"""Of the binary policies of the library."""
TOLD, WITHOUT = Verdicts("told"), Verdicts("none")
CONNECT_TIMEOUT_S = 10.0
"""Real seconds a cluster's scheduler may take to answer."""
POLL_S = 0.5
"""Real seconds between two looks at how far the workers are."""
_ALONE = threading.Lock()
"""Held by a job that runs: a process has one generator of weights and one cache of rounded weights, and a Dask worker
may have several threads. With two jobs at a time the same seed wouldn't give the same weights."""


@dataclass(frozen=True)
class Settings:
    """How long and how each kind of job is trained."""

    teacher: PlannerSettings = field(default_factory=PlannerSettings)
    search: RecitationSettings = field(default_factory=RecitationSettings)
    told: DistillationSettings = field(default_factory=DistillationSettings)
    special: DistillationSettings = field(
        default_factory=lambda: DistillationSettings(updates=250, guided=0.0, learning_rate=2e-3)
    )
    """Of a policy for one kind of verdicts; it goes on from the one that is told all kinds."""
    paper: ActorCriticSettings = field(default_factory=ActorCriticSettings)

    @classmethod
    def quick(cls) -> Self:
        """Minutes instead of a quarter of an hour: the greedy move on the belief teaches, and not for long."""
        return cls(
            teacher=PlannerSettings(updates=0),
            search=RecitationSettings(updates=250),
            told=DistillationSettings(updates=400),
        )

    def with_(self, updates: int | None, seed: int) -> Self:
        """The same with another seed and, unless None, another number of updates; the teacher keeps its own."""
        changes: dict[str, Any] = {"seed": seed} | ({} if updates is None else {"updates": updates})
        return replace(
            self,
            search=replace(self.search, **changes),
            told=replace(self.told, **changes),
            special=replace(self.special, **changes),
            paper=replace(self.paper, **changes),
        )


@dataclass(frozen=True)
class Backend:
    """Where jobs run: ``local`` on ``n_workers`` processes, or ``dask`` at a scheduler's address."""

    name: Literal["local", "dask"] = "local"
    n_workers: int = -1
    scheduler: str | None = None


def everything() -> list[Verdicts]:
    """What the shipped library holds of each map: told, without, and one for each of `ACCURACIES`."""
    return [TOLD, WITHOUT, *(Verdicts("binary", (accuracy,)) for accuracy in ACCURACIES)]


def parsed(words: Sequence[str]) -> list[Verdicts]:
    """Verdicts in words, each once. Raises SetupError for others."""
    return list(dict.fromkeys(Verdicts.parse(word) for word in words))


def train(
    maps: Sequence[str],
    wanted: Sequence[Verdicts],
    recipe: Literal["ours", "paper"],
    folder: Path,
    settings: Settings,
    backend: Backend,
    progress: Progress,
) -> list[Path]:
    """Train what is missing in a folder, and before it what that needs: each map's teacher and its told policy.

    Parameters
    ----------
    maps : shipped maps, or paths of map files.
    wanted : a policy of each map for each.
    recipe : ours or the paper's.

    Returns
    -------
    Paths of the wanted policies, trained now or before.

    Raises SetupError when a file is there but was trained otherwise (it is never overwritten), or when the cluster
    doesn't answer.
    """
    with _pool(backend):

        def finished(jobs: Sequence[Job], what: str) -> list[Path]:
            _sweep(jobs, folder, backend, progress, what)
            return [_path(job, folder) for job in jobs]

        if recipe == "paper":
            return finished(
                [PolicyJob(name, _in_training(each), settings.paper) for name in maps for each in wanted], "policies"
            )
        lessons = _contents(maps, finished([TeacherJob(name, settings.teacher) for name in maps], "teachers"))
        without = [PolicyJob(name, WITHOUT, settings.search, lessons[name]) for name in maps]
        searches = finished(without, "searches")
        if set(wanted) == {WITHOUT}:
            return searches
        search = _contents(maps, searches)
        told = finished(
            [PolicyJob(name, TOLD, settings.told, lessons[name], search[name]) for name in maps], "told policies"
        )
        start = _contents(maps, told)
        rest = [
            PolicyJob(name, _in_training(each), settings.special, lessons[name], start=start[name])
            for name in maps
            for each in wanted
            if each not in (TOLD, WITHOUT)
        ]
        special = finished(rest, "policies")
    return (searches if WITHOUT in wanted else []) + (told if TOLD in wanted else []) + special


def _contents(maps: Sequence[str], paths: Sequence[Path]) -> dict[str, bytes]:
    """The contents of each map's file."""
    return {name: path.read_bytes() for name, path in zip(maps, paths, strict=True)}


def _in_training(verdicts: Verdicts) -> Verdicts:
    """Some verdicts are missing in training, as they will be in sessions."""
    return verdicts if verdicts in (TOLD, WITHOUT) else replace(verdicts, missing=MISSING)


def _path(job: Job, folder: Path) -> Path:
    if isinstance(job, TeacherJob):
        return teachers.path_of(folder, load_map(job.map))
    return folder / f"{job.name}{SUFFIX}"


def _is_there(job: Job, folder: Path) -> bool:
    """Whether the job's file is there; SetupError when it is another map's or was trained with other settings."""
    path = _path(job, folder)
    if not path.exists():
        return False
    if isinstance(job, TeacherJob):
        verdicts, asked, found = None, None, teachers.load(folder, load_map(job.map)).settings
    else:
        card = read_card(path)
        check_fits(card, load_map(job.map))
        verdicts, asked, found = card.verdicts, str(job.verdicts), card.story["settings"]
    # Through JSON, as those in the file were.
    if (verdicts, found) != (asked, json.loads(json.dumps(asdict(job.settings)))):
        raise SetupError(
            f"There is a file {path} already, trained with other settings, and it is not overwritten. Choose another "
            "folder with --out, or move it."
        )
    return True


def _sweep(jobs: Sequence[Job], folder: Path, backend: Backend, progress: Progress, what: str) -> None:
    """Run the jobs whose files aren't there, and write each as soon as it is done."""
    missing = [job for job in jobs if not _is_there(job, folder)]
    if not missing:
        return
    missing.sort(key=lambda job: -job.cost)  # the longest first, so that none is left alone at the end
    with tempfile.TemporaryDirectory() as notes, _Watch(missing, Path(notes), progress, what) as watch:
        # A cluster's workers can't reach this folder: there only finished jobs count.
        target = Path(notes) if backend.name == "local" else None
        work = (joblib.delayed(_run)(number, job, target) for number, job in enumerate(missing))
        parallel = joblib.Parallel(n_jobs=backend.n_workers, batch_size=1, return_as="generator_unordered")
        for number, contents in parallel(work):
            write(_path(missing[number], folder), contents)
            watch.finished(number)


def _run(number: int, job: Job, notes: Path | None) -> tuple[int, bytes]:
    """In a worker: do a job, and keep a note of how far it is where the one who waits can read it."""

    def note(done: int, of: int, _word: str) -> None:
        if notes is not None:
            write(notes / str(number), f"{done} {of}".encode())

    with _ALONE:
        return number, job.run(note)


class _Watch:
    """Reports how far all jobs are, weighed by the moves they play, until it is left."""

    def __init__(self, jobs: Sequence[Job], notes: Path, progress: Progress, what: str) -> None:
        self._jobs, self._notes, self._progress, self._what = jobs, notes, progress, what
        self._shares = [0.0] * len(jobs)
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Self:
        self._report()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join()

    def finished(self, number: int) -> None:
        self._shares[number] = 1.0

    def _look(self) -> None:
        while not self._left.wait(POLL_S):
            for number in range(len(self._jobs)):
                self._shares[number] = max(self._shares[number], self._noted(number))
            self._report()

    def _noted(self, number: int) -> float:
        note = self._notes / str(number)
        if not note.exists():
            return 0.0
        done, of = note.read_text().split()
        return int(done) / int(of)

    def _report(self) -> None:
        done = sum(share * job.cost for share, job in zip(self._shares, self._jobs, strict=True))
        n_done = sum(share == 1 for share in self._shares)
        word = f"{self._what}, {n_done} of {len(self._jobs)} ready, 1000 moves"
        self._progress(word, round(done / 1000), round(sum(job.cost for job in self._jobs) / 1000))


@contextmanager
def _pool(backend: Backend) -> Iterator[None]:
    """Where joblib sends its work meanwhile. Raises SetupError when the cluster doesn't answer."""
    if backend.name == "local":
        with joblib.parallel_config(backend="loky"):
            yield
        return
    if backend.scheduler is None:
        raise SetupError("--backend dask needs --scheduler ADDRESS, as in tcp://192.168.1.10:8786.")
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise SetupError("--backend dask needs the package dask: pip install 'errp-bci[cluster]'.") from error
    try:
        client = Client(backend.scheduler, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise SetupError(
            f"No Dask scheduler answers at {backend.scheduler} within {CONNECT_TIMEOUT_S:g} s ({error}). Start one "
            "with `dask scheduler` and workers with `dask worker ADDRESS --nworkers=-1 --nthreads=1`, or leave out "
            "--backend."
        ) from error
    with client, joblib.parallel_config(backend="dask", wait_for_workers_timeout=CONNECT_TIMEOUT_S):
        try:
            yield
        except TimeoutError as error:
            raise SetupError(
                f"The Dask scheduler at {backend.scheduler} has no worker after {CONNECT_TIMEOUT_S:g} s. Start some "
                f"with `dask worker {backend.scheduler} --nworkers=-1 --nthreads=1`."
            ) from error
