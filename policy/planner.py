"""A planner that beats the greedy moves: a feed-forward policy on the exact belief, found by reinforcement.

The belief is all that can be known, so this planner needs no memory and is quickly trained. It is the teacher of the
recurrent policies, which must make do with what they remember of their sensors.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.advantages import clipped_surrogate, generalised_advantages
from policy.belief import Belief, Nearness
from policy.descent import Descent, Progress, unheard
from policy.episodes import NEVER, Episodes, drawn
from policy.observation import STEP_LIMIT
from policy.processor import device, mixed_precision, moved
from policy.replanning import Replanning
from policy.simulator import Bools, Distribution, Ints, Outcome, pair_weights
from policy.verdicts import Floats, telling

DISCOUNTS = (0.3, 0.6, 0.8)
"""Of the nearness of the goal: for search without verdicts, for accuracies about 0.7, and for high ones (of 0.3, 0.5,
0.6, 0.7 and 0.8 the best at each; both maps, 20,000 episodes)."""
GREEDY = 1  # the discount whose greedy move the planner starts from where verdicts say much
SHARPNESS = 30.0  # of that move's probability: a worth 10 % lower is e^3 times rarer
REPLANS, LISTENS = 0.045, 0.1
"""Bits a verdict up to which the planner makes the move of the fewest expected steps, were nothing more to be learnt,
and from which on its own: accuracies of 0.62 and 0.68. Below, no training beat replanning; from 0.70 on the greedy move
is at least as good (both maps, 4000 episodes at each accuracy)."""
EAGERNESS = 3.0  # of that move's probability: one step more is e^3 times rarer, about as rare as SHARPNESS makes it


class Situation(NamedTuple):
    """What the planner sees: features (n, n_features), the logits it starts from (n, 4), how far it goes on from there
    with what it learnt, 0 to 1, (n, 1), and legal actions (n, 4)."""

    features: Tensor
    start: Tensor
    listens: Tensor
    legal: Tensor


class Planner(nn.Module):
    """Corrects the greedy move on the belief, or replans where verdicts say little.

    Parameters
    ----------
    world : the map.
    paths : (n_cells, n_steps), the search from each cell, as ``coverage.search_paths`` gives it.
    width : units of its two layers.
    """

    def __init__(self, world: GridWorld, paths: Ints, width: int = 128) -> None:
        super().__init__()
        self.world = world
        self.nearness, self.replanning = Nearness(world, DISCOUNTS), Replanning(world, paths)
        n_features = 2 * world.n_cells + (len(DISCOUNTS) + 1) * N_ACTIONS + 3
        self.body = nn.Sequential(nn.Linear(n_features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.correction = nn.Linear(width, N_ACTIONS)
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)
        # It sees the goal: it serves in training only (asymmetric critic).
        self.critic = nn.Sequential(
            nn.Linear(n_features + world.n_cells, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.worth = nn.Linear(width, 1)

    def look(self, belief: Belief, step: np.ndarray[tuple[int], np.dtype[np.int64]], information: Floats) -> Situation:
        """Everything the planner decides by; all inputs are of the order of one."""
        n, n_cells = belief.probability.shape
        legal = self.world.legal[belief.cell]
        worth = self.nearness.worth(belief)
        # Nothing is near where a belief has vanished, or a sure goal is beyond what 32 bits can tell of.
        best = np.maximum(worth.max(axis=2, keepdims=True), np.finfo(np.float32).tiny)
        behind = np.where(legal[:, None], worth, best) / best - 1
        cost = self.replanning.cost(belief)
        least = cost.min(axis=1, keepdims=True)
        spared = least - np.where(legal, cost, least)  # moves, at most 0
        features = np.zeros((n, 2 * n_cells + behind[0].size + N_ACTIONS + 3), np.float32)
        features[:, :n_cells] = 4 * belief.probability
        features[np.arange(n), n_cells + belief.cell] = 1
        features[:, 2 * n_cells : -3 - N_ACTIONS] = 5 * behind.reshape(n, -1)
        features[:, -3 - N_ACTIONS : -3] = spared
        features[:, -3] = 3 * (belief.probability**2).sum(axis=1)
        features[:, -2] = step / STEP_LIMIT
        features[:, -1] = 2 * information
        listens = np.clip((information - REPLANS) / (LISTENS - REPLANS), 0, 1)[:, None]
        start = ((1 - listens) * EAGERNESS * spared + listens * SHARPNESS * behind[:, GREEDY]).astype(np.float32)
        return Situation(*map(torch.from_numpy, (features, start, listens.astype(np.float32), legal)))

    def log_probabilities(self, situation: Situation, sharpening: float = 1.0) -> Tensor:
        """Of each action, (n, 4); illegal ones so small that they are never drawn."""
        logits = self.correction(self.body(situation.features)).float() * situation.listens + situation.start
        return torch.log_softmax((sharpening * logits).masked_fill(~situation.legal, NEVER), dim=1)

    def value(self, situation: Situation, goal: Tensor) -> Tensor:
        """Expected return, (n,), where ``goal``, int64, (n,), is known."""
        known = nn.functional.one_hot(goal, self.world.n_cells).float()
        value: Tensor = self.worth(self.critic(torch.cat([situation.features, known], dim=1))).float()[:, 0]
        return value


@dataclass(frozen=True)
class PlannerSettings:
    """How a planner is trained: proximal policy optimisation (Schulman et al. 2017) from the greedy moves."""

    seed: int = 0
    n_episodes: int = 4096
    """Episodes played in parallel."""
    n_steps: int = 12
    """Steps of each between updates."""
    n_minibatches: int = 12
    updates: int = 700
    critic_updates: int = 8
    """First updates that only teach the critic."""
    learning_rate: float = 1e-3
    """Adam's, falling linearly to a fiftieth."""
    trace: float = 0.95
    """Lambda of the advantages; the discount is 1, for a step costs the same whenever it is made."""
    clip: float = 0.2
    entropy: float = 0.003
    """Weight of the entropy bonus, falling to 0."""
    max_gradient: float = 0.5
    step_reward: float = -0.1
    limit: int = 120
    """Steps of an episode: beyond the 60 of the experiment, for the mean without a limit counts, too."""
    distribution: Distribution = "mixture"


def train_planner(
    world: GridWorld,
    paths: Ints,
    settings: PlannerSettings,
    progress: Progress = unheard,
) -> Planner:
    """Train a planner for all decoders it doesn't replan with; ``paths`` as `Planner` takes them."""
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    weights = pair_weights(world, settings.distribution)
    episodes = Episodes(world, settings.n_episodes, weights, telling(REPLANS), rng, settings.limit)
    planner = Planner(world, paths).to(device())
    descent = Descent(planner.parameters(), settings.learning_rate, 1 / 50, settings.max_gradient)
    for update in range(settings.updates):
        left = 1 - update / settings.updates
        descent.slow_down(left)
        batch = _collect(planner, episodes, settings)
        acts = update >= settings.critic_updates
        shuffled = moved(torch.from_numpy(rng.permutation(len(batch.actions))))
        for which in shuffled.chunk(settings.n_minibatches):
            descent.step(_loss(planner, batch.take(which), settings, acts, left))
        progress(update + 1, {"steps": batch.steps})
    return planner.cpu().eval()


@dataclass(frozen=True)
class _Batch:
    """Transitions side by side, (n_steps * n, ...)."""

    situation: Situation
    goals: Tensor
    actions: Tensor
    log_probabilities: Tensor
    advantages: Tensor
    returns: Tensor
    steps: float

    def take(self, which: Tensor) -> "_Batch":
        return _Batch(
            Situation(*(part[which] for part in self.situation)),
            self.goals[which],
            self.actions[which],
            self.log_probabilities[which],
            self.advantages[which],
            self.returns[which],
            self.steps,
        )


@torch.no_grad()
def _collect(planner: Planner, episodes: Episodes, settings: PlannerSettings) -> _Batch:
    steps = []
    with mixed_precision():
        for _ in range(settings.n_steps):
            situation, goal = _situation(planner, episodes)
            log_all = planner.log_probabilities(situation)
            actions = drawn(log_all.cpu(), episodes.rng)
            outcome = episodes.move(actions.numpy())
            actions = moved(actions)
            rewards, ended = _rewards(planner, episodes, outcome, settings.step_reward)
            episodes.renew(outcome.done)
            taken = log_all.gather(1, actions[:, None])[:, 0]
            steps.append((situation, goal, actions, taken, planner.value(situation, goal), rewards, ended))
        following = planner.value(*_situation(planner, episodes))
    seen, *columns = zip(*steps, strict=True)
    goals, actions, taken, values, rewards, ended = (torch.stack(column) for column in columns)
    advantage = generalised_advantages(rewards, values, following, ended, 1.0, settings.trace)
    return _Batch(
        Situation(*(torch.cat(parts) for parts in zip(*seen, strict=True))),
        goals.flatten(),
        actions.flatten(),
        taken.flatten(),
        advantage.flatten(),
        (advantage + values).flatten(),
        ended.numel() / max(float(ended.sum()), 1.0),
    )


def _situation(planner: Planner, episodes: Episodes) -> tuple[Situation, Tensor]:
    simulator = episodes.simulator
    situation = planner.look(episodes.belief, simulator.step_number, simulator.decoders.information)
    return moved(situation), moved(torch.from_numpy(simulator.goal.copy()))


def _rewards(planner: Planner, episodes: Episodes, outcome: Outcome, reward: float) -> tuple[Tensor, Tensor]:
    """Rewards of a step and whether it ended its episode; one cut short is worth what its critic expects."""
    rewards = torch.full((episodes.n,), reward, device=device())
    cut: Bools = outcome.truncated
    if cut.any():
        which = moved(torch.from_numpy(cut))
        rewards[which] += planner.value(*_situation(planner, episodes))[which]
    return rewards, moved(torch.from_numpy(outcome.done))


def _loss(planner: Planner, batch: _Batch, settings: PlannerSettings, acts: bool, left: float) -> Tensor:
    with mixed_precision():
        log_all = planner.log_probabilities(batch.situation)
        values = planner.value(batch.situation, batch.goals)
    critic = 0.5 * nn.functional.mse_loss(values, batch.returns)
    if not acts:
        return critic
    ratio = (log_all.gather(1, batch.actions[:, None])[:, 0] - batch.log_probabilities).exp()
    surrogate = clipped_surrogate(ratio, batch.advantages, settings.clip)
    entropy = -(log_all.exp() * log_all.clamp(min=-20)).sum(dim=1).mean()
    return critic - surrogate - settings.entropy * left * entropy
