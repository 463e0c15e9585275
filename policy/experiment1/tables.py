"""The paper's first experiment (section IV): what simulated users achieve, as tables and figures beside its numbers.

A table is a list of flat rows; ``accuracy`` is None without verdicts. What the policies of a folder can't fill stays
empty, and the names of those that are absent are in the result.
"""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from bci_app.gridworld import SHIPPED_MAPS, GridWorld, load_map
from bci_app.progress import Progress
from policy.baselines import BayesPlayer, OraclePlayer
from policy.evaluation import Played, Player, evaluate, play_many, summarise, wilson
from policy.experiment1 import Row, Tables, figures, influence, published
from policy.experiment1.shelf import Series, Shelf, verdicts_of
from policy.library import ACCURACIES, check_writable
from policy.observation import STEP_LIMIT
from policy.players import heard
from policy.simulator import MAX_DISTANCE, MIN_DISTANCE, Simulator, pair_weights
from policy.verdicts import Verdicts

Job = tuple[str, Callable[[], Tables]]
"""What it is about, in words, and the work."""

EACH = (None, *ACCURACIES)
BY_ACCURACY: tuple[Series, ...] = ("ours", "paper")  # with a policy for each
TRAINED_AT: tuple[tuple[Series, float | None], ...] = (
    ("ours", 0.75),  # partial and full observations (paper IV.A.2)
    ("ours", 1.0),
    ("told", None),
    ("paper", 0.75),
    ("paper", 1.0),
)
EVALUATED_AT = tuple(round(0.7 + 0.05 * number, 2) for number in range(7))  # paper IV.A.2
GRADIENTS_AT = (0.7, 0.75, 0.8, 1.0)  # paper IV.A.3, and full observations
SUCCESS_AT = (None, 0.7, 0.8)  # paper IV.A.5
AT_ONCE = 20_000  # episodes in memory
GOAL_AT = 0.7  # of height and width: the goal of the trajectories, which start in the first corner
SEED = 0  # of starts, goals and verdicts; training has others

NOTES = {
    "accuracy": "Mean steps without a limit, over random starts and goals at least 2 apart; a lost episode counts 400.",
    "robustness": "Each verdict is taken for one of the accuracy trained at; the told policy hears the truth.",
    "gradients": "Of the log-probability of the action taken, by the verdict (1 error, 0 missing, -1 correct) and by "
    "the position (one-hot; the paper recipe's: row and column from 0 to 1); means of absolute values over steps with "
    "a verdict, intervals by episode. The memory is a fixed input: only the present step's effect is counted. "
    "Integrated gradients start from a missing verdict, or a position that tells nothing, and are in nats.",
    "centre_edge": "Mean over cells of a cell's mean absolute verdict gradient; intervals bootstrap whole episodes.",
    "success": "Within 60 steps; Wilson's 95 % intervals.",
    "published": "Paper IV.B; the numbers of Fig. 4 and the 'about 10' are rounded there, and their map isn't named.",
}
TABLES = (
    "curves",
    "accuracy",
    "robustness",
    "gradients",
    "gradient_map",
    "centre_edge",
    "success",
    "success_mean",
    "trajectories",
)


def run(
    folder: Path, policies: Path, episodes: int, progress: Progress, maps: Sequence[str] = SHIPPED_MAPS
) -> dict[str, Any]:
    """Compute all tables and draw all figures into a folder.

    Parameters
    ----------
    policies : folder of policy and teacher files.
    episodes : of each mean, 20,000 in the paper; half as many for each initial distance, as there.
    maps : shipped maps, or paths of map files.

    Returns
    -------
    What ``experiment1.json`` holds, too: tables, paths of the figures, and the names of absent policies.

    Raises SetupError when a policy is there but can't be read or is of another map.
    """
    shelves = [Shelf(policies, load_map(name)) for name in maps]
    work = [job for shelf in shelves for job in _jobs(shelf, episodes)]
    tables: Tables = {name: [] for name in TABLES}
    for number, (word, job) in enumerate(work):
        progress(word, number, len(work) + 1)
        for name, rows in job().items():
            tables[name] += rows
    progress("figures", len(work), len(work) + 1)
    check_writable(folder)
    drawn = figures.draw(tables, {shelf.world.name: shelf.world.layout() for shelf in shelves}, folder)
    result = {
        "episodes": episodes,
        "policies": str(policies),
        "absent": [name for shelf in shelves for name in shelf.absent],
        "without_curve": [name for shelf in shelves for name in shelf.without_curve],
        "notes": NOTES,
        "figures": {name: [str(path) for path in paths] for name, paths in drawn.items()},
        "tables": tables,
    }
    for name, rows in tables.items():
        _write_csv(folder / f"{name}.csv", rows)
    (folder / "experiment1.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    progress("done", len(work) + 1, len(work) + 1)
    return result


def _jobs(shelf: Shelf, episodes: int) -> Iterator[Job]:
    name = shelf.world.name
    for accuracy in EACH:
        yield f"{name}: steps by accuracy", partial(_by_accuracy, shelf, accuracy, episodes)
    yield f"{name}: bounds", partial(_bounds, shelf, episodes)
    for series, trained in TRAINED_AT:
        yield f"{name}: robustness", partial(_robustness, shelf, series, trained, episodes)
    for series in get_args(Series):
        for accuracy in GRADIENTS_AT:
            yield f"{name}: gradients", partial(_gradients, shelf, series, accuracy, episodes)
    for series in BY_ACCURACY:
        for evaluated in SUCCESS_AT:
            yield f"{name}: success by distance", partial(_success, shelf, series, evaluated, episodes)
    yield f"{name}: trajectories", partial(_trajectories, shelf)


def _steps(shelf: Shelf, player: Player, verdicts: Verdicts, episodes: int) -> Row:
    """Mean steps over random starts and goals (paper IV.A.1)."""
    result = evaluate(player, shelf.world, verdicts, "pairs", episodes, SEED)
    low, high = result.mean_steps_ci
    return {"mean_steps": result.mean_steps, "ci_low": low, "ci_high": high, "episodes": episodes}


def _by_accuracy(shelf: Shelf, accuracy: float | None, episodes: int) -> Tables:
    """Fig. 3: learning curves, and steps where the verdicts are as in training."""
    world, verdicts = shelf.world, verdicts_of(accuracy)
    rows, curves = [], []
    for series in BY_ACCURACY:
        told = {"map": world.name, "series": series, "accuracy": accuracy}
        found = shelf.player(series, accuracy)
        if found:
            rows.append(told | _steps(shelf, found[0], verdicts, episodes))
        curves += [told | {"moves": moves, "mean_steps": steps} for moves, steps in shelf.curve(series, accuracy)]
    bayes = BayesPlayer(world, pair_weights(world, "pairs"))
    told = {"map": world.name, "series": "Bayes filter", "accuracy": accuracy}
    rows.append(told | _steps(shelf, bayes, verdicts, episodes))
    steps = published.STEPS.get(world.name, {}).get(accuracy)
    if steps is not None:
        rows.append({"map": world.name, "series": "published", "accuracy": accuracy, "mean_steps": steps})
    return {"accuracy": rows, "curves": curves}


def _bounds(shelf: Shelf, episodes: int) -> Tables:
    """Fig. 3b: the best search without verdicts, and the shortest path."""
    bounds = {"search": shelf.search(), "oracle": OraclePlayer(shelf.world)}
    return {
        "accuracy": [
            {"map": shelf.world.name, "series": name, "accuracy": None}
            | _steps(shelf, player, verdicts_of(None), episodes)
            for name, player in bounds.items()
            if player
        ]
    }


def _robustness(shelf: Shelf, series: Series, trained: float | None, episodes: int) -> Tables:
    """Fig. 4: one policy under verdicts of other accuracies than in training."""
    rows: list[Row] = []
    told: Row = {"map": shelf.world.name, "series": series, "trained": trained}
    found = shelf.player(series, trained)
    if found:
        player, kind = found
        for accuracy in EVALUATED_AT:
            verdicts = heard(kind, verdicts_of(accuracy))
            rows.append(told | {"accuracy": accuracy} | _steps(shelf, player, verdicts, episodes))
    if series == "ours" and trained is not None and shelf.world.name in published.STEPS:
        told = told | {"series": "published"}
        steps = published.ROBUSTNESS[trained].items()
        rows += [told | {"accuracy": accuracy, "mean_steps": mean} for accuracy, mean in steps]
    return {"robustness": rows}


def _gradients(shelf: Shelf, series: Series, accuracy: float, episodes: int) -> Tables:
    """Figs. 5 and 6: what the actions owe to verdict and position, and where."""
    world, found = shelf.world, shelf.policy(series, accuracy)
    if not found:
        return {}
    told = {"map": world.name, "series": series, "accuracy": accuracy}
    tables = influence.tables(found[0], world, accuracy, episodes, SEED)
    return {name: [told | row for row in rows] for name, rows in tables.items()}


def _success(shelf: Shelf, series: Series, accuracy: float | None, episodes: int) -> Tables:
    """Fig. 7: success within 60 steps by initial distance."""
    world, found = shelf.world, shelf.player(series, accuracy)
    if not found:
        return {}
    distances = range(MIN_DISTANCE, min(MAX_DISTANCE, int(world.distance.max())) + 1)
    played = _play(found[0], world, verdicts_of(accuracy), max(episodes // 2, 1) * len(distances))
    reached = played.steps <= STEP_LIMIT
    told = {"map": world.name, "series": series, "accuracy": accuracy}
    rows = []
    for distance in distances:
        there = reached[played.distance == distance]
        if len(there):
            low, high = wilson(there)
            row = {"distance": distance, "success": float(there.mean()), "ci_low": low, "ci_high": high}
            rows.append(told | row | {"episodes": len(there)})
    result = summarise(played)
    known = published.SUCCESS.get(world.name, {}).get(accuracy)
    mean = {"success": result.success_60_by_distance_mean, "published": known, "mean_steps_60": result.mean_steps_60}
    return {"success": rows, "success_mean": [told | mean]}


def _play(player: Player, world: GridWorld, verdicts: Verdicts, n: int) -> Played:
    """The experiment's episodes, each initial distance as often, in portions that fit into memory."""
    sizes = [min(AT_ONCE, n - first) for first in range(0, n, AT_ONCE)]
    parts = [play_many(player, world, verdicts, "distances", size, SEED + number) for number, size in enumerate(sizes)]
    return Played(np.concatenate([part.distance for part in parts]), np.concatenate([part.steps for part in parts]))


def _trajectories(shelf: Shelf) -> Tables:
    """Fig. 8: the way from one corner to one goal, with perfect verdicts and without any."""
    world = shelf.world
    wanted = np.array([world.height - 1, world.width - 1]) * GOAL_AT
    start, goal = 0, int(np.abs(world.cells - wanted).sum(axis=1).argmin())
    rows: list[Row] = []
    for accuracy in (1.0, None):
        found = shelf.player("ours", accuracy)
        if found:
            told = {"map": world.name, "series": "ours", "accuracy": accuracy}
            rows += [told | row for row in _walked(found[0], world, verdicts_of(accuracy), start, goal)]
    return {"trajectories": rows}


def _walked(player: Player, world: GridWorld, verdicts: Verdicts, start: int, goal: int) -> Iterator[Row]:
    """Each step's cell and whether the move to it was an error, to the goal or for 60 steps."""
    rng = np.random.default_rng(SEED)
    simulator = Simulator(world, np.array([start]), np.array([goal]), verdicts(1, rng), rng, STEP_LIMIT)
    player.begin(simulator)
    aim = dict(zip(("goal_row", "goal_column"), world.cells[goal].tolist(), strict=True))
    error, over = False, False
    while True:
        row, column = world.cells[simulator.cell[0]].tolist()
        yield {"step": int(simulator.step_number[0]), "row": row, "column": column, "error": error} | aim
        if over:
            return
        outcome = simulator.step(player.act(simulator.view()))
        error, over = bool(outcome.error[0]), bool(outcome.done[0])


def _write_csv(path: Path, rows: list[Row]) -> None:
    """One line a row; a column that a row hasn't stays empty."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
