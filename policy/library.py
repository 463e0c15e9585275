"""Training many policies: a sweep over jobs, on this machine or on a cluster.

Workers return the contents of files and this process writes them, each whole or not at all and none over another; so a
sweep that was interrupted goes on with what is missing, and a cluster needs no shared disk.
"""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self
from uuid import uuid4

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, load_map
from bci_app.progress import Progress
from bci_app.whole import write_new
from policy import teachers
from policy.actor_critic import ActorCriticSettings
from policy.cards import SUFFIX, Recipe, check_fits, policy_name
from policy.checkpoint import load
from policy.distillation import DistillationSettings
from policy.planner import PlannerSettings
from policy.recitation import RecitationSettings
from policy.training import MISSING, PolicyJob, TeacherJob
from policy.verdicts import Verdicts
from policy.workers import Backend as Backend
from policy.workers import Job, Pool, pool_of, watch

ACCURACIES = tuple(round(0.55 + 0.05 * number, 2) for number in range(10))
"""Of the binary policies of the library."""
TOLD, WITHOUT = Verdicts("told"), Verdicts("none")


@dataclass(frozen=True)
class Settings:
    """How long and how each kind of job is trained."""

    teacher: PlannerSettings = field(default_factory=PlannerSettings)
    search: RecitationSettings = field(default_factory=RecitationSettings)
    told: DistillationSettings = field(default_factory=DistillationSettings)
    special: DistillationSettings = field(
        default_factory=lambda: DistillationSettings(updates=900, guided=0.0, learning_rate=1.5e-3)
    )
    """Of a policy for one kind of verdicts; it goes on from the one that is told all kinds."""
    paper: ActorCriticSettings = field(default_factory=ActorCriticSettings)

    @classmethod
    def quick(cls) -> Self:
        """Minutes instead of a quarter of an hour: the planner before any training teaches, and not for long."""
        return cls(
            teacher=PlannerSettings(updates=0),
            search=RecitationSettings(updates=250),
            told=DistillationSettings(updates=2600),
        )

    def with_(self, updates: int | None, seed: int, wanted: Sequence[Verdicts] | None = None) -> Self:
        """The same with another seed and, unless None, another number of updates for the kinds that are wanted.

        With None wanted, for all. What is trained only because those need it keeps its updates, and the teacher both.
        """
        kinds = _KINDS if wanted is None else {"paper", *map(_kind, wanted)}

        def changed(kind: str) -> Any:
            changes = {"seed": seed} if updates is None or kind not in kinds else {"seed": seed, "updates": updates}
            return replace(getattr(self, kind), **changes)

        return replace(self, **{kind: changed(kind) for kind in _KINDS})


_KINDS = ("search", "told", "special", "paper")


def _kind(verdicts: Verdicts) -> str:
    """Which settings our recipe trains a policy with."""
    return {TOLD: "told", WITHOUT: "search"}.get(verdicts, "special")


def everything(recipe: Recipe = "ours") -> list[Verdicts]:
    """What the library holds of each map: told, without, and one for each of `ACCURACIES`; none told by the paper's."""
    told = [TOLD] if recipe == "ours" else []
    return [*told, WITHOUT, *(Verdicts("binary", (accuracy,)) for accuracy in ACCURACIES)]


def parsed(words: Sequence[str]) -> list[Verdicts]:
    """Verdicts in words, each once. Raises SetupError for others."""
    return list(dict.fromkeys(Verdicts.parse(word) for word in words))


def train(
    maps: Sequence[str],
    wanted: Sequence[Verdicts],
    recipe: Recipe,
    folder: Path,
    settings: Settings,
    backend: Backend,
    progress: Progress,
) -> list[Path]:
    """Train what is missing in a folder, and before it what that needs: each map's teacher and its told policy.

    Parameters
    ----------
    maps : shipped maps, or paths of map files; the same map twice, whatever its name, counts once.
    wanted : a policy of each map for each.
    recipe : ours or the paper's.

    Returns
    -------
    Paths of the wanted policies, trained now or before.

    Raises SetupError when the recipe can't train what is wanted, two policies would share a file, the folder can't be
    written, the cluster doesn't answer or is lost, or a file is there but damaged or trained otherwise (none is ever
    overwritten). What stops one job is raised after the others are done and kept.
    """
    worlds, wanted = _distinct(maps), list(dict.fromkeys(wanted))
    _check_wanted(worlds, wanted, recipe, folder)
    with pool_of(backend) as pool:
        check_writable(folder)

        def finished(jobs: Sequence[Job], what: str) -> list[Path]:
            _sweep(jobs, folder, pool, progress, what)
            return [_path(job, folder) for job in jobs]

        if recipe == "paper":
            return finished([PolicyJob(world, each, settings.paper) for world in worlds for each in wanted], "policies")
        lessons = _contents(finished([TeacherJob(world, settings.teacher) for world in worlds], "teachers"))
        searches = finished(
            [PolicyJob(world, WITHOUT, settings.search, lesson) for world, lesson in zip(worlds, lessons, strict=True)],
            "searches",
        )
        if set(wanted) == {WITHOUT}:
            return searches
        told = finished(
            [
                PolicyJob(world, TOLD, settings.told, lesson, search)
                for world, lesson, search in zip(worlds, lessons, _contents(searches), strict=True)
            ],
            "told policies",
        )
        rest = [
            PolicyJob(world, replace(each, missing=MISSING), settings.special, lesson, start=start)
            for world, lesson, start in zip(worlds, lessons, _contents(told), strict=True)
            for each in wanted
            if each not in (TOLD, WITHOUT)
        ]
        special = finished(rest, "policies")
    return (searches if WITHOUT in wanted else []) + (told if TOLD in wanted else []) + special


def _distinct(maps: Sequence[str]) -> list[GridWorld]:
    """Each map once, by the first of its names."""
    worlds: dict[str, GridWorld] = {}
    for name in maps:
        world = load_map(name)
        worlds.setdefault(world.digest, world)
    return list(worlds.values())


def _check_wanted(worlds: Sequence[GridWorld], wanted: Sequence[Verdicts], recipe: Recipe, folder: Path) -> None:
    """Raise SetupError for verdicts the recipe can't train with, and for two policies of one file name."""
    unheard = [str(each) for each in wanted if recipe == "paper" and each.kind in ("told", "score")]
    if unheard:
        raise SetupError(
            "The paper's network hears a verdict's word, not how sure it is: it is trained with none, binary:P or "
            f"rates:HIT:CR, found {', '.join(unheard)}. Choose such verdicts, or leave out --recipe."
        )
    needed = wanted if recipe == "paper" else dict.fromkeys([TOLD, WITHOUT, *wanted])
    seen: dict[str, Path] = {}
    for path in [folder / f"{policy_name(world.name, each, recipe)}{SUFFIX}" for world in worlds for each in needed]:
        # Windows and macOS take names for the same that differ in capitals only.
        if path.name.casefold() in seen:
            raise SetupError(
                f"Two of the policies would be the file {path}: their maps have the same name, or their verdicts "
                "differ by less than a name tells. Rename a map file, or train them in folders of their own."
            )
        seen[path.name.casefold()] = path


def check_writable(folder: Path) -> None:
    """Make the folder and try it, before hours are spent on what couldn't be kept there. Raises SetupError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.NamedTemporaryFile(dir=folder).close()
    except OSError as error:
        raise SetupError(f"Can't write into {folder} ({error}). Choose another folder with --out.") from error


def _contents(paths: Sequence[Path]) -> list[bytes]:
    return [path.read_bytes() for path in paths]


def _path(job: Job, folder: Path) -> Path:
    if isinstance(job, TeacherJob):
        return teachers.path_of(folder, job.world)
    return folder / f"{job.name}{SUFFIX}"


def _is_there(job: Job, folder: Path) -> bool:
    """Whether the job's file is there; SetupError when it can't be used, is another map's or was trained otherwise."""
    path = _path(job, folder)
    if not path.exists():
        return False
    try:
        found = _made_with(job, folder)
    except SetupError as error:
        raise SetupError(f"{error} It is not overwritten: move it, or choose another folder with --out.") from error
    asked: dict[str, Any] = {"settings": json.loads(json.dumps(asdict(job.settings)))}  # as those in the file were
    if isinstance(job, PolicyJob):
        asked |= {"verdicts": str(job.verdicts), "missing": job.verdicts.missing, "recipe": job.recipe}
    if found != asked:
        differing = ", ".join(key for key in asked if found[key] != asked[key])
        raise SetupError(
            f"There is a file {path} already, trained with other {differing}, and it is not overwritten. Choose "
            "another folder with --out, or move it."
        )
    return True


def _made_with(job: Job, folder: Path) -> dict[str, Any]:
    """What the job's file, read whole, says it was trained with. SetupError when it is damaged or another map's."""
    if isinstance(job, TeacherJob):
        return {"settings": teachers.load(folder, job.world).settings}
    _, card = load(_path(job, folder))
    check_fits(card, job.world)
    # A card that doesn't say is of a policy that met as many as our recipe has.
    missing = card.story.get("missing", 0.0 if job.verdicts in (TOLD, WITHOUT) else MISSING)
    settings = card.story.get("settings")
    return {"settings": settings, "verdicts": card.verdicts, "missing": missing, "recipe": card.recipe}


def _sweep(jobs: Sequence[Job], folder: Path, pool: Pool, progress: Progress, what: str) -> None:
    """Run the jobs whose files aren't there, and write each as soon as it is done; then raise what stopped some."""
    missing = [job for job in jobs if not _is_there(job, folder)]
    if not missing:
        return
    missing.sort(key=lambda job: -job.cost)  # the longest first, so that none is left alone at the end
    failed: dict[str, Exception] = {}
    # A worker that outlives an interruption may hold a note open; Windows then can't remove it.
    notes = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    with notes as notes_folder, watch(missing, Path(notes_folder), progress, what) as watching:
        for number, made in pool(missing, Path(notes_folder)):
            job = missing[number]
            if isinstance(made, Exception):
                failed[job.name] = made
                continue
            try:
                _keep(_path(job, folder), made)
            except (SetupError, OSError) as error:
                failed[job.name] = error
            else:
                watching.finished(number)
    if failed:
        raise _summary(failed, len(missing), what, folder)


def _keep(path: Path, contents: bytes) -> None:
    """Write what a job made; where that can't be, elsewhere, and raise SetupError."""
    try:
        # One job may run twice at once, on two machines of a cluster.
        write_new(path, contents, path.with_name(f"{path.name}.{uuid4().hex}.partial"))
    except OSError as error:
        handle, elsewhere = tempfile.mkstemp(prefix=f"{path.stem}_", suffix=path.suffix)
        with open(handle, "wb") as file:
            file.write(contents)
        raise SetupError(
            f"{path} can't be written ({error}), so it was kept as {elsewhere}. Move it to where it belongs; the same "
            "command goes on from there."
        ) from error


def _summary(failed: dict[str, Exception], n: int, what: str, folder: Path) -> Exception:
    """One error for all: the first that is none of the set-up's, with the others as a note, or else a SetupError."""
    names: dict[str, list[str]] = {}
    for name, error in failed.items():
        names.setdefault(str(error), []).append(name)
    reasons = "; ".join(f"{', '.join(which)}: {reason.rstrip('.')}" for reason, which in names.items())
    text = f"{len(failed)} of {n} {what} failed; what else was trained is in {folder}. {reasons}."
    for error in failed.values():
        if not isinstance(error, SetupError):
            error.add_note(text)
            return error
    return SetupError(text)
