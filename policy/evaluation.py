"""How good a policy is: steps to the goal and success, on many simulated episodes, with intervals."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import binomtest

from bci_app.gridworld import GridWorld
from policy.network import Actor, greedy_actions
from policy.observation import STEP_LIMIT, View
from policy.simulator import MAX_DISTANCE, MIN_DISTANCE, Bools, Distribution, Ints, Pairs, Simulator, pair_weights
from policy.verdicts import Draw, HeldOut

UNLIMITED = 400  # steps at which an episode "without a limit" counts as lost


class Player(Protocol):
    """Whatever plays many episodes at once: a network, the Bayes filter, a search."""

    def begin(self, simulator: Simulator) -> None:
        """Start all episodes."""

    def act(self, view: View) -> Ints:
        """The next action of each episode, (n,); after a move, ``view`` is what it led to."""

    def keep(self, which: Bools) -> None:
        """Go on with the episodes of the mask ``which`` only."""


class NetworkPlayer:
    """The likeliest action of a network (eps = 0), as the live agent takes it."""

    def __init__(self, network: Actor, world: GridWorld) -> None:
        self.network, self.world = network, world

    def begin(self, simulator: Simulator) -> None:
        """Empty the memory."""
        self.hidden = torch.zeros(simulator.n, self.network.n_hidden)

    @torch.no_grad()
    def act(self, view: View) -> Ints:
        """One step of the network."""
        output = self.network(self.network.look(self.world, view), self.hidden)
        self.hidden = output.hidden
        actions: Ints = greedy_actions(output.logits, torch.from_numpy(self.world.legal[view.cell])).numpy()
        return actions

    def keep(self, which: Bools) -> None:
        """Forget the other episodes."""
        self.hidden = self.hidden[torch.from_numpy(which)]


@dataclass(frozen=True)
class Played:
    """What became of each episode, (n,): initial distance, and steps to the goal, ``UNLIMITED`` where it was lost."""

    distance: Ints
    steps: Ints


@dataclass(frozen=True)
class Result:
    """Figures of one evaluation; intervals are of 95 %.

    Attributes
    ----------
    episodes : how many.
    mean_steps : to the goal when nobody stops the episode, as the paper's Table 1 counts; lost ones count 400.
    mean_steps_ci : its interval (normal).
    mean_steps_60 : the same where an episode that isn't over after 60 steps counts 60, as in the experiment.
    success_60 : share of episodes that reach the goal within 60 steps.
    success_60_ci : its interval (Wilson, J. Am. Stat. Assoc. 22:209, 1927).
    success_60_by_distance : the same for each initial distance 2 .. 20 that occurs.
    success_60_by_distance_mean : their mean, as the paper gives it.
    """

    episodes: int
    mean_steps: float
    mean_steps_ci: tuple[float, float]
    mean_steps_60: float
    success_60: float
    success_60_ci: tuple[float, float]
    success_60_by_distance: dict[int, float]
    success_60_by_distance_mean: float


def evaluate(
    player: Player,
    world: GridWorld,
    draw: Draw | HeldOut,
    distribution: Distribution = "pairs",
    n: int = 20_000,
    seed: int = 0,
) -> Result:
    """Play ``n`` episodes and summarise them; the same seed gives the same starts and goals to every player.

    Parameters
    ----------
    draw : the simulated decoders, which need not be what the policy was trained with.
    distribution : ``pairs`` for random episodes, ``distances`` for the experiment's.
    """
    return summarise(play_many(player, world, draw, distribution, n, seed))


def report(player: Player, world: GridWorld, draw: Draw | HeldOut, n: int, seed: int) -> dict[str, Any]:
    """The figures that policies are compared by, ready for JSON.

    Steps and success over random starts and goals; and success where every initial distance 2 .. 20 is met as often,
    as in the experiment, in as many episodes of their own: among random ones the far distances hardly occur.
    """
    pairs = evaluate(player, world, draw, "pairs", n, seed)
    distances = evaluate(player, world, draw, "distances", n, seed)
    return {
        "episodes": n,
        "mean_steps": pairs.mean_steps,
        "mean_steps_ci": pairs.mean_steps_ci,
        "success_60": pairs.success_60,
        "success_60_ci": pairs.success_60_ci,
        "success_60_by_distance_mean": distances.success_60_by_distance_mean,
        "success_60_by_distance": distances.success_60_by_distance,
        "experiment": {
            "mean_steps": distances.mean_steps,
            "mean_steps_ci": distances.mean_steps_ci,
            "mean_steps_60": distances.mean_steps_60,
            "success_60_ci": distances.success_60_ci,
        },
    }


def play_many(
    player: Player, world: GridWorld, draw: Draw | HeldOut, distribution: Distribution, n: int, seed: int
) -> Played:
    """Play ``n`` episodes."""
    start, goal = Pairs(pair_weights(world, distribution)).spread(n, np.random.default_rng(seed))
    rng = np.random.default_rng([seed, 1])  # of the verdicts: apart, so that all players meet the same episodes
    simulator = Simulator(world, start, goal, draw(n, rng), rng, UNLIMITED)
    return Played(world.distance[start, goal], play(player, simulator))


def play(player: Player, simulator: Simulator) -> Ints:
    """Play every episode of a fresh simulator to its end: steps to the goal, (n,), ``limit`` where it failed."""
    steps = np.full(simulator.n, simulator.limit)
    playing = np.arange(simulator.n)
    player.begin(simulator)
    while len(playing):
        outcome = simulator.step(player.act(simulator.view()))
        steps[playing[outcome.done]] = simulator.step_number[outcome.done]
        if outcome.done.any():
            playing = playing[~outcome.done]
            player.keep(~outcome.done)
            simulator.keep(~outcome.done)
    return steps


def summarise(played: Played) -> Result:
    """The figures of what was played."""
    steps, n = played.steps, len(played.steps)
    reached = steps <= STEP_LIMIT
    mean, half = float(steps.mean()), float(1.96 * steps.std() / np.sqrt(n))
    distances = range(MIN_DISTANCE, MAX_DISTANCE + 1)
    by_distance = {d: float(reached[played.distance == d].mean()) for d in distances if (played.distance == d).any()}
    return Result(
        episodes=n,
        mean_steps=mean,
        mean_steps_ci=(mean - half, mean + half),
        mean_steps_60=float(np.minimum(steps, STEP_LIMIT).mean()),
        success_60=float(reached.mean()),
        success_60_ci=wilson(reached),
        success_60_by_distance=by_distance,
        success_60_by_distance_mean=float(np.mean(list(by_distance.values()))),
    )


def paired_ratio(played: Played, other: Played) -> tuple[float, float, float]:
    """Mean steps of one player over another's on the same starts and goals, and the ratio's 95 % interval.

    The interval is of the ratio estimator over pairs of episodes (delta method; Cochran, Sampling Techniques, 3rd ed.
    1977, chapter 6): what a hard episode costs both doesn't widen it.

    Raises ValueError when they didn't play the same episodes.
    """
    if not np.array_equal(played.distance, other.distance):
        raise ValueError("A paired ratio needs two players of the same episodes; the distances differ.")
    ratio = float(played.steps.mean() / other.steps.mean())
    left = played.steps - ratio * other.steps  # its mean is 0
    half = float(1.96 * left.std() / np.sqrt(len(left)) / other.steps.mean())
    return ratio, ratio - half, ratio + half


def wilson(success: NDArray[np.bool_]) -> tuple[float, float]:
    """Wilson's 95 % interval of a share, from one bool an episode."""
    low, high = binomtest(int(np.sum(success)), len(success)).proportion_ci(method="wilson")
    return float(low), float(high)
