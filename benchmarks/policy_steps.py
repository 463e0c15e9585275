"""Steps and success of the Bayes filter and of the shipped policies, on both distributions of episodes.

    python benchmarks/policy_steps.py [--episodes 5000]

Prints one Markdown table a map. Deterministic; a few minutes on one core.
"""

import argparse

import torch

from bci_app.gridworld import SHIPPED_MAPS, load_map
from policy.checkpoint import library, load
from policy.evaluation import BayesPlayer, NetworkPlayer, Player, Result, evaluate
from policy.simulator import COIN_FLIPS, NO_VERDICTS, VerdictModel, pair_weights

REAL = VerdictModel(0.654, 0.859)  # online decisions of 16 people (Ehrlich & Cheng 2018, our count)
TESTS = {
    "none": NO_VERDICTS,
    "0.70": VerdictModel.right(0.70),
    "0.75": VerdictModel.right(0.75),
    "0.80": VerdictModel.right(0.80),
    "1.00": VerdictModel.right(1.0),
    "hit .654, cr .859": REAL,
    "coin flips": COIN_FLIPS,
}


def cell(result: Result) -> str:
    """Steps within 60 with interval, steps without a limit, success with interval."""
    low, high = result.success_interval
    return (
        f"{result.steps:.2f} ± {result.steps_half_width:.2f} | {result.unlimited_steps:.2f} | "
        f"{result.success:.2%} ({low:.1%}-{high:.1%})"
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=5000)
    n = parser.parse_args().episodes
    torch.set_num_threads(1)
    for name in SHIPPED_MAPS:
        world = load_map(name)
        print(f"\n### {name}, {n} episodes\n")
        print("| player | verdicts | pairs: steps | no limit | success | distances: steps | no limit | success |")
        print("|---|---|---|---|---|---|---|---|")
        policies = [load(card.path) for card in library() if card.path and card.map == name]
        for label, verdicts in TESTS.items():
            players: dict[str, Player] = {}
            if verdicts != COIN_FLIPS:
                # The mixture is the policies' own prior, so the filter knows no more than they.
                players["Bayes"] = BayesPlayer(world, pair_weights(world, "mixture"), verdicts)
            players |= {card.name: NetworkPlayer(network, world) for network, card in policies}
            for player_name, player in players.items():
                pairs = evaluate(player, world, verdicts, "pairs", n, seed=123)
                distances = evaluate(player, world, verdicts, "distances", n, seed=123)
                print(f"| {player_name} | {label} | {cell(pairs)} | {cell(distances)} |", flush=True)


if __name__ == "__main__":
    main()
