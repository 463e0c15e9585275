"""Every figure of the shipped policies beside what the exact Bayes filter reaches, in one run.

    python benchmarks/policy_steps.py [--episodes 20000] [--rates real_verdicts.tsv] [--json FILE]

For each map, as Markdown tables: binary verdicts by accuracy, scores, both near chance, real pairs of rates, wrongly
told accuracies and missing verdicts. All players meet the same episodes (distance 2 or more, greedy moves); success is
the mean over the initial distances 2 to 20, of as many episodes again. Deterministic; all cores share the work.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import joblib
import torch

from bci_app.gridworld import SHIPPED_MAPS, load_map
from policy.checkpoint import PRETRAINED
from policy.evaluation import report
from policy.library import ACCURACIES
from policy.players import player_of
from policy.verdicts import Verdicts

NEAR_CHANCE = (0.52, 0.54, 0.56, 0.58)
"""Where verdicts begin to help; 0.55 and 0.60 stand in the other tables."""
OFF = 0.10
"""Points by which an accuracy is told wrongly."""


@dataclass(frozen=True)
class Case:
    """One cell: a player, what it is given and what it takes that for."""

    table: str
    label: str
    map: str
    player: str
    verdicts: str
    taken_for: str | None = None
    missing: float = 0.0

    def run(self, episodes: int, folder: Path) -> dict[str, object]:
        """The player's figures, or none where the folder has no such policy."""
        torch.set_num_threads(1)
        world = load_map(self.map)
        believed = Verdicts.parse(self.taken_for) if self.taken_for else None
        given = Verdicts.parse(self.verdicts)
        player, heard = player_of(
            self.player, world, Verdicts(given.kind, given.numbers, self.missing, believed), folder
        )
        return report(player, world, heard, episodes, seed=2022)


def cases(name: str, rates: list[tuple[str, float, float, float, float]], folder: Path) -> Iterator[Case]:
    """All cells of one map."""

    def there(policy: str) -> bool:
        return (folder / f"{name}_{policy}.safetensors").exists()

    for player in ("bayes", "sweep", "none", "told", "none_paper"):
        if player in ("bayes", "sweep") or there(player):
            yield Case("binary", "none", name, player, "none")
    for accuracy in ACCURACIES:
        words, number = f"binary:{accuracy:g}", f"{accuracy * 100:03.0f}"
        for player in ("bayes", "planner", number, "told", f"{number}_paper"):
            if player in ("bayes", "planner") or there(player):
                yield Case("binary", f"{accuracy:.2f}", name, player, words)
    for accuracy in (*ACCURACIES[:-1], 0.99):
        for player in ("bayes", "planner", "told"):
            yield Case("score", f"{accuracy:.2f}", name, player, f"score:{accuracy:g}")
    for accuracy in NEAR_CHANCE:
        for kind in ("binary", "score"):
            for player in ("bayes", "planner", "none", "told"):
                yield Case("near chance", f"{kind} {accuracy:.2f}", name, player, f"{kind}:{accuracy:g}")
    for person, hit, rejection, told_hit, told_rejection in rates:
        words, told = f"rates:{hit!r}:{rejection!r}", f"rates:{told_hit!r}:{told_rejection!r}"
        for player in ("bayes", "planner", "told"):
            yield Case("real", person, name, player, words, told)
    for accuracy in ACCURACIES[:-1]:
        for shift in (-OFF, OFF):
            wrong = round(min(max(accuracy + shift, 0.505), 0.999), 3)
            for kind in ("binary", "score"):
                label = f"{kind} {accuracy:.2f} told {wrong:g}"
                yield Case("wrongly told", label, name, "told", f"{kind}:{accuracy:g}", f"{kind}:{wrong:g}")
    for accuracy in (0.7, 0.8):
        for kind in ("binary", "score"):
            for missing in (0.1, 0.2, 0.4):
                label = f"{kind} {accuracy:.2f}, {missing:.0%} missing"
                for player in ("bayes", "told"):
                    yield Case("missing", label, name, player, f"{kind}:{accuracy:g}", None, missing)


def read_rates(path: Path) -> list[tuple[str, float, float, float, float]]:
    """Each person's rates, and as their decoder would tell them (Jeffreys: no rate of so few moves is 0 or 1)."""
    rows = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    people = []
    for person, *counts in rows[1:]:
        n_error, hits, n_correct, rejections = map(int, counts)
        told = (hits + 0.5) / (n_error + 1), (rejections + 0.5) / (n_correct + 1)
        people.append((person, hits / n_error, rejections / n_correct, *told))
    return people


def show(table: str, name: str, found: dict[Case, dict[str, object]]) -> None:
    """One Markdown table: a row a label, a column a player, its steps against Bayes and its success."""
    chosen = {case: figures for case, figures in found.items() if case.table == table and case.map == name}
    players = list(dict.fromkeys(_column(case) for case in chosen))
    print(
        f"\n### {name}, {table}\n\n| verdicts | " + " | ".join(players) + " |\n|---" * 1 + "|---" * len(players) + "|"
    )
    for label in dict.fromkeys(case.label for case in chosen):
        row = {_column(case): figures for case, figures in chosen.items() if case.label == label}
        print(f"| {label} | " + " | ".join(_cell(row.get(player), row.get("bayes")) for player in players) + " |")


def _column(case: Case) -> str:
    number = case.player.partition("_")
    return ("specialised" if number[0].isdigit() or number[0] == "none" else number[0]) + "".join(number[1:])


def _cell(figures: dict[str, object] | None, bayes: dict[str, object] | None) -> str:
    if figures is None:
        return ""
    low, high = figures["mean_steps_ci"]  # type: ignore[misc]
    ratio = f", x{figures['mean_steps'] / bayes['mean_steps']:.3f}" if bayes else ""  # type: ignore[operator]
    half = (high - low) / 2
    return f"{figures['mean_steps']:.2f} ± {half:.2f}{ratio}, {figures['success_60_by_distance_mean']:.2%}"


def main() -> None:
    """Play all cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=20_000)
    parser.add_argument("--policies", type=Path, default=PRETRAINED)
    parser.add_argument("--rates", type=Path, help="hits and correct rejections of people, tab-separated")
    parser.add_argument("--maps", nargs="+", default=SHIPPED_MAPS)
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    rates = read_rates(options.rates) if options.rates else []
    work = [case for name in options.maps for case in cases(name, rates, options.policies)]
    run = joblib.delayed(Case.run)
    results = joblib.Parallel(n_jobs=-1)(run(case, options.episodes, options.policies) for case in work)
    found = dict(zip(work, results, strict=True))
    for name in options.maps:
        for table in dict.fromkeys(case.table for case in work):
            show(table, name, found)
    if options.json:
        told = [{**case.__dict__, **figures} for case, figures in found.items()]
        options.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
