"""What one run is to be: everything it needs to know beforehand, and what each process is told of it."""

from collections.abc import Callable
from dataclasses import dataclass
from os import getpid
from pathlib import Path
from typing import Literal

from bci_app import priority
from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.crew import Crew
from bci_app.heard import Heard
from bci_app.lookout import Look
from bci_app.protocol import Role, simulated_source_id
from bci_app.recorder import Recorder
from bci_app.resuming import Stopped
from bci_app.runs import Run, checksum, versions
from bci_app.supervisor import Supervisor

Task = Literal["calibration", "online"]


@dataclass(frozen=True)
class Stage:
    """What a drill may lay hands on; there is no recorder before all processes are ready."""

    crew: Crew
    recorder: Recorder | None
    heard: Heard
    supervisor: Supervisor


Disturb = Callable[[Stage], None]


@dataclass(frozen=True)
class Plan:
    """Everything one run needs to know.

    Attributes
    ----------
    run : where its files go.
    config : resolved configuration.
    task, map, seed : what the stimulus shows.
    simulate : whether a simulated participant takes part; only then may `speed` differ from 1.
    model, policy : files of the decoder and of the policy; None in a calibration.
    told : what the policy is told of the decoder, as `bci_app.told.Told` in words.
    remote : roles started by hand on other machines.
    session : id the remote processes were started with; drawn when there are none.
    look : how to look at a calibration after each of its blocks.
    disturb : what a drill does to the run, asked again and again while it lasts.
    goes_on : from which run that was broken off, if from one.
    """

    run: Run
    config: Config
    task: Task
    map: str
    seed: int
    simulate: bool = False
    speed: float = 1.0
    model: Path | None = None
    policy: Path | None = None
    told: str | None = None
    remote: frozenset[Role] = frozenset()
    session: str | None = None
    look: Look | None = None
    disturb: Disturb | None = None
    goes_on: Stopped | None = None

    @property
    def roles(self) -> tuple[Role, ...]:
        """The processes that take part."""
        roles: list[Role] = ["amplifier"] if self.simulate else []
        roles += ["decoder", "policy", "stimulus"] if self.task == "online" else ["decoder", "stimulus"]
        return tuple(roles)


def for_session(plan: Plan, session: str) -> Config:
    """The plan's configuration; a simulated run finds its own amplifier, and nobody waits for a key."""
    if not plan.simulate:
        return plan.config
    eeg = plan.config.eeg.model_copy(
        update={"stream_type": "EEG", "stream_name": None, "source_id": simulated_source_id(session)}
    )
    simulation = plan.config.simulation.model_copy(update={"run": plan.seed})
    stimulus = plan.config.stimulus.model_copy(update={"person": False})
    return plan.config.model_copy(update={"eeg": eeg, "stimulus": stimulus, "simulation": simulation})


def arguments(plan: Plan, role: Role, session: str, clock: Clock) -> list[str]:
    """What the process in this role is started with, beside the path of its configuration."""
    words = ["--session", session, "--parent", str(getpid())]
    words += ["--speed", repr(clock.speed), "--origin", repr(clock.origin)]
    match role:
        case "stimulus":
            words += ["--task", plan.task, "--map", plan.map, "--seed", str(plan.seed)]
            words += ["--participant", plan.run.participant, "--commanded"]
            if stopped := plan.goes_on:
                words += ["--from-block", str(stopped.block), "--moves-done", str(stopped.moves_done)]
                words += ["--from-episode", str(stopped.episode)]
        case "amplifier":
            words += ["--task", plan.task, "--map", plan.map]
        case "decoder" if plan.model is not None:
            words += ["--model", str(plan.model)]
        case "policy":
            words += ["--map", plan.map, "--policy", str(plan.policy)]
            words += ["--told", plan.told] if plan.told else []
    return words


def described(plan: Plan, config: Config, session: str, clock: Clock) -> dict[str, object]:
    """A run's sidecar as it begins."""
    return {
        "session": session,
        "task": plan.task,
        "participant": plan.run.participant,
        "map": plan.map,
        "seed": plan.seed,
        "simulated": plan.simulate,
        "speed": clock.speed,
        "origin": clock.origin,
        "model": _file(plan.model),
        "policy": _file(plan.policy),
        "told": plan.told,
        **(_continuation(plan.goes_on) if plan.goes_on else {}),
        "config": config.model_dump(mode="json"),
        "priority": priority.expected(config.priority, clock.speed),
        "versions": versions(),
    }


def _file(path: Path | None) -> dict[str, str] | None:
    return {"path": str(path), "sha256": checksum(path)} if path else None


def _continuation(stopped: Stopped) -> dict[str, object]:
    begins = {"block": stopped.block, "moves_done": stopped.moves_done, "episode": stopped.episode}
    return {"continues": [path.name for path in stopped.recordings], "begins_at": begins}
