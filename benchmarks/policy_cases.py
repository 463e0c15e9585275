"""What policy_steps.py compares: every case by map; each is played once and kept as soon as it is finished."""

import ast
import base64
import hashlib
import json
import random
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch

from bci_app.gridworld import load_map
from bci_app.progress import Progress
from policy import (
    baselines,
    belief,
    coverage,
    evaluation,
    network,
    observation,
    planner,
    players,
    replanning,
    simulator,
    verdicts,
)
from policy.cards import SUFFIX, policy_name
from policy.evaluation import Played, play_many
from policy.library import ACCURACIES, TOLD, WITHOUT
from policy.players import BASELINES, player_of
from policy.simulator import Distribution
from policy.teachers import path_of
from policy.verdicts import Verdicts

SCORES = (*ACCURACIES[:-1], 0.99)
NEAR_CHANCE = (0.52, 0.54, 0.55, 0.56, 0.58, 0.60)
OFF = 0.10
"""Points by which an accuracy is told wrongly, and the lowest and highest that may be told."""
LOWEST, HIGHEST = 0.505, 0.999
MISSING = (0.1, 0.2, 0.4)
PLAYED_BY = (
    *(baselines, belief, coverage, evaluation, network, observation, planner),
    *(players, replanning, simulator, verdicts),
)
"""Modules on whose code the steps depend."""


@dataclass(frozen=True)
class Play:
    """A player on many episodes.

    Attributes
    ----------
    map : a shipped map.
    player : a baseline's name, or a policy file's path.
    verdicts : as the decoder gives them, and what the player takes them for.
    distribution : of starts and goals.
    """

    map: str
    player: str
    verdicts: Verdicts
    distribution: Distribution = "pairs"

    def run(self, folder: Path, episodes: int, seed: int) -> Played:
        """Play them; ``folder`` holds the teachers of the planner and the sweep."""
        torch.set_num_threads(1)
        world = load_map(self.map)
        player, heard = player_of(self.player, world, self.verdicts, folder)
        return play_many(player, world, heard, self.distribution, episodes, seed)

    def key(self, folder: Path, episodes: int, seed: int) -> dict[str, Any]:
        """Everything the outcome depends on, ready for JSON; equal for plays that would end alike."""
        world = load_map(self.map)
        file = {"bayes": None, **dict.fromkeys(("planner", "sweep", "replan"), path_of(folder, world))}
        return {
            "map": world.digest,
            "player": self.player if self.player in BASELINES else "policy",
            "file": _sha256(file.get(self.player, Path(self.player))),
            "verdicts": asdict(self.verdicts),
            "distribution": self.distribution,
            "episodes": episodes,
            "seed": seed,
            "code": _code(),
        }


@dataclass(frozen=True)
class Person:
    """Somebody's hit rate and correct rejection rate: the true ones, and as their decoder would tell them."""

    name: str
    true: tuple[float, float]
    told: tuple[float, float]


@dataclass(frozen=True)
class Row:
    """What stands side by side in a table: who plays in each role, all on the same starts and goals."""

    table: str
    map: str
    label: str
    plays: dict[str, Play]


def read_people(path: Path) -> list[Person]:
    """Everybody's rates from their counts; told by Jeffreys' rule: no rate of so few moves is 0 or 1."""
    lines = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    people = []
    for name, *counts in lines[1:]:
        n_error, hits, n_correct, rejections = map(int, counts)
        told = (hits + 0.5) / (n_error + 1), (rejections + 0.5) / (n_correct + 1)
        people.append(Person(name, (hits / n_error, rejections / n_correct), told))
    return people


def rows(name: str, people: list[Person], policies: Path, special: Path | None) -> Iterator[Row]:
    """All rows of one map; a role is left out where its policy isn't in the folder."""

    def policy(kind: Verdicts, folder: Path | None = policies, paper: bool = False) -> str | None:
        path = (folder or policies) / (policy_name(name, kind, "paper" if paper else "ours") + SUFFIX)
        return str(path) if folder and path.exists() else None

    def plays(kind: Verdicts, roles: Mapping[str, str | None]) -> dict[str, Play]:
        return {role: Play(name, player, kind) for role, player in roles.items() if player}

    told = policy(TOLD)
    known: dict[str, str | None] = {"Bayes": "bayes", "planner": "planner"}
    without = plays(WITHOUT, {"none": policy(WITHOUT)})

    for kind in (WITHOUT, *_accurate("binary", ACCURACIES)):
        sweep = "sweep" if kind == WITHOUT else None
        library: dict[str, str | None] = {
            "specialised": policy(kind),
            "told": told,
            "paper": policy(kind, paper=True),
            "sweep": sweep,
        }
        yield Row("binary", name, _label(kind), plays(kind, known | library))
    for kind in _accurate("score", SCORES):
        yield Row("score", name, _label(kind), plays(kind, known | {"told": told}) | without)
    for kind in (*_accurate("binary", NEAR_CHANCE), *_accurate("score", NEAR_CHANCE)):
        yield Row("near chance", name, f"{kind.kind} {_label(kind)}", plays(kind, known | {"told": told}) | without)
    for person in people:
        true = Verdicts("rates", person.true)
        as_told = _taken_for(true, Verdicts("rates", person.told))
        alone = plays(true, {"specialised": policy(true, special)})
        yield Row("real", name, person.name, plays(as_told, known | {"told": told}) | alone | without)
    for kind in (*_accurate("binary", ACCURACIES), *_accurate("score", SCORES)):
        for shift in (-OFF, OFF):
            wrong = Verdicts(kind.kind, (round(min(max(kind.numbers[0] + shift, LOWEST), HIGHEST), 3),))
            pair = plays(kind, {"rightly": told}) | plays(_taken_for(kind, wrong), {"wrongly": told})
            yield Row("wrongly told", name, f"{kind.kind} {_label(kind)} told {wrong.numbers[0]:g}", pair)
    for kind in (*_accurate("binary", (0.7, 0.8)), *_accurate("score", (0.7, 0.8))):
        for missing in MISSING:
            some = Verdicts(kind.kind, kind.numbers, missing)
            pair = plays(some, {"Bayes": "bayes", "told": told}) | plays(kind, {"told all": told})
            yield Row("missing", name, f"{kind.kind} {_label(kind)}, {missing:.0%} missing", pair)


def _accurate(kind: verdicts.Kind, accuracies: Iterable[float]) -> list[Verdicts]:
    return [Verdicts(kind, (accuracy,)) for accuracy in accuracies]


def _taken_for(kind: Verdicts, other: Verdicts) -> Verdicts:
    return kind if kind == other else Verdicts(kind.kind, kind.numbers, kind.missing, other)


def _label(kind: Verdicts) -> str:
    return f"{kind.numbers[0]:.2f}" if kind.numbers else "none"


def play_all(
    plays: Iterable[Play], folder: Path, episodes: int, seed: int, path: Path | None, progress: Progress
) -> dict[Play, Played]:
    """Play what the file ``path`` doesn't hold yet, on all cores, and add each to it as soon as it is finished."""
    keys = {play: json.dumps(play.key(folder, episodes, seed), sort_keys=True) for play in plays}
    found = _kept(path) if path else {}
    left = {key: play for play, key in keys.items() if key not in found}
    order = random.Random(0).sample(sorted(left), len(left))  # long and short ones mixed: the time to go is right
    done = len(set(keys.values())) - len(left)
    progress("playing", done, done + len(left))
    run = joblib.Parallel(n_jobs=-1, return_as="generator_unordered")
    for key, played in run(joblib.delayed(_run)(key, left[key], folder, episodes, seed) for key in order):
        found[key] = played
        if path:
            _keep(path, key, played)
        done += 1
        progress("playing", done, len(set(keys.values())))
    return {play: found[key] for play, key in keys.items()}


def _run(key: str, play: Play, folder: Path, episodes: int, seed: int) -> tuple[str, Played]:
    return key, play.run(folder, episodes, seed)


def _keep(path: Path, key: str, played: Played) -> None:
    """Add a line; distances and steps are 16 bits each, compressed."""
    both = zlib.compress(np.stack([played.distance, played.steps]).astype("<u2").tobytes())
    line = json.dumps({"key": json.loads(key), "played": base64.b64encode(both).decode()})
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def _kept(path: Path) -> dict[str, Played]:
    """Whatever is whole in the file; a line that an interruption cut off is taken away."""
    contents = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = contents[: contents.rfind("\n") + 1]
    if whole != contents:
        path.write_text(whole, encoding="utf-8")
    found = {}
    for line in whole.splitlines():
        entry = json.loads(line)
        both = np.frombuffer(zlib.decompress(base64.b64decode(entry["played"])), "<u2").astype(np.int64)
        found[json.dumps(entry["key"], sort_keys=True)] = Played(*both.reshape(2, -1))
    return found


@cache
def _sha256(path: Path | None) -> str | None:
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def _code() -> str:
    """SHA-256 of the modules that play, without comments and docstrings."""
    digest = hashlib.sha256()
    for module in PLAYED_BY:
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                node.value.value = ""
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()
