"""What the actor lived through, for a few steps of many episodes: the data of one update."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bci_app.gridworld import GridWorld
from policy.baselines import BayesFilter
from policy.network import HIDDEN, Critic, Network, action_log_probabilities
from policy.observation import STEP_LIMIT, encode
from policy.simulator import Bools, Floats, Simulator, VerdictModel

GOAL_REWARD = 20.0  # paper IV.A; rewards and values are kept in units of it
STEP_REWARD = -0.01  # paper IV.A


@dataclass(frozen=True)
class Rollout:
    """Tensors of shape (n_steps, n, ...), except ``hidden``, (n, HIDDEN), which is before the first step.

    ``episode_starts`` is the mask the network was fed; ``ended`` marks steps after which an episode was over
    for either reason; ``next_values`` is zero after termination and the critic's value after truncation.
    """

    inputs: Tensor
    legal: Tensor
    episode_starts: Tensor
    hidden: Tensor
    actions: Tensor
    log_probabilities: Tensor
    states: Tensor
    values: Tensor
    rewards: Tensor
    ended: Tensor
    next_values: Tensor
    beliefs: Tensor
    taught: Tensor
    epsilon: float


class Collector:
    """Plays episodes with the actor, with a Bayes filter beside it as teacher and as part of the critic's state."""

    def __init__(
        self, world: GridWorld, n: int, weights: Floats, verdicts: VerdictModel, rng: np.random.Generator
    ) -> None:
        self.world, self.rng = world, rng
        self.simulator = Simulator(world, n, weights, verdicts, rng)
        self.filter = BayesFilter(world, n, weights, verdicts)
        self.filter.begin(np.ones(n, bool), self.simulator.view())
        self.hidden = torch.zeros(n, HIDDEN)
        self.episode_starts: Bools = np.ones(n, bool)

    def state(self) -> Tensor:
        """The critic's input, float32, (n, critic_size): belief, goal, cell, distance and step."""
        simulator, one_hot = self.simulator, np.eye(self.world.n_cells, dtype=np.float32)
        distance = self.world.distance[simulator.cell, simulator.goal] / self.world.distance.max()
        step = simulator.step_number / STEP_LIMIT
        parts = (
            self.filter.belief,
            one_hot[simulator.goal],
            one_hot[simulator.cell],
            np.stack([distance, step], axis=1).astype(np.float32),
        )
        return torch.from_numpy(np.concatenate(parts, axis=1))

    @torch.no_grad()
    def collect(self, network: Network, critic: Critic, n_steps: int, epsilon: float) -> Rollout:
        """Play ``n_steps`` of every episode; those that end start anew."""
        first_hidden = self.hidden * torch.from_numpy(~self.episode_starts).float()[:, None]
        steps = [self._step(network, critic, epsilon) for _ in range(n_steps)]
        columns = {name: torch.stack([step[name] for step in steps]) for name in steps[0]}
        columns["values"] = critic(columns["states"])
        # Where an episode went on, the value after a step is the value before the next one.
        follow = torch.cat([columns["values"][1:], critic(self.state())[None]])
        columns["next_values"] = torch.where(columns["ended"], columns["next_values"], follow)
        return Rollout(hidden=first_hidden, epsilon=epsilon, **columns)

    def _step(self, network: Network, critic: Critic, epsilon: float) -> dict[str, Tensor]:
        before = self._perceive()
        memory = self.hidden * (~before["episode_starts"]).float()[:, None]
        logits, _, self.hidden = network(before["inputs"], memory)
        log_probabilities = action_log_probabilities(logits, before["legal"], epsilon)
        actions = self._draw(log_probabilities)
        taken = log_probabilities.gather(1, actions[:, None])[:, 0]
        return {**before, "actions": actions, "log_probabilities": taken, **self._move(actions, critic)}

    def _perceive(self) -> dict[str, Tensor]:
        """What actor, critic and teacher know before a move."""
        return {
            "inputs": torch.from_numpy(encode(self.world, self.simulator.view())),
            "legal": torch.from_numpy(self.world.legal[self.simulator.cell]),
            "episode_starts": torch.from_numpy(self.episode_starts),
            "states": self.state(),
            "beliefs": torch.from_numpy(self.filter.belief.copy()),
            "taught": torch.from_numpy(self.filter.greedy(self.rng)),
        }

    def _move(self, actions: Tensor, critic: Critic) -> dict[str, Tensor]:
        """Move every episode, and begin those that are over anew."""
        outcome = self.simulator.step(actions.numpy())
        self.filter.update(self.simulator.view())
        next_values = torch.zeros(self.simulator.n)
        if outcome.truncated.any():
            truncated = torch.from_numpy(outcome.truncated)
            next_values[truncated] = critic(self.state()[truncated])
        rewards = (GOAL_REWARD * outcome.terminated + STEP_REWARD) / GOAL_REWARD
        self._restart(outcome.done)
        return {
            "rewards": torch.from_numpy(rewards.astype(np.float32)),
            "ended": torch.from_numpy(outcome.done),
            "next_values": next_values,
        }

    def _restart(self, done: Bools) -> None:
        self.episode_starts = done
        self.simulator.restart(done)
        self.filter.begin(done, self.simulator.view())

    def _draw(self, log_probabilities: Tensor) -> Tensor:
        """Draw actions from numpy's generator, so that one seed fixes everything (Gumbel's trick)."""
        uniform = self.rng.random(log_probabilities.shape, dtype=np.float32)
        gumbel = -np.log(-np.log(np.clip(uniform, 1e-12, 1 - 1e-7)))
        return (log_probabilities + torch.from_numpy(gumbel)).argmax(dim=1)
