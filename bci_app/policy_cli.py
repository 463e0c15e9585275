"""The verbs about policies: `train`, `evaluate` and `experiment1`. No participant, no amplifier, no LSL."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
import typer

from bci_app.config import PolicyConfig
from bci_app.errors import SetupError
from bci_app.gridworld import SHIPPED_MAPS, load_map
from bci_app.terminal import finish, progress_bar
from bci_app.verbs import passes_gate

if TYPE_CHECKING:
    from policy.verdicts import HeldOut, Verdicts

PANEL = "Policies"
MapOption = Annotated[str, typer.Option("--map", help="open, obstacles or a map file.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")]
FolderOption = Annotated[Path | None, typer.Option("--policies", help="Folder of policies; default: the shipped ones.")]
EpisodesOption = Annotated[int, typer.Option("--episodes", min=2, help="Episodes of each kind.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of episodes and verdicts.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    for verb in (train, evaluate, experiment1):
        app.command(rich_help_panel=PANEL)(verb)


def train(
    out: Annotated[Path, typer.Option("--out", help="Folder of the policy files; what is there is kept.")],
    map_name: Annotated[
        list[str] | None, typer.Option("--map", help="Map (repeatable); default: both shipped.")
    ] = None,
    verdicts: Annotated[
        list[str] | None,
        typer.Option("--verdicts", help="told, none, binary:P, rates:HIT:CR, score:P (repeatable); default: told."),
    ] = None,
    library: Annotated[bool, typer.Option("--library", help="All: told, none, binary:0.55 .. 1.00.")] = False,
    recipe: Annotated[str, typer.Option("--recipe", help="ours, or the paper's.")] = "ours",
    quick: Annotated[
        bool, typer.Option("--quick", help="A few minutes instead of a quarter of an hour, and a few per cent worse.")
    ] = False,
    updates: Annotated[int | None, typer.Option("--updates", min=1, help="Default: the recipe's.")] = None,
    seed: SeedOption = 0,
    backend: Annotated[str, typer.Option("--backend", help="local processes, or a dask cluster.")] = "local",
    workers: Annotated[int, typer.Option("--workers", help="Local processes; -1 for one a core, or a GPU.")] = -1,
    scheduler: Annotated[str | None, typer.Option("--scheduler", help="Address of the Dask scheduler.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Train one policy or the whole library; what is in the folder already is not trained again."""
    from policy import library as training

    _one_of("--recipe", recipe, ("ours", "paper"))
    _one_of("--backend", backend, ("local", "dask"))
    if library and verdicts:
        raise SetupError("--library trains all verdicts; leave out --verdicts.")
    if workers == 0:
        raise SetupError("--workers must be 1 or more, or -1 for one a core; found 0.")
    if recipe == "paper" and not (library or verdicts):
        raise SetupError("--recipe paper trains for one kind of verdicts each: name some, as --verdicts binary:0.75.")
    chosen = cast(Literal["ours", "paper"], recipe)
    wanted = training.everything(chosen) if library else training.parsed(verdicts or ["told"])
    if quick and recipe == "paper":
        raise SetupError("--quick shortens our recipe; the paper's is shortened with --updates.")
    settings = (training.Settings.quick() if quick else training.Settings()).with_(updates, seed, wanted)
    where = training.Backend(cast(Literal["local", "dask"], backend), workers, scheduler)
    with progress_bar(as_json) as progress:
        paths = training.train(
            map_name or list(SHIPPED_MAPS),
            wanted,
            chosen,
            out,
            settings,
            where,
            progress,
        )
    finish({"policies": [str(path) for path in paths]}, as_json)


def evaluate(
    map_name: MapOption,
    verdicts: Annotated[str | None, typer.Option("--verdicts", help="none, binary:P, rates:HIT:CR or score:P.")] = None,
    decoder: Annotated[
        Path | None, typer.Option("--decoder", help="A participant's decoder, in place of --verdicts.")
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            help="told, accuracy, none, 0.75 ... or a file, as `online`; or bayes, replan, planner, sweep, oracle.",
        ),
    ] = None,
    episodes: EpisodesOption = 20_000,
    seed: SeedOption = 0,
    missing: Annotated[float, typer.Option("--missing", min=0, max=1, help="Share of missing verdicts.")] = 0.0,
    taken_for: Annotated[
        str | None, typer.Option("--taken-for", help="Verdicts they are taken for, where told wrongly.")
    ] = None,
    folder: FolderOption = None,
    as_json: JsonOption = False,
) -> None:
    """Play simulated episodes with a policy or a baseline: steps to the goal and success, with intervals."""
    from policy import cards, evaluation, players

    world = load_map(map_name)
    if (verdicts is None) == (decoder is None):
        raise SetupError("Give either --verdicts, as in score:0.7, or a participant's --decoder.")
    if decoder is None:
        simulated = _simulated(str(verdicts), missing, taken_for)
        draw: Verdicts | HeldOut = simulated
        accuracy = balanced = simulated.balanced_accuracy
    elif missing or taken_for is not None:
        raise SetupError("--missing and --taken-for are for simulated --verdicts, not for a --decoder.")
    else:
        draw, accuracy, balanced = _held_out(decoder)
    name = policy or ("told" if passes_gate(PolicyConfig(), accuracy, balanced) else "none")
    player, heard = players.player_of(name, world, draw, folder or cards.PRETRAINED, accuracy)
    figures: dict[str, Any] = {"map": world.name, "verdicts": verdicts or str(decoder), "policy": name}
    figures |= {"missing": missing, "taken_for": taken_for}
    figures |= evaluation.report(player, world, heard, episodes, seed)
    finish(figures, as_json)


def _simulated(words: str, missing: float, taken_for: str | None) -> "Verdicts":
    """The verdicts that were asked for, and what they are taken for."""
    from policy.verdicts import Verdicts

    kind = Verdicts.parse(words, missing)
    if kind.kind == "told":
        raise SetupError("--verdicts told is for training; name the decoder to evaluate with, as in score:0.7.")
    if taken_for is None:
        return kind
    believed = Verdicts.parse(taken_for)
    if (believed.kind == "score") != (kind.kind == "score") or believed.kind in ("none", "told"):
        raise SetupError(f"--taken-for must be of the same form as --verdicts {words}, found '{taken_for}'.")
    return replace(kind, taken_for=believed)


def _held_out(path: Path) -> tuple["HeldOut", float, float]:
    """What a participant's decoder says of moves it wasn't fitted on; its accuracy, plain and balanced."""
    from decoder import model
    from policy.verdicts import HeldOut

    fitted = model.load(path)
    evidence, error = fitted.info.evidence, fitted.held_out_error
    said = np.array([evidence.of(log_odds) for log_odds in fitted.held_out_log_odds], np.float32)
    accuracy, balanced = (float(fitted.info.blocked[name]["value"]) for name in ("accuracy", "balanced_accuracy"))
    return HeldOut(said[error], said[~error], evidence.information), accuracy, balanced


def experiment1(
    out: Annotated[Path, typer.Option("--out", help="Folder for tables and figures.")],
    episodes: EpisodesOption = 20_000,
    folder: FolderOption = None,
    as_json: JsonOption = False,
) -> None:
    """The paper's first experiment: all of its tables and figures with our policies, beside the published numbers."""
    from policy import cards
    from policy.experiment1 import tables

    with progress_bar(as_json) as progress:
        result = tables.run(out, folder or cards.PRETRAINED, episodes, progress)
    finish(result, as_json)


def _one_of(option: str, found: str, known: tuple[str, ...]) -> None:
    if found not in known:
        raise SetupError(f"{option} must be one of {', '.join(known)}; found {found!r}.")
