"""Where a run that was broken off stopped, for a new run of the same session to go on there."""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.protocol import BlockEnd, BlockStart, EpisodeEnd, MoveOnset, SessionEnd, SessionStart, Verdict
from bci_app.recording import Recording, read
from bci_app.runs import Run, eeg_type, read_sidecar, recorded_runs

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Stopped:
    """A run that was broken off.

    Attributes
    ----------
    recordings : of it, and of those it went on from, the oldest first.
    sidecar : its own.
    block, moves_done : of a calibration: the block under way, and the valid moves that it has.
    episode : of an online run: the first that isn't finished.
    """

    recordings: tuple[Path, ...]
    sidecar: dict[str, Any]
    block: int = 0
    moves_done: int = 0
    episode: int = 0


def find(config: Config, participant: str, visit: str, task: str, map_name: str, simulated: bool) -> Stopped:
    """The participant's last run of a task on a map, and where it stopped; `simulated`: who is to go on with it.

    Raises SetupError where there is none, it is complete, its settings were others, or it was somebody else's.
    """
    # Which map a calibration is on is among the settings that must be the same.
    wanted = map_name if task == "online" else None
    begun = next(_begun(recorded_runs(Path(config.recordings), participant, visit, task), wanted), None)
    if begun is None:
        where = f" on map {wanted}" if wanted else ""
        raise SetupError(
            f"There is no {task} run of participant {participant}, visit {visit},{where} below {config.recordings} to "
            "go on with. Leave out --resume."
        )
    run, sidecar, recording = begun
    if any(end.reason == "complete" for _, end in recording.of(SessionEnd)):
        raise SetupError(f"{run.xdf} is complete: there is nothing to go on with. Leave out --resume.")
    _check_same(sidecar, config, task, run)
    _check_person(sidecar, config, simulated, run)
    recordings = (*_before(run, sidecar), run.xdf)
    begun_at = sidecar.get("begins_at", {})
    if task == "online":
        return Stopped(recordings, sidecar, episode=first_unfinished(recording, int(begun_at.get("episode", 0))))
    done = int(begun_at.get("block", 0)), int(begun_at.get("moves_done", 0))
    block, moves_done = in_block(recording, done, config.calibration.moves_per_block)
    if block >= config.calibration.n_blocks:
        raise SetupError(f"{run.xdf} holds all {config.calibration.n_blocks} blocks: fit it as it is.")
    return Stopped(recordings, sidecar, block=block, moves_done=moves_done)


def _begun(runs: Iterable[Run], map_name: str | None) -> Iterator[tuple[Run, dict[str, Any], Recording]]:
    """Runs on a map, any if None, that got as far as their first message, with their sidecars and recordings.

    One that was broken off before may not even have EEG in its file.
    """
    for run in runs:
        sidecar = read_sidecar(run.xdf)
        if map_name is not None and sidecar.get("map", map_name) != map_name:
            continue
        try:
            recording = read(run.xdf, allow_damage=True, eeg_type=eeg_type(sidecar))
        except SetupError as error:
            log.warning("Not gone on with: %s", error)
            continue
        if recording.of(SessionStart):
            yield run, sidecar, recording


def _check_same(sidecar: dict[str, Any], config: Config, task: str, run: Run) -> None:
    """What the run is made of must be what it was."""
    section = "online" if task == "online" else "calibration"
    before = sidecar.get("config", {}).get(section, {})
    now = config.model_dump(mode="json")[section]
    for key in (
        "map",
        "n_blocks",
        "moves_per_block",
        "max_steps",
        "distances",
        "rounds",
        "episodes_seed",
        "error_probability",
    ):
        if key in now and before.get(key, now[key]) != now[key]:
            raise SetupError(
                f"{run.xdf} was begun with {section}.{key} = {before.get(key)}, and now it is {now[key]}. Go on with "
                "the configuration it was begun with, or leave out --resume."
            )


def _check_person(sidecar: dict[str, Any], config: Config, simulated: bool, run: Run) -> None:
    """One recording is of one person: real, or one simulated person."""
    if sidecar.get("simulated", simulated) != simulated:
        whose, who = ("a simulated", "a real") if sidecar["simulated"] else ("a real", "a simulated")
        raise SetupError(f"{run.xdf} is of {whose} participant, and {who} one can't go on with it. Leave out --resume.")
    before = sidecar.get("config", {}).get("simulation", {})
    now = config.model_dump(mode="json")["simulation"]
    for key in ("seed", "decodability", "errp", "sfreq", "background", "rehearse") if simulated else ():
        if before.get(key, now[key]) != now[key]:
            raise SetupError(
                f"{run.xdf} is of another simulated participant: simulation.{key} was {before[key]}, and now it is "
                f"{now[key]}. Name the same one (--participant-seed, --decodability, --background, --rehearse), or "
                "leave out --resume."
            )


def _before(run: Run, sidecar: dict[str, Any]) -> Iterator[Path]:
    """Recordings of the runs that this one went on from, the oldest first."""
    for name in sidecar.get("continues", []):
        path = run.xdf.with_name(Path(name).name)
        if not path.exists():
            raise SetupError(f"{run.xdf} went on from {path}, which isn't there. Put it back.")
        yield path


def first_unfinished(recording: Recording, begun: int) -> int:
    """The first episode of an online run, which began with the one ``begun``, that has no end of its own."""
    finished = [end.episode for _, end in recording.of(EpisodeEnd) if end.reason in ("goal", "limit")]
    return max(finished) + 1 if finished else begun


def in_block(recording: Recording, begun: tuple[int, int], per_block: int) -> tuple[int, int]:
    """The block under way, and its valid moves, of a calibration that began in block ``begun[0]`` with ``begun[1]``.

    A move whose verdict never came is made again.
    """
    starts, ends = recording.of(BlockStart), recording.of(BlockEnd)
    if not starts:
        return begun
    stamp, start = starts[-1]
    if ends and ends[-1][1].block == start.block:
        return start.block + 1, 0
    valid = {(verdict.episode, verdict.step) for _, verdict in recording.of(Verdict) if verdict.outcome != "rejected"}
    made = sum((move.episode, move.step) in valid for when, move in recording.of(MoveOnset) if when >= stamp)
    return start.block, min(per_block, per_block - start.n_moves + made)
