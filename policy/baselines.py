"""What is reachable without learning: the exact Bayes filter with a greedy move, a search without verdicts, an oracle.

Each is a `Player` of `policy.evaluation`.
"""

import numpy as np
import torch

from bci_app.gridworld import GridWorld
from policy.belief import Belief, Nearness
from policy.coverage import searching
from policy.observation import View
from policy.planner import Planner
from policy.replanning import Replanning
from policy.simulator import Bools, Floats, Ints, Simulator

NEARNESS, NEARNESS_WITHOUT_VERDICTS = 0.6, 0.3
"""Discounts of the greedy move. Of 0.3, 0.5, 0.6, 0.7 and 0.8 the first is at most 0.15 steps from the best at every
accuracy from 0.6 on, on both maps; the second is the best without verdicts on `open` (20,000 episodes each)."""


class BeliefPlayer:
    """Keeps the exact belief of every episode beside what it plays.

    Parameters
    ----------
    world : the map.
    weights : (n_cells, n_cells), probability of each start and goal: the filter's prior.
    """

    def __init__(self, world: GridWorld, weights: Floats) -> None:
        self.world, self.weights = world, weights
        self._belief: Belief | None = None

    def begin(self, simulator: Simulator) -> None:
        """Start from the prior."""
        self._belief = None

    def believe(self, view: View) -> Belief:
        """Take in what the last move led to."""
        if self._belief is None:
            self._belief = Belief(self.world, self.weights, view)
        else:
            self._belief.update(view)
        return self._belief

    def keep(self, which: Bools) -> None:
        """Forget the other episodes."""
        assert self._belief is not None
        self._belief.keep(which)


class BayesPlayer(BeliefPlayer):
    """The exact filter, and the action that most likely brings the goal near."""

    def begin(self, simulator: Simulator) -> None:
        """Start from the prior."""
        super().begin(simulator)
        informed = bool(simulator.decoders.information.any())
        self._nearness = Nearness(self.world, (NEARNESS if informed else NEARNESS_WITHOUT_VERDICTS,))
        self._rng = np.random.default_rng(0)

    def act(self, view: View) -> Ints:
        """The action of most worth; of equally good ones one is drawn."""
        worth = self._nearness.worth(self.believe(view))[:, 0]
        actions: Ints = np.argmax(worth * (1 + 1e-6 * self._rng.random(worth.shape)), axis=1)
        return actions


class ReplanningPlayer(BeliefPlayer):
    """The action of the fewest expected moves, were nothing more to be learnt on the way."""

    def __init__(self, world: GridWorld, weights: Floats, paths: Ints) -> None:
        super().__init__(world, weights)
        self._replanning = Replanning(world, paths)

    def act(self, view: View) -> Ints:
        """The first of the cheapest actions."""
        actions: Ints = self._replanning.cost(self.believe(view)).argmin(axis=1)
        return actions


class PlannerPlayer(BeliefPlayer):
    """The likeliest action of a planner on the exact belief."""

    def __init__(self, planner: Planner, weights: Floats) -> None:
        super().__init__(planner.world, weights)
        self.planner = planner

    @torch.no_grad()
    def act(self, view: View) -> Ints:
        """One look at the belief."""
        seen = self.planner.look(self.believe(view), view.step, view.information)
        actions: Ints = self.planner.log_probabilities(seen).argmax(dim=1).numpy()
        return actions


class SearchPlayer:
    """A laid-down search, until the goal is sensed. It never listens to a verdict.

    Parameters
    ----------
    paths : (n_cells, n_steps), as ``coverage.search_paths`` gives them.
    """

    def __init__(self, paths: Ints) -> None:
        self.paths = paths

    def begin(self, simulator: Simulator) -> None:
        """Take the path of each start."""
        self._path = self.paths[simulator.cell]

    def act(self, view: View) -> Ints:
        """The next action of the path, or the one that leads to the goal."""
        return searching(self._path, view.step, view.sensed)

    def keep(self, which: Bools) -> None:
        """Forget the other episodes."""
        self._path = self._path[which]


class OraclePlayer:
    """A shortest path to the goal, which it is told: nobody can do better."""

    def __init__(self, world: GridWorld) -> None:
        self.world = world

    def begin(self, simulator: Simulator) -> None:
        """Look where the goals are."""
        self._goal = simulator.goal

    def act(self, view: View) -> Ints:
        """The first of the actions that lead nearer."""
        left = self.world.distance[self.world.next_cell[view.cell], self._goal[:, None]]
        actions: Ints = left.argmin(axis=1)
        return actions

    def keep(self, which: Bools) -> None:
        """Forget the other episodes."""
        self._goal = self._goal[which]
