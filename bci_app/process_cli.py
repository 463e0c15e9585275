"""One verb for each process of the loop, so that each can be started alone, on its own machine."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from bci_app import config as configuration
from bci_app import priority
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.lsl import session_clock
from bci_app.protocol import Role
from bci_app.set_up import applied
from bci_app.told import Told

log = logging.getLogger(__name__)

SessionOption = Annotated[str, typer.Option("--session", help="Session id; the same for all processes of a run.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML or JSON file overriding defaults.")]
SpeedOption = Annotated[
    float, typer.Option("--speed", min=0.1, help="Session seconds a real second (simulation only).")
]
OriginOption = Annotated[float | None, typer.Option("--origin", help="LSL time at which the session clock started.")]
ParentOption = Annotated[int | None, typer.Option("--parent", hidden=True)]
ReturningOption = Annotated[
    bool, typer.Option("--returning", help="The session runs already, and this process takes the place of a dead one.")
]


def register(app: typer.Typer) -> None:
    """Add the verbs `console`, `stimulus`, `decoder`, `policy` and `amplifier`."""
    app.command(rich_help_panel="In the lab")(console)
    for verb in (stimulus, decoder, policy, amplifier):
        app.command(rich_help_panel="One process alone")(verb)


def _prepare(path: Path | None) -> Config:
    # Each process logs to stderr; bci-app, when it started them, keeps that in a file beside the recording.
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    return configuration.load(path)


def _go_first(config: Config, speed: float, role: Role) -> None:
    """Once all is loaded, which takes seconds of computing, and before LSL has threads, which go along."""
    if priority.is_wished(config.priority, speed):
        log.info("Priority: %s.", priority.sentence(priority.go_first(role)))


def console(
    session: Annotated[
        str | None, typer.Option("--session", help="The one to show; default: the one that runs.")
    ] = None,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Of the page; 0 for any that is free.")] = 0,
    config: ConfigOption = None,
    parent: ParentOption = None,
) -> None:
    """Show a running session on a web page of this computer: for the experimenter."""
    from bci_app.console import process

    def tell(address: str) -> None:
        # Beside a verb there may be a progress bar on the line.
        typer.echo(f"{'' if parent is None else chr(10)}Console: {address}")

    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    process.run(configuration.load(config), session, port, parent, tell)


def stimulus(
    session: SessionOption,
    participant: Annotated[str, typer.Option("--participant")],
    task: Annotated[str, typer.Option("--task", help="calibration or online")],
    map_name: Annotated[str | None, typer.Option("--map", help="open, obstacles or a map file.")] = None,
    seed: Annotated[int, typer.Option("--seed")] = 0,
    commanded: Annotated[bool, typer.Option("--commanded", help="Wait for bci-app's word to begin.")] = False,
    from_block: Annotated[int, typer.Option("--from-block", min=0, help="Block to begin with.")] = 0,
    moves_done: Annotated[int, typer.Option("--moves-done", min=0, help="Moves that block has already.")] = 0,
    from_episode: Annotated[int, typer.Option("--from-episode", min=0, help="Episode to begin with.")] = 0,
    config: ConfigOption = None,
    speed: SpeedOption = 1.0,
    origin: OriginOption = None,
    parent: ParentOption = None,
    returning: ReturningOption = False,
) -> None:
    """Show the grid and the agent; begin by the space key."""
    from stimulus import process
    from stimulus.episodes import Begin
    from stimulus.guide import guide
    from stimulus.paradigm import Paradigm

    settings = applied(_prepare(config))
    if task not in ("calibration", "online"):
        raise SetupError(f"--task must be calibration or online, found {task!r}.")
    make = Paradigm.calibration if task == "calibration" else Paradigm.online
    world = load_map(map_name or settings.calibration.map)
    begin = Begin(from_block, moves_done, from_episode)
    way = guide(settings, task, begin)
    paradigm = make(settings, world, session, participant, seed, begin, way)
    _go_first(settings, speed, "stimulus")
    process.run(settings, session_clock(speed, origin), paradigm, commanded, parent, returning, way)


def decoder(
    session: SessionOption,
    model: Annotated[
        Path | None, typer.Option("--model", help="Decoder file; without one epochs are only checked.")
    ] = None,
    config: ConfigOption = None,
    speed: SpeedOption = 1.0,
    origin: OriginOption = None,
    parent: ParentOption = None,
    returning: ReturningOption = False,
    eeg: Annotated[str | None, typer.Option("--eeg", hidden=True)] = None,
) -> None:
    """Turn EEG and move onsets into verdicts."""
    from decoder import process

    settings = _prepare(config)
    _go_first(settings, speed, "decoder")
    process.run(settings, session, session_clock(speed, origin), model, parent, returning, eeg)


def policy(
    session: SessionOption,
    map_name: Annotated[str, typer.Option("--map", help="open, obstacles or a map file.")],
    policy_file: Annotated[Path, typer.Option("--policy", help="Policy file (.safetensors).")],
    told: Annotated[
        str | None, typer.Option("--told", help="The decoder's HIT:CORRECT_REJECTION:BITS, for a policy told them.")
    ] = None,
    config: ConfigOption = None,
    speed: SpeedOption = 1.0,
    origin: OriginOption = None,
    parent: ParentOption = None,
    returning: ReturningOption = False,
) -> None:
    """Choose the agent's moves from verdicts and what the agent senses."""
    from policy import cards, checkpoint, process
    from policy.agent import Agent
    from policy.ear import Ear
    from policy.verdicts import Verdicts

    settings = _prepare(config)
    world = load_map(map_name)
    network, card = checkpoint.load(policy_file)
    cards.check_fits(card, world)
    ear = Ear(Verdicts.parse(card.verdicts), Told.parse(told) if told else None)
    agent = Agent(network, ear, world)
    _go_first(settings, speed, "policy")
    process.run(settings.policy, session, session_clock(speed, origin), agent, world, parent, returning)


def amplifier(
    session: SessionOption,
    task: Annotated[str | None, typer.Option("--task", help="calibration or online; else by what is heard.")] = None,
    map_name: Annotated[str | None, typer.Option("--map", help="Of the run; with --task.")] = None,
    config: ConfigOption = None,
    speed: SpeedOption = 1.0,
    origin: OriginOption = None,
    parent: ParentOption = None,
) -> None:
    """Play a simulated participant's EEG that reacts to the truth of each move."""
    from decoder import amplifier as process

    settings, clock = _prepare(config), session_clock(speed, origin)
    if (task is None) != (map_name is None) or task not in (None, "calibration", "online"):
        raise SetupError(f"--task must be calibration or online, and come with --map; found {task} and {map_name}.")
    layout = load_map(map_name).layout() if map_name else ()
    _go_first(settings, speed, "amplifier")
    process.run(settings, session, clock, parent, task, layout)  # type: ignore[arg-type]
