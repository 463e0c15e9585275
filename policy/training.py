"""Training one policy from start to finish: a job in, the contents of a policy file out.

A job runs in any process, on any machine: it carries its map and what it starts from, and knows no folder.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
import torch
from torch import nn

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy import teachers
from policy.actor_critic import ActorCriticSettings, train_actor_critic
from policy.cards import PolicyCard, Recipe, policy_name
from policy.checkpoint import pack, rounded, unpack
from policy.distillation import DistillationSettings, distil
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Actor, Network, PaperNetwork, ToldNetwork
from policy.observation import STEP_LIMIT
from policy.planner import PlannerSettings
from policy.processor import arithmetic, device, keep_memory
from policy.recitation import RecitationSettings, recite
from policy.simulator import Distribution
from policy.verdicts import Verdicts

MISSING = 0.03
"""Share of missing verdicts in training by our recipe, as artefacts cause; the told policy meets up to 0.3."""
CURVE_POINTS = 100
"""Of a learning curve: moves played, and mean steps of an episode meanwhile."""
TESTED: tuple[Distribution, ...] = ("pairs", "distances")
"""Starts and goals its card's figures are of."""
TEST_EPISODES = 5000
"""Episodes its card's figures are of."""

Progress = Callable[[int, int, str], None]
"""Called with updates done, updates in all, and a word on how it goes."""


@dataclass(frozen=True)
class TeacherJob:
    """Train the teacher of one map.

    Attributes
    ----------
    world : the map itself, for on another machine its file may be missing, or be another.
    settings : of the planner.
    """

    world: GridWorld = field(repr=False)
    settings: PlannerSettings = field(default_factory=PlannerSettings)

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.world.name} teacher"

    @property
    def cost(self) -> float:
        """Moves to play: what the jobs' times go by."""
        return float(self.settings.updates * self.settings.n_steps * self.settings.n_episodes)

    def run(self, progress: Progress = lambda done, of, word: None) -> bytes:
        """The contents of a teacher file. Raises SetupError when the training diverges."""
        _settle()

        def show(update: int, figures: dict[str, float]) -> None:
            progress(update, self.settings.updates, f"{figures['steps']:.1f} steps an episode")

        contents = teachers.make(self.world, self.settings, show)
        _check_finite(
            teachers.read(contents, self.world, self.name).planner, self.name, "With --quick it needs no training."
        )
        return contents


@dataclass(frozen=True)
class PolicyJob:
    """Train one policy.

    Attributes
    ----------
    world : the map itself, for on another machine its file may be missing, or be another.
    verdicts : what to train with.
    settings : of the recipe, which they thereby choose: recitation of the search, distillation, or the paper's.
    teacher : contents of the map's teacher file; our recipe needs it.
    search : contents of the policy without verdicts, that the told policy becomes where verdicts say nothing.
    start : contents of a told policy to go on from.
    """

    world: GridWorld = field(repr=False)
    verdicts: Verdicts
    settings: RecitationSettings | DistillationSettings | ActorCriticSettings
    teacher: bytes | None = field(default=None, repr=False)
    search: bytes | None = field(default=None, repr=False)
    start: bytes | None = field(default=None, repr=False)

    @property
    def recipe(self) -> Recipe:
        """Ours, or the paper's."""
        return "paper" if isinstance(self.settings, ActorCriticSettings) else "ours"

    @property
    def name(self) -> str:
        """Name of its file without the ending."""
        return policy_name(self.world.name, self.verdicts, self.recipe)

    @property
    def cost(self) -> float:
        """Moves to play: what the jobs' times go by."""
        return float(self.settings.updates * self._moves)

    @property
    def _moves(self) -> int:
        """Moves of an update."""
        if isinstance(self.settings, RecitationSettings):
            return self.world.n_cells * STEP_LIMIT  # about what the longest path has
        return self.settings.n_steps * self.settings.n_episodes

    def run(self, progress: Progress = lambda done, of, word: None) -> bytes:
        """The contents of a policy file. Raises SetupError when the training diverges."""
        _settle()
        started, settings = perf_counter(), self.settings
        curve: list[tuple[int, float]] = []
        recent: list[float] = []

        def show(update: int, figures: dict[str, float]) -> None:
            recent.append(figures.get("steps", np.nan))  # reciting plays no episodes
            if update % max(settings.updates // CURVE_POINTS, 1) == 0:
                curve.append((update * self._moves, float(np.mean(recent))))
                recent.clear()
            progress(update, settings.updates, ", ".join(f"{name} {value:.2f}" for name, value in figures.items()))

        network = rounded(self._train(show))
        # Before it is tested: an episode it can't finish would last for ever.
        _check_finite(network, self.name, "Train it with another --seed.")
        return pack(network, self._card(network, curve, perf_counter() - started))

    def _train(self, show: Callable[[int, dict[str, float]], None]) -> Actor:
        world, settings = self.world, self.settings
        if isinstance(settings, ActorCriticSettings):
            torch.manual_seed(settings.seed)
            return train_actor_critic(PaperNetwork(world.n_cells), world, self.verdicts, settings, show)
        assert self.teacher is not None, "our recipe needs a teacher"
        lesson = teachers.read(self.teacher, world, f"{world.name}{teachers.SUFFIX}")
        if isinstance(settings, RecitationSettings):
            return recite(world, lesson.paths, settings, show)
        listening = distil(world, lesson.planner, self.verdicts, settings, show, self._listening())
        if self.verdicts.kind != "told":
            return listening
        assert self.search is not None, "the told policy needs a search"
        told = ToldNetwork(world.n_cells, listening.n_hidden)
        told.listening.load_state_dict(listening.state_dict())
        told.searching.load_state_dict(unpack(self.search, "search")[0].state_dict())
        return told

    def _listening(self) -> Network | None:
        """What to go on from."""
        if self.start is None:
            return None
        told, _ = unpack(self.start, "start")
        assert isinstance(told, ToldNetwork), "one goes on from a told policy"
        return told.listening

    def _card(self, network: Actor, curve: list[tuple[int, float]], seconds: float) -> PolicyCard:
        world = self.world
        player = NetworkPlayer(network, world)
        tested = Verdicts("score", (0.75,)) if self.verdicts.kind == "told" else self.verdicts
        results = {name: asdict(evaluate(player, world, tested, name, TEST_EPISODES, seed=1)) for name in TESTED}
        story: dict[str, Any] = {
            "settings": asdict(self.settings),
            "missing": self.verdicts.missing,
            "start": unpack(self.start, "start")[1].name if self.start else None,
            "minutes": round(seconds / 60, 2),
            "curve": [[moves, round(steps, 2)] for moves, steps in curve if np.isfinite(steps)],
            "versions": {"torch": str(torch.__version__), "numpy": np.__version__},
            # The same seed gives other weights on another device or in another arithmetic.
            "device": device().type,
            "arithmetic": "float32" if self.recipe == "paper" else arithmetic(),
            "evaluated_with": f"{tested}, {tested.missing:g} of them missing",
            "evaluation": results,
        }
        return PolicyCard(
            world.name,
            world.digest,
            str(self.verdicts),
            self.recipe,
            network.layout,
            world.n_cells,
            network.n_hidden,
            story,
        )


def _check_finite(module: nn.Module, name: str, advice: str) -> None:
    """Raise SetupError unless all weights are numbers one can compute with."""
    if not all(tensor.isfinite().all() for tensor in module.state_dict().values()):
        raise SetupError(
            f"The training of {name} diverged: some of its weights are no finite numbers, so it isn't kept. {advice}"
        )


def _settle() -> None:
    """Make a process one that trains."""
    # Small matrices: more threads only wait for each other, and the order of a sum mustn't depend on their number.
    torch.set_num_threads(1)
    keep_memory()
