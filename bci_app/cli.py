"""The command `bci-app`. Each verb parses its words, calls one function and prints what came of it."""

import signal
from importlib.metadata import version
from os import getpid
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from typer.core import TyperGroup

from bci_app import threads  # noqa: F401  isort: skip  -- before anything loads linear algebra
from bci_app import bids_cli, policy_cli, process_cli, study_cli
from bci_app import config as configuration
from bci_app.crew import beside
from bci_app.errors import INTERRUPTED, LinkLost, SetupError
from bci_app.protocol import PROTOCOL_VERSION
from bci_app.runs import read_sidecar
from bci_app.terminal import finish, if_interrupted, print_json, progress_bar, show_settings

GOES_ON = "The same with --resume goes on."


class Verbs(TyperGroup):
    """Turns what went wrong into one sentence and an exit code; only our own mistakes get a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen verb."""
        try:
            return super().invoke(ctx)
        except (SetupError, LinkLost) as error:
            typer.echo(f"Error: {error}", err=True)
            raise typer.Exit(error.exit_code) from error
        except KeyboardInterrupt as interrupt:
            typer.echo(f"Interrupted. {interrupt}".strip(), err=True)
            raise typer.Exit(INTERRUPTED) from interrupt


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bci-app {version('errp-bci')}, protocol {PROTOCOL_VERSION}")
        raise typer.Exit


app = typer.Typer(
    name="bci-app",
    cls=Verbs,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def bci_app(
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Closed-loop ErrP BCI: calibrate a participant, run online sessions, replay recordings exactly."""


ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML file overriding defaults.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")]
ParticipantOption = Annotated[str, typer.Option("--participant", help="Letters and digits, as in P001.")]
VisitOption = Annotated[str, typer.Option("--visit", help="BIDS session label of this visit.")]
SimulateOption = Annotated[bool, typer.Option("--simulate", help="A simulated participant instead of an amplifier.")]
SpeedOption = Annotated[
    float, typer.Option("--speed", help="Session seconds a real second; more than 1 only in simulations.")
]
SeedOption = Annotated[int | None, typer.Option("--seed", help="Seed of the run; drawn and recorded if not given.")]
HeadlessOption = Annotated[bool, typer.Option("--headless", help="Draw without a screen.")]
RemoteOption = Annotated[
    list[str] | None, typer.Option("--remote", help="Role started by hand elsewhere (repeatable): decoder, policy ...")
]
DecodabilityOption = Annotated[
    float | None, typer.Option("--decodability", help="Simulated participant's balanced accuracy, 0.5 to 1.")
]
BackgroundOption = Annotated[
    Path | None, typer.Option("--background", help="Recorded EEG (EDF ...) the simulated participant's brain plays.")
]
RehearseOption = Annotated[
    Path | None, typer.Option("--rehearse", help="Person file that `bci-app rehearse` wrote, as simulated participant.")
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Go on where the participant's last run of this task was broken off.")
]
ConsoleOption = Annotated[bool, typer.Option("--console", help="Show the session on a web page of this computer.")]
SimulationSeedOption = Annotated[
    int | None, typer.Option("--participant-seed", help="Seed of the simulated participant: who it is.")
]


@app.command(rich_help_panel="In the lab")
def calibrate(
    participant: ParticipantOption,
    visit: VisitOption = "S001",
    simulate: SimulateOption = False,
    speed: SpeedOption = 1.0,
    seed: SeedOption = None,
    headless: HeadlessOption = False,
    decodability: DecodabilityOption = None,
    background: BackgroundOption = None,
    rehearse: RehearseOption = None,
    participant_seed: SimulationSeedOption = None,
    stop_when_clear: Annotated[
        bool, typer.Option("--stop-when-clear", help="End after the block at which more would gain next to nothing.")
    ] = False,
    session: Annotated[str | None, typer.Option("--session", help="Session id, for --remote processes.")] = None,
    remote: RemoteOption = None,
    resume: ResumeOption = False,
    console: ConsoleOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Record a calibration: 5 blocks of 120 moves, or fewer."""
    from bci_app import fitting, verbs

    settings = configuration.load(
        config,
        _overrides(headless, decodability, background, participant_seed, rehearse=rehearse)
        | ({"calibration": {"stop_when_clear": True}} if stop_when_clear else {}),
    )
    wishes = verbs.Wishes(
        settings, participant, visit, simulate, speed, seed, session, tuple(remote or ()), resume=resume
    )
    with beside("console", _console(console, config)), progress_bar(as_json) as progress, if_interrupted(GOES_ON):
        outcome = verbs.calibrate(wishes, progress, fitting.look_ahead)
    _finish_run(outcome, as_json, f"Next: bci-app fit {' '.join(outcome['recordings'])}{_with(config)}")


@app.command(rich_help_panel="In the lab")
def fit(
    recording: Annotated[
        list[Path], typer.Argument(help="A recorded calibration (.xdf), or the runs that go on from each other.")
    ],
    allow_damage: Annotated[bool, typer.Option("--allow-damage", help="Use what a damaged file still holds.")] = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a decoder on a calibration and cross-validate it."""
    from bci_app import fitting

    with progress_bar(as_json) as progress:
        result = fitting.fit(recording, configuration.load(config), allow_damage, progress)
    sidecar, simulated = read_sidecar(recording[0]), ""
    if sidecar.get("simulated"):
        person, speed = sidecar["config"]["simulation"]["seed"], sidecar.get("speed", 1.0)
        simulated = f" --simulate --participant-seed {person} --speed {speed:g}"
    hint = f"Next: bci-app online --participant {result['participant']} --map open{simulated}{_with(config)}"
    finish(result, as_json, hint)


@app.command(rich_help_panel="In the lab")
def online(
    participant: ParticipantOption,
    map_name: Annotated[str, typer.Option("--map", help="open, obstacles or a map file.")],
    visit: VisitOption = "S001",
    model: Annotated[Path | None, typer.Option("--model", help="Decoder; default: the participant's newest.")] = None,
    policy: Annotated[
        str | None,
        typer.Option("--policy", help="told, accuracy, none, 0.75 ..., or a file; default: what suits the decoder."),
    ] = None,
    below_gate: Annotated[
        bool, typer.Option("--below-gate", help="Run although the decoder's accuracy is below the gate.")
    ] = False,
    simulate: SimulateOption = False,
    speed: SpeedOption = 1.0,
    seed: SeedOption = None,
    headless: HeadlessOption = False,
    decodability: DecodabilityOption = None,
    background: BackgroundOption = None,
    rehearse: RehearseOption = None,
    participant_seed: SimulationSeedOption = None,
    no_errp: Annotated[bool, typer.Option("--no-errp", help="Control: the simulated brain doesn't react.")] = False,
    session: Annotated[str | None, typer.Option("--session", help="Session id, for --remote processes.")] = None,
    remote: RemoteOption = None,
    resume: ResumeOption = False,
    console: ConsoleOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run an online session: one episode for each initial distance, steered by the verdicts."""
    from bci_app import verbs

    settings = configuration.load(
        config, _overrides(headless, decodability, background, participant_seed, no_errp, rehearse)
    )
    wishes = verbs.Wishes(
        settings, participant, visit, simulate, speed, seed, session, tuple(remote or ()), resume=resume
    )
    with beside("console", _console(console, config)), progress_bar(as_json) as progress, if_interrupted(GOES_ON):
        outcome, _ = verbs.online(wishes, map_name, model, policy, below_gate, progress)
    _finish_run(outcome, as_json, f"Next: bci-app replay {outcome['recording']}")


@app.command(rich_help_panel="Afterwards")
def replay(
    recording: Annotated[Path, typer.Argument(help="A recorded run (.xdf).")],
    model: Annotated[Path | None, typer.Option("--model", help="Decoder; default: the one the sidecar names.")] = None,
    policy: Annotated[Path | None, typer.Option("--policy", help="Policy; default: the one the sidecar names.")] = None,
    allow_damage: Annotated[bool, typer.Option("--allow-damage", help="Use what a damaged file still holds.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a recording through the same functions again and compare every verdict and action."""
    from bci_app import replay as replaying

    with progress_bar(as_json) as progress:
        result = replaying.replay(recording, model, policy, allow_damage, progress)
    finish(result, as_json)
    if not replaying.is_equal(result):
        raise typer.Exit(1)


@app.command(rich_help_panel="In the lab")
def doctor(
    model: Annotated[Path | None, typer.Option("--model", help="Decoder the EEG stream must fit.")] = None,
    moves: Annotated[
        bool, typer.Option("--moves", help="Also make a few moves for real, through every process and the recorder.")
    ] = False,
    headless: HeadlessOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say what would keep a session from starting, or from being worth it: before a participant comes."""
    from bci_app import doctor as doctoring

    with progress_bar(as_json) as progress:
        result = doctoring.examine(
            configuration.load(config, _overrides(headless, None, None, None)), model, progress, moves
        )
    if as_json:
        print_json(result)
    else:
        doctoring.show(result, Console())
    if not result["fit"]:
        raise typer.Exit(SetupError.exit_code)


@app.command(rich_help_panel="In the lab")
def certify(
    moves: Annotated[int, typer.Option("--moves", min=1, max=100, help="Moves of the run, in tens.")] = 30,
    simulate: SimulateOption = False,
    headless: HeadlessOption = False,
    photodiode: Annotated[
        str | None, typer.Option("--photodiode", help="The photodiode's channel; default: the one called so.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The page; nothing is written over.")] = Path("certificate.html"),
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure screen, light and loop on this machine, and say whether it may run the experiment."""
    from bci_app import certificate
    from bci_app import certify as certifying

    settings = configuration.load(config, _overrides(headless, None, None, None))
    with progress_bar(as_json) as progress:
        result = certifying.examine(certifying.Wanted(settings, moves, simulate, photodiode, out), progress)
    if as_json:
        print_json(result)
    else:
        certificate.show(certifying.findings_of(result), result["about"], Console())
        _tell(f"Written: {result['page']}" + (f" and {result['set_up']}" if result["set_up"] else ""))
    if not result["may_run"]:
        raise typer.Exit(SetupError.exit_code)


@app.command(rich_help_panel="Afterwards")
def demo(
    speed: SpeedOption = 24.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of participant and runs.")] = 1,
    decodability: DecodabilityOption = None,
    background: BackgroundOption = None,
    console: ConsoleOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """The whole experiment with a simulated participant: calibrate, fit, online on both maps, replay."""
    from bci_app import demo as demonstration

    settings = configuration.load(config, _overrides(True, decodability, background, seed))
    with beside("console", _console(console, config)), progress_bar(as_json) as progress:
        summary = demonstration.run(settings, speed, seed, progress)
    if as_json:
        print_json(summary)
    else:
        demonstration.show(summary, Console())
    if not demonstration.is_good(summary):
        raise typer.Exit(1)


@app.command(rich_help_panel="In the lab")
def drill(
    fault: Annotated[
        list[str] | None, typer.Option("--fault", help="One of the faults, as 'policy killed'; default: all of them.")
    ] = None,
    sessions: Annotated[int, typer.Option("--sessions", min=1, help="Sessions of each fault.")] = 1,
    speed: Annotated[float, typer.Option("--speed", min=0.1, max=100, help="Session seconds a real second.")] = 20.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of moments and participants.")] = 1,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let things go wrong in simulated sessions, and tell what was survived: before a study, and after a change."""
    from bci_app import drill as drilling

    with progress_bar(as_json) as progress:
        # Long drills are looked at while they last.
        rows = drilling.run(
            configuration.load(config), fault or [], sessions, speed, seed, progress, lambda row: _tell(str(row))
        )
    if as_json:
        print_json(rows)
    else:
        drilling.show(rows, Console())
    if not all(drilling.is_good(row) for row in rows):
        raise typer.Exit(1)


@app.command(rich_help_panel="Afterwards")
def report(
    recording: Annotated[
        list[Path], typer.Argument(help="Recorded runs (.xdf) of a session or a study, or folders that hold some.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="New folder of the report; default: `report` beside the recordings.")
    ] = None,
    allow_damage: Annotated[bool, typer.Option("--allow-damage", help="Use what a damaged file still holds.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what recordings tell: one page with figures and tables, and the same as files."""
    from bci_app.report import making

    with progress_bar(as_json) as progress:
        result = making.make(recording, out, allow_damage, progress)
    finish(result, as_json, f"Open {result['report']} in a browser.")


@app.command("rehearse", rich_help_panel="Afterwards")
def rehearse_recording(
    recording: Annotated[Path, typer.Option("--from", help="The recorded calibration (.xdf) of the person.")],
    participant: Annotated[
        str | None,
        typer.Option("--participant", help="Name of the rehearsal's files; default: the person's REHEARSAL."),
    ] = None,
    map_name: Annotated[str | None, typer.Option("--map", help="Go online there as well: open, obstacles ...")] = None,
    speed: SpeedOption = 24.0,
    seed: SeedOption = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a simulated participant of a recorded calibration, calibrate it, and compare it with the original."""
    from bci_app import rehearsing

    settings = configuration.load(config, _overrides(True, None, None, None))
    with progress_bar(as_json) as progress:
        result = rehearsing.rehearse(recording, settings, participant, map_name, speed, seed, progress)
    who = f"--participant {result['participant']} --map open --simulate --speed {speed:g}"
    hint = f"Next: bci-app online {who} --rehearse {result['person']}{_with(config)}"
    finish(result, as_json, hint)


@app.command("config", rich_help_panel="Afterwards")
def show_config(
    config: ConfigOption = None,
    explain: Annotated[bool, typer.Option("--explain", help="A table of all settings with what they are.")] = False,
) -> None:
    """Print the resolved configuration as JSON."""
    settings = configuration.load(config)
    if explain:
        show_settings(configuration.explained(settings))
    else:
        typer.echo(settings.model_dump_json(indent=2))


def _tell(text: str) -> None:
    typer.echo(text, err=True)


def _overrides(
    headless: bool,
    decodability: float | None,
    background: Path | None,
    participant_seed: int | None,
    no_errp: bool = False,
    rehearse: Path | None = None,
) -> dict[str, Any]:
    simulation = {
        "decodability": decodability,
        "background": str(background) if background else None,
        "rehearse": str(rehearse.absolute()) if rehearse else None,
        "seed": participant_seed,
        "errp": False if no_errp else None,
    }
    given = {key: value for key, value in simulation.items() if value is not None}
    return {"simulation": given} | ({"stimulus": {"headless": True}} if headless else {})


def _console(wanted: bool, config: Path | None) -> list[str] | None:
    """The console's command line; None where none is wanted."""
    return ["--parent", str(getpid()), *(["--config", str(config)] if config else [])] if wanted else None


def _with(config: Path | None) -> str:
    return f" --config {config}" if config else ""


def _finish_run(outcome: dict[str, Any], as_json: bool, hint: str) -> None:
    complete = outcome["reason"] == "complete"
    finish(outcome, as_json, hint if complete else "")
    if not complete:
        raise typer.Exit(INTERRUPTED)


def _terminated(_signal: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def main() -> None:
    """Run bci-app: exit code 0 fine, 2 the user's or the set-up's mistake, 3 lost a link, 130 interrupted."""
    for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP: the terminal was closed
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _terminated)
    app()


bids_cli.register(app)
policy_cli.register(app)
process_cli.register(app)
study_cli.register(app)
