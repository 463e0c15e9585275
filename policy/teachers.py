"""Teacher files: a planner and the search without verdicts of one map, so that they are made once and used often."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy.coverage import search_paths
from policy.descent import Progress, unheard
from policy.planner import Planner, PlannerSettings, train_planner
from policy.sealed import Damaged, opened, seal
from policy.simulator import Ints

_CARD = "teacher"
_PATHS = "search_paths"
SUFFIX = "_teacher.safetensors"
LAYOUT = "replanning-1"
"""Name and version of what a planner sees and starts from: to be changed with it."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """What the policies of one map are taught from.

    Attributes
    ----------
    planner : on the exact belief.
    paths : int64, (n_cells, n_steps), the search without verdicts, as ``coverage.search_paths`` gives it.
    settings : of the planner's training, as its file tells them.
    """

    planner: Planner
    paths: Ints
    settings: dict[str, Any]


def make(world: GridWorld, settings: PlannerSettings, progress: Progress = unheard) -> bytes:
    """Train a planner and lay down the search; the contents of a teacher file."""
    paths = search_paths(world)
    planner = train_planner(world, paths, settings, progress=progress)
    tensors = {**planner.state_dict(), _PATHS: torch.from_numpy(paths)}
    card = {"layout": LAYOUT, "map": world.name, "map_digest": world.digest, "settings": asdict(settings)}
    return seal(tensors, _CARD, json.dumps(card, sort_keys=True))


def read(contents: bytes, world: GridWorld, name: str) -> Lesson:
    """Take a teacher file apart; ``name`` stands in errors. SetupError when it is damaged or of another map."""
    try:
        tensors, text = opened(contents, _CARD)
        card = json.loads(text)
        settings = card["settings"]
        layout, paths = card.get("layout", "greedy-1"), tensors.pop(_PATHS).numpy()
        if card["map_digest"] == world.digest and layout == LAYOUT:
            planner = Planner(world, paths)
            planner.load_state_dict(tensors)
    except (Damaged, RuntimeError, KeyError, ValueError) as error:
        raise SetupError(
            f"'{name}' must be a teacher written by `bci-app train`, but can't be read as one ({error}). Delete it; "
            "the next training makes a new one."
        ) from error
    if card["map_digest"] != world.digest:
        raise SetupError(
            f"The teacher '{name}' knows map '{card['map']}' (digest {card['map_digest'][:12]}), not '{world.name}' "
            f"(digest {world.digest[:12]}). Give another folder, or delete it."
        )
    if layout != LAYOUT:
        raise SetupError(
            f"The teacher '{name}' is of layout '{layout}', this program's are '{LAYOUT}'. "
            "Train it anew in another folder."
        )
    return Lesson(planner.eval(), paths, settings)


def load(folder: Path, world: GridWorld) -> Lesson:
    """The lesson of a map from its file in a folder; errors as `read`'s, and SetupError when there is no such file."""
    path = path_of(folder, world)
    try:
        contents = path.read_bytes()
    except OSError as error:
        raise SetupError(
            f"The search and the planner of map '{world.name}' must be in {path}, but it can't be read ({error}). "
            f"Train them: bci-app train --map {world.name} --out {folder}"
        ) from error
    return read(contents, world, str(path))


def path_of(folder: Path, world: GridWorld) -> Path:
    """Where the teacher of a map is kept."""
    return folder / f"{world.name}{SUFFIX}"
