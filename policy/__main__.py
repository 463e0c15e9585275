"""Train one policy: ``python -m policy --map open --accuracy 0.75 --out policy/pretrained``."""

import argparse
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, load_map
from policy.checkpoint import ENDING, PolicyCard, check_fits, load, save
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Network
from policy.observation import LAYOUT, input_size
from policy.simulator import DISTRIBUTIONS, Distribution
from policy.training import HyperParameters, train, verdict_model

EVALUATED: tuple[Distribution, ...] = ("pairs", "distances")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; the exit code."""
    options = _parser().parse_args(arguments)
    console = Console()
    try:
        path = _train(options, console)
    except SetupError as error:
        console.print(str(error), markup=False, soft_wrap=True)
        return error.exit_code
    console.print(f"Written: {path}", markup=False, soft_wrap=True)
    return 0


def _train(options: argparse.Namespace, console: Console) -> Path:
    torch.set_num_threads(1)
    world = load_map(options.map)
    settings = HyperParameters(**{field.name: getattr(options, field.name) for field in fields(HyperParameters)})
    start = _start(options.start, world) if options.start else None
    bar = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    with Progress(*bar, console=console) as progress:
        task = progress.add_task("training", total=settings.updates)

        def show(update: int, figures: dict[str, float]) -> None:
            progress.update(task, completed=update, description=f"{figures['steps']:5.1f} steps an episode")

        network = train(world, options.accuracy, settings, show, start)
        elapsed = progress.tasks[0].elapsed or 0.0
    recipe = {
        "start": options.start.stem if options.start else None,
        "settings": asdict(settings),
        "minutes": round(elapsed / 60, 1),
    }
    card = describe(network, world, options.accuracy, recipe, options.test_episodes)
    for name, result in card.recipe["evaluation"].items():
        console.print(f"{name}: {result['steps']:.2f} steps, success {result['success']:.2%}")
    path: Path = options.out / f"{card.name}{ENDING}"
    save(path, network, card)
    return path


def _start(path: Path, world: GridWorld) -> Network:
    network, card = load(path)
    check_fits(card, world)
    return network.train()


def describe(network: Network, world: GridWorld, accuracy: float | None, recipe: dict[str, Any], n: int) -> PolicyCard:
    """The card of a freshly trained policy: its recipe, versions, and figures of ``n`` episodes of each kind."""
    player, verdicts = NetworkPlayer(network, world), verdict_model(accuracy, missing=0.0)
    results = {name: evaluate(player, world, verdicts, name, n, seed=1) for name in EVALUATED}
    told = {
        **recipe,
        "versions": {"torch": str(torch.__version__), "numpy": np.__version__},
        "evaluation": {name: asdict(result) for name, result in results.items()},
    }
    return PolicyCard(world.name, world.digest, accuracy, LAYOUT, input_size(world), world.n_cells, told)


def _accuracy(text: str) -> float | None:
    if text == "none":
        return None
    value = float(text)
    if not 0.5 <= value <= 1:
        raise argparse.ArgumentTypeError(f"must be 'none' or between 0.5 and 1, found {text}")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m policy", description="Train one policy.")
    parser.add_argument("--map", default="open", help="a shipped map or the path of a map file")
    parser.add_argument("--accuracy", type=_accuracy, default=0.75, help="of the verdicts, or 'none'")
    parser.add_argument("--out", type=Path, required=True, help="folder of the policy file")
    parser.add_argument("--start", type=Path, help="a policy file of this map to go on from")
    parser.add_argument("--test-episodes", type=int, default=5000, help="of each kind, to evaluate it on")
    for field in fields(HyperParameters):
        # The sentence of each is in HyperParameters.
        parser.add_argument(
            f"--{field.name.replace('_', '-')}",
            type=type(field.default),
            default=field.default,
            choices=DISTRIBUTIONS if field.name == "distribution" else None,
        )
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
