"""How good a policy is: steps to the goal and success, on many simulated episodes, with intervals."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import binomtest

from bci_app.gridworld import GridWorld
from policy.baselines import BayesFilter
from policy.network import HIDDEN, Network, greedy_actions
from policy.observation import STEP_LIMIT, View, encode
from policy.simulator import Bools, Distribution, Floats, Ints, Simulator, VerdictModel, pair_weights

UNLIMITED = 400  # steps at which an episode "without a limit" counts as lost


class Player(Protocol):
    """Whatever plays many episodes at once: a network or the Bayes filter."""

    def begin(self, view: View) -> None:
        """Start all episodes."""

    def act(self, view: View) -> Ints:
        """The next action of each episode, (n,); after a move, ``view`` is what it led to."""


class NetworkPlayer:
    """The likeliest action of a network (eps = 0), as the live agent takes it."""

    def __init__(self, network: Network, world: GridWorld) -> None:
        self.network, self.world = network, world

    def begin(self, view: View) -> None:
        """Empty the memory."""
        self.hidden = torch.zeros(len(view.cell), HIDDEN)

    @torch.no_grad()
    def act(self, view: View) -> Ints:
        """One step of the network."""
        inputs = torch.from_numpy(encode(self.world, view))
        logits, _, self.hidden = self.network(inputs, self.hidden)
        actions: Ints = greedy_actions(logits, torch.from_numpy(self.world.legal[view.cell])).numpy()
        return actions


class BayesPlayer:
    """The exact filter and its greedy move."""

    def __init__(self, world: GridWorld, weights: Floats, verdicts: VerdictModel, seed: int = 0) -> None:
        self.world, self.weights, self.verdicts = world, weights, verdicts
        self.rng = np.random.default_rng(seed)

    def begin(self, view: View) -> None:
        """Start from the prior."""
        n = len(view.cell)
        self.filter = BayesFilter(self.world, n, self.weights, self.verdicts)
        self.filter.begin(np.ones(n, bool), view)
        self._first = True

    def act(self, view: View) -> Ints:
        """Take in the last move, if there was one, and choose the next."""
        if not self._first:
            self.filter.update(view)
        self._first = False
        return self.filter.greedy(self.rng)


@dataclass(frozen=True)
class Result:
    """Figures of one evaluation.

    Attributes
    ----------
    n : episodes.
    steps : mean steps within the limit; an episode that fails counts with the limit (60).
    steps_half_width : of its 95 % interval (normal).
    unlimited_steps : mean steps when nobody stops the episode (at ``UNLIMITED``), as the paper's Table 1 counts.
    successful_steps : mean steps of the episodes that succeed.
    success : share of episodes that reach the goal within the limit.
    success_interval : its 95 % interval (Wilson 1927).
    """

    n: int
    steps: float
    steps_half_width: float
    unlimited_steps: float
    successful_steps: float
    success: float
    success_interval: tuple[float, float]


def evaluate(
    player: Player,
    world: GridWorld,
    verdicts: VerdictModel,
    distribution: Distribution,
    n: int = 5000,
    seed: int = 0,
    limit: int = STEP_LIMIT,
) -> Result:
    """Play ``n`` episodes and summarise them.

    Parameters
    ----------
    verdicts : the simulated decoder, which need not be the one the policy was trained with.
    distribution : ``pairs`` for random episodes, ``distances`` for the experiment's.
    """
    rng = np.random.default_rng(seed)
    simulator = Simulator(world, n, pair_weights(world, distribution), verdicts, rng, UNLIMITED)
    return summarise(play(player, simulator), limit)


def play(player: Player, simulator: Simulator) -> Ints:
    """Play every episode of a fresh simulator to its end: steps to the goal, (n,), ``limit`` + 1 where it failed.

    An episode that is over moves on with the others until all are; only its first arrival counts.
    """
    steps = np.full(simulator.n, simulator.limit + 1)
    player.begin(simulator.view())
    for step in range(1, simulator.limit + 1):
        arrived = simulator.step(player.act(simulator.view())).terminated
        steps[arrived & (steps > step)] = step
        if (steps <= step).all():
            break
    return steps


def summarise(steps: Ints, limit: int = STEP_LIMIT) -> Result:
    """The figures of episodes that took ``steps``, (n,), without a limit."""
    n, reached = len(steps), steps <= limit
    limited = np.minimum(steps, limit)
    return Result(
        n=n,
        steps=float(limited.mean()),
        steps_half_width=float(1.96 * limited.std() / np.sqrt(n)),
        unlimited_steps=float(steps.mean()),
        successful_steps=float(steps[reached].mean()) if reached.any() else float("nan"),
        success=float(reached.mean()),
        success_interval=wilson(reached),
    )


def wilson(success: Bools | NDArray[np.bool_]) -> tuple[float, float]:
    """Wilson's 95 % interval of a share (J. Am. Stat. Assoc. 22:209, 1927), from one bool an episode."""
    low, high = binomtest(int(np.sum(success)), len(success)).proportion_ci(method="wilson")
    return float(low), float(high)
