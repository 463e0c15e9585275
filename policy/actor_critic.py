"""The paper's recipe (IV.A-B): advantage actor-critic, a recurrent actor and a feed-forward critic with TD(lambda).

Read top-down: settings, critic, rollouts, losses, the loop. What the actor reads is the network's own affair.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import GridWorld
from policy.advantages import clipped_surrogate, generalised_advantages
from policy.descent import Descent, Progress, unheard
from policy.episodes import GOAL_REWARD, STEP_REWARD, Episodes, drawn
from policy.network import PAPER_WIDTH, Actor, action_log_probabilities
from policy.observation import STEP_LIMIT
from policy.processor import device, moved
from policy.simulator import Bools, Distribution, pair_weights
from policy.verdicts import Draw


@dataclass(frozen=True)
class ActorCriticSettings:
    """The recipe of one policy; stored beside its weights. Numbers without a source are ours."""

    seed: int = 0
    """Of weights, episodes, verdicts and actions."""
    n_episodes: int = 64
    """Episodes played in parallel."""
    n_steps: int = 20
    """Steps of each between updates, and the length of back-propagation through time."""
    n_minibatches: int = 1
    """Gradient steps an update, each on some of the episodes, never on a part of time; one makes it plain A2C."""
    updates: int = 12_000
    distribution: Distribution = "pairs"
    """Starts and goals are random (paper IV.A)."""
    learning_rate: float = 1e-3
    """Adam's, falling linearly to a twentieth."""
    discount: float = 0.98
    """Of the reward a step."""
    trace: float = 0.9
    """TD(lambda): 0 trusts the critic, 1 the returns."""
    epsilon_first: float = 0.5
    """Share of uniform actions at the beginning (paper IV.B)."""
    epsilon_last: float = 0.05
    """The same in the end (paper IV.B)."""
    annealed_over: int = 5500
    """Episodes over which it falls linearly (paper IV.B)."""
    clip: float = 0.2
    """Largest relative change of an action's probability an update rewards."""
    entropy: float = 0.01
    """Weight of the entropy bonus."""
    max_gradient: float = 0.5
    """Norm at which the gradient is clipped."""


class Critic(nn.Module):
    """Feed-forward, several ReLU layers. It sees the goal, so it serves in training only (asymmetric)."""

    def __init__(self, n_cells: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(2 * n_cells + 2, PAPER_WIDTH),
            nn.ReLU(),
            nn.Linear(PAPER_WIDTH, PAPER_WIDTH),
            nn.ReLU(),
            nn.Linear(PAPER_WIDTH, 1),
        )

    def forward(self, state: Tensor) -> Tensor:
        """Value of each full state, (...,), for states (..., n_inputs), in units of the goal's reward."""
        values: Tensor = self.layers(state).squeeze(-1)
        return values


@dataclass(frozen=True)
class Rollout:
    """What the actor lived through: tensors (n_steps, n, ...), except ``hidden``, (n, n_hidden), before the first step.

    ``inputs`` is the network's own named tuple. ``episode_starts`` is the mask the network was fed, ``ended`` marks
    steps after which an episode was over for either reason, ``following`` is the value after the last step, (n,).
    """

    inputs: Any
    legal: Tensor
    episode_starts: Tensor
    hidden: Tensor
    actions: Tensor
    log_probabilities: Tensor
    states: Tensor
    values: Tensor
    rewards: Tensor
    ended: Tensor
    following: Tensor
    epsilon: float


class Collector:
    """Plays episodes with the actor and keeps its memory from one rollout to the next."""

    def __init__(
        self, world: GridWorld, settings: ActorCriticSettings, draw: Draw, rng: np.random.Generator, n_hidden: int
    ) -> None:
        self.settings = settings
        weights = pair_weights(world, settings.distribution)
        self.episodes = Episodes(world, settings.n_episodes, weights, draw, rng, believes=False)
        self.hidden = torch.zeros(settings.n_episodes, n_hidden, device=device())
        self.episode_starts: Bools = np.ones(settings.n_episodes, bool)
        self.n_ended = 0

    def state(self) -> Tensor:
        """The critic's input, float32, (n, 2 n_cells + 2): goal, cell, distance and step."""
        world, simulator = self.episodes.world, self.episodes.simulator
        one_hot = np.eye(world.n_cells, dtype=np.float32)
        distance = world.distance[simulator.cell, simulator.goal] / world.distance.max()
        scalars = np.stack([distance, simulator.step_number / STEP_LIMIT], axis=1).astype(np.float32)
        state = np.concatenate([one_hot[simulator.goal], one_hot[simulator.cell], scalars], axis=1)
        return moved(torch.from_numpy(state))

    @torch.no_grad()
    def collect(self, network: Actor, critic: Critic) -> Rollout:
        """Play on; episodes that end start anew."""
        first_hidden = self.hidden.clone()
        epsilon = self._epsilon()
        steps = [self._step(network, critic, epsilon) for _ in range(self.settings.n_steps)]
        inputs = [step.pop("inputs") for step in steps]
        columns = {name: torch.stack([step[name] for step in steps]) for name in steps[0]}
        return Rollout(
            inputs=type(inputs[0])(*map(torch.stack, zip(*inputs, strict=True))),
            hidden=first_hidden,
            values=critic(columns["states"]),
            following=critic(self.state()),
            epsilon=epsilon,
            **columns,
        )

    def _step(self, network: Actor, critic: Critic, epsilon: float) -> dict[str, Any]:
        episodes = self.episodes
        inputs = network.look(episodes.world, episodes.simulator.view())
        inputs = moved(type(inputs)(*(part.clone() for part in inputs)))  # they share memory with the simulator
        before = {"legal": moved(episodes.legal()), "states": self.state()}
        starts = moved(torch.from_numpy(self.episode_starts))
        output = network(inputs, _fed(self.hidden, starts))
        log_all = action_log_probabilities(output.logits, before["legal"], epsilon)
        actions = drawn(log_all.cpu(), episodes.rng)
        outcome = episodes.move(actions.numpy())
        actions, ended = moved(actions), moved(torch.from_numpy(outcome.done))
        gained = (GOAL_REWARD * outcome.terminated + STEP_REWARD).astype(np.float32) / GOAL_REWARD
        rewards = moved(torch.from_numpy(gained))
        if outcome.truncated.any():
            # Nothing ended there but the clock: the future still has its value.
            cut = moved(torch.from_numpy(outcome.truncated))
            rewards[cut] += self.settings.discount * critic(self.state()[cut])
        episodes.renew(outcome.done)
        self.hidden, self.episode_starts = output.hidden, outcome.done
        self.n_ended += int(outcome.done.sum())
        taken = log_all.gather(1, actions[:, None])[:, 0]
        after = {"actions": actions, "log_probabilities": taken, "rewards": rewards}
        return {"inputs": inputs, "episode_starts": starts, "ended": ended, **before, **after}

    def _epsilon(self) -> float:
        """Falls linearly over the first episodes, then stays."""
        settings = self.settings
        done = min(self.n_ended / settings.annealed_over, 1.0)
        return settings.epsilon_first + done * (settings.epsilon_last - settings.epsilon_first)


def _fed(hidden: Tensor, starts: Tensor) -> Tensor:
    """The memory as the network gets it: empty where an episode starts."""
    return hidden * (~starts)[:, None]


def unroll(network: Actor, rollout: Rollout, which: Tensor) -> Tensor:
    """Action logits of the episodes ``which`` again, (n_steps, n_minibatch, 4), with gradients through time."""
    hidden = rollout.hidden[which]
    logits = []
    for step in range(len(rollout.legal)):
        inputs = type(rollout.inputs)(*(part[step][which] for part in rollout.inputs))
        output = network(inputs, _fed(hidden, rollout.episode_starts[step][which]))
        hidden = output.hidden
        logits.append(output.logits)
    return torch.stack(logits)


@dataclass(frozen=True)
class Losses:
    """Scalars of one minibatch, and the ratio of new to old action probabilities, (n_steps, n_minibatch)."""

    actor: Tensor
    critic: Tensor
    entropy: Tensor
    ratio: Tensor


def losses(network: Actor, critic: Critic, rollout: Rollout, advantage: Tensor, which: Tensor, clip: float) -> Losses:
    """All losses on the episodes ``which``, int64, (n_minibatch,)."""
    legal = rollout.legal[:, which]
    log_all = action_log_probabilities(unroll(network, rollout, which), legal, rollout.epsilon)
    log_taken = log_all.gather(2, rollout.actions[:, which, None])[:, :, 0]
    ratio = (log_taken - rollout.log_probabilities[:, which]).exp()
    gain = advantage[:, which]
    values = critic(rollout.states[:, which])
    return Losses(
        actor=-clipped_surrogate(ratio, gain, clip),
        critic=nn.functional.mse_loss(values, gain + rollout.values[:, which]),
        entropy=-(log_all.exp() * log_all.masked_fill(~legal, 0.0)).sum(dim=2).mean(),
        ratio=ratio,
    )


Trained = TypeVar("Trained", bound=Actor)


def train_actor_critic(
    network: Trained,
    world: GridWorld,
    draw: Draw,
    settings: ActorCriticSettings,
    progress: Progress = unheard,
) -> Trained:
    """Train an actor, fresh or half-trained, by reinforcement for decoders as ``draw`` gives them."""
    rng = np.random.default_rng(settings.seed)
    critic = Critic(world.n_cells).to(device())
    network.to(device())
    collector = Collector(world, settings, draw, rng, network.n_hidden)
    parameters = [*network.parameters(), *critic.parameters()]
    descent = Descent(parameters, settings.learning_rate, 1 / 20, settings.max_gradient)
    for update in range(settings.updates):
        descent.slow_down(1 - update / settings.updates)
        rollout = collector.collect(network, critic)
        advantage = generalised_advantages(
            rollout.rewards, rollout.values, rollout.following, rollout.ended, settings.discount, settings.trace
        )
        shuffled = moved(torch.from_numpy(rng.permutation(settings.n_episodes)))
        for which in shuffled.chunk(settings.n_minibatches):
            loss = losses(network, critic, rollout, advantage, which, settings.clip)
            descent.step(loss.actor + loss.critic - settings.entropy * loss.entropy)
        progress(update + 1, _figures(rollout, loss))
    return network.cpu().eval()


def _figures(rollout: Rollout, loss: Losses) -> dict[str, float]:
    return {
        "steps": rollout.ended.numel() / max(float(rollout.ended.sum()), 1.0),
        "critic": loss.critic.item(),
        "entropy": loss.entropy.item(),
        "ratio": loss.ratio.mean().item(),
    }
