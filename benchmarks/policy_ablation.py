"""What each part of our training recipe is worth: the same policy trained without it, on the same number of moves.

    python benchmarks/policy_ablation.py [--map open] [--accuracy 0.7] [--updates 2000] [--seeds 2]

Prints a Markdown table of mean steps over 20,000 episodes, and their spread over seeds. The teacher is the shipped one.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from statistics import mean

import joblib
import torch
from torch import nn

from bci_app.gridworld import GridWorld, load_map
from policy import teachers
from policy.actor_critic import ActorCriticSettings, train_actor_critic
from policy.cards import PRETRAINED
from policy.distillation import DistillationSettings, distil
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Actor, Network, PaperNetwork
from policy.planner import Planner
from policy.verdicts import Verdicts


def one_row(world: GridWorld) -> Network:
    """Evidence goes in by one row only, in proportion, not by a second for how sure it is."""
    network = Network(world.n_cells)
    nn.init.zeros_(network.judged_sure.weight)
    network.judged_sure.weight.requires_grad_(False)
    return network


def no_rows(world: GridWorld) -> Network:
    """The evidence is not multiplied with the move: one row for all moves, as in a plain GRU on one-hot inputs."""
    network = Network(world.n_cells)
    for table in (network.judged, network.judged_sure):
        row = nn.Parameter(0.1 * torch.randn(1, table.weight.shape[1]))
        # Every move looks up the same row.
        table.register_parameter("row", row)
        table.forward = lambda index, row=row: row.expand(len(index), -1)  # type: ignore[method-assign]
        table.weight.requires_grad_(False)
    return network


@dataclass(frozen=True)
class Variant:
    """One row of the table."""

    label: str
    changes: dict[str, float] = field(default_factory=dict)
    greedy_teacher: bool = False
    network: Callable[[GridWorld], Network] | None = None


VARIANTS = (
    Variant("our recipe"),
    Variant("the teacher is the planner before any training", greedy_teacher=True),
    Variant("no auxiliary head that learns the belief", {"goal_weight": 0.0}),
    Variant("auxiliary head with weight 0.3", {"goal_weight": 0.3}),
    Variant("the teacher's probabilities as they are, not sharpened", {"sharpening": 1.0}),
    Variant("the teacher is asked at every step", {"taught_every": 1}),
    Variant("the teacher never leads", {"guided": 0.0}),
    Variant("the teacher leads half of the episodes to the end", {"guided": 1e9}),
    Variant("back-propagation through 10 steps", {"n_steps": 10, "n_episodes": 512}),
    Variant("back-propagation through 40 steps", {"n_steps": 40, "n_episodes": 128}),
    Variant("evidence by one row a move", network=one_row),
    Variant("evidence by one row for all moves", network=no_rows),
)


def imitated(variant: Variant, name: str, verdicts: Verdicts, updates: int, seed: int) -> float:
    """Mean steps of a variant of our recipe."""
    torch.set_num_threads(1)
    world = load_map(name)
    lesson = teachers.load(PRETRAINED, world)
    planner = Planner(world, lesson.paths) if variant.greedy_teacher else lesson.planner
    settings = replace(DistillationSettings(updates=updates, seed=seed), **variant.changes)  # type: ignore[arg-type]
    torch.manual_seed(seed)
    network = distil(world, planner, verdicts, settings, network=variant.network(world) if variant.network else None)
    return steps(network, world, verdicts)


def reinforced(paper: bool, name: str, verdicts: Verdicts, moves: int, seed: int) -> float:
    """Mean steps of actor-critic alone, on our inputs or the paper's."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    world, settings = load_map(name), ActorCriticSettings(seed=seed)
    settings = replace(settings, updates=moves // (settings.n_steps * settings.n_episodes))
    network: Actor = PaperNetwork(world.n_cells) if paper else Network(world.n_cells)
    return steps(train_actor_critic(network, world, verdicts, settings), world, verdicts)


def steps(network: Actor, world: GridWorld, verdicts: Verdicts) -> float:
    """Mean steps over 20,000 episodes."""
    return evaluate(NetworkPlayer(network, world), world, verdicts).mean_steps


def main() -> None:
    """Train all variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", default="open")
    parser.add_argument("--accuracy", type=float, default=0.7)
    parser.add_argument("--updates", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    verdicts = Verdicts.parse(f"binary:{options.accuracy:g}")
    default = DistillationSettings()
    moves = options.updates * default.n_steps * default.n_episodes
    work = [
        joblib.delayed(imitated)(variant, options.map, verdicts, options.updates, seed)
        for variant in VARIANTS
        for seed in range(options.seeds)
    ]
    work += [
        joblib.delayed(reinforced)(paper, options.map, verdicts, moves, seed)
        for paper in (False, True)
        for seed in range(options.seeds)
    ]
    found = joblib.Parallel(n_jobs=-1)(work)
    labels = [variant.label for variant in VARIANTS] + ["actor-critic alone, our inputs", "the paper's recipe"]
    print(f"{options.map}, verdicts right at {options.accuracy:g}, {moves / 1e6:.1f} million moves\n")
    print("| variant | mean steps | of each seed |\n|---|---|---|")
    for number, label in enumerate(labels):
        of_seeds = found[number * options.seeds : (number + 1) * options.seeds]
        print(f"| {label} | {mean(of_seeds):.2f} | {', '.join(f'{value:.2f}' for value in of_seeds)} |")


if __name__ == "__main__":
    main()
