"""Training one policy: a warm start that imitates the Bayes filter, then advantage actor-critic.

Read top-down: hyper-parameters, advantages, losses, the loop.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from bci_app.gridworld import GridWorld
from policy.network import Critic, Network, action_log_probabilities
from policy.observation import input_size
from policy.rollout import Collector, Rollout
from policy.simulator import NO_VERDICTS, Distribution, VerdictModel, pair_weights


@dataclass(frozen=True)
class HyperParameters:
    """The recipe of one policy; stored beside its weights."""

    seed: int = 0
    """Of weights, episodes, verdicts and actions."""
    n_episodes: int = 512
    """Episodes played in parallel."""
    n_steps: int = 20
    """Steps of each between updates, and the length of back-propagation through time."""
    warm_minibatches: int = 16
    """Gradient steps an update of the warm start; each takes some of the episodes, never a part of time."""
    n_minibatches: int = 4
    """The same afterwards: policy gradients are noisier and want larger batches."""
    warm_updates: int = 350
    """Updates that imitate the Bayes filter's moves, before reinforcement."""
    updates: int = 550
    """All updates, the warm ones included."""
    distribution: Distribution = "mixture"
    """Starts and goals: half like random episodes, half like the experiment's, so that far goals are learnt."""
    missing: float = 0.03
    """Share of missing verdicts, as artefacts cause."""
    learning_rate: float = 3e-3
    """Adam's, falling linearly to a twentieth."""
    discount: float = 0.98
    """Of the reward a step."""
    trace: float = 0.9
    """TD(lambda): 0 trusts the critic, 1 the returns."""
    epsilon_first: float = 0.5
    """Share of uniform actions at the beginning (paper IV.B)."""
    epsilon_last: float = 0.02
    """The same after the warm start (0.05 in the paper)."""
    clip: float = 0.2
    """Largest relative change of an action's probability an update rewards; one minibatch makes it plain A2C."""
    entropy: float = 0.003
    """Weight of the entropy bonus."""
    goal_weight: float = 0.3
    """Weight of the auxiliary head that learns the filter's belief."""
    max_gradient: float = 1.0
    """Norm at which the gradient is clipped."""


Progress = Callable[[int, dict[str, float]], None]
"""Called after each update with its number, from 1, and its figures."""


def verdict_model(accuracy: float | None, missing: float) -> VerdictModel:
    """The simulated decoder of a policy: right with probability ``accuracy``, or None for no verdicts."""
    return NO_VERDICTS if accuracy is None else VerdictModel.right(accuracy, missing)


def advantages(rollout: Rollout, discount: float, trace: float) -> Tensor:
    """Generalised advantage estimates, (n_steps, n): TD(lambda) returns minus the values."""
    surprise = rollout.rewards + discount * rollout.next_values - rollout.values
    decay = discount * trace * (~rollout.ended).float()
    result = torch.zeros_like(surprise)
    following = torch.zeros_like(surprise[0])
    for step in reversed(range(len(surprise))):
        following = surprise[step] + decay[step] * following
        result[step] = following
    return result


@dataclass(frozen=True)
class Losses:
    """Scalars of one minibatch, and the ratio of new to old action probabilities, (n_steps, n)."""

    actor: Tensor
    imitation: Tensor
    critic: Tensor
    goal: Tensor
    entropy: Tensor
    ratio: Tensor


def losses(network: Network, critic: Critic, rollout: Rollout, advantage: Tensor, which: Tensor, clip: float) -> Losses:
    """All losses on the episodes ``which``, int64, (n_minibatch,)."""
    logits, goal_logits = network.unroll(
        rollout.inputs[:, which], rollout.hidden[which], rollout.episode_starts[:, which]
    )
    legal = rollout.legal[:, which]
    log_all = action_log_probabilities(logits, legal, rollout.epsilon)
    log_taken = log_all.gather(2, rollout.actions[:, which, None])[:, :, 0]
    ratio = (log_taken - rollout.log_probabilities[:, which]).exp()
    gain = advantage[:, which]
    scaled = (gain - gain.mean()) / (gain.std() + 1e-8)
    surrogate = torch.minimum(ratio * scaled, ratio.clamp(1 - clip, 1 + clip) * scaled)
    plain = action_log_probabilities(logits, legal, 0.0)
    values = critic(rollout.states[:, which])
    return Losses(
        actor=-surrogate.mean(),
        imitation=functional.nll_loss(plain.flatten(0, 1), rollout.taught[:, which].flatten()),
        critic=functional.mse_loss(values, gain + rollout.values[:, which]),
        goal=-(rollout.beliefs[:, which] * torch.log_softmax(goal_logits, dim=2)).sum(dim=2).mean(),
        entropy=-(log_all.exp() * log_all.masked_fill(~legal, 0.0)).sum(dim=2).mean(),
        ratio=ratio,
    )


def train(
    world: GridWorld,
    accuracy: float | None,
    settings: HyperParameters,
    progress: Progress = lambda update, figures: None,
    start: Network | None = None,
) -> Network:
    """Train a policy for one map and one accuracy of the verdicts, None for no verdicts at all.

    ``start`` is a network to go on from; else weights are drawn from the seed.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    weights = pair_weights(world, settings.distribution)
    collector = Collector(world, settings.n_episodes, weights, verdict_model(accuracy, settings.missing), rng)
    network = start or Network(input_size(world), world.n_cells)
    critic = Critic(collector.state().shape[1])
    optimizer = torch.optim.Adam([*network.parameters(), *critic.parameters()], eps=1e-5)
    for update in range(settings.updates):
        optimizer.param_groups[0]["lr"] = settings.learning_rate * max(1 - update / settings.updates, 0.05)
        warm = update < settings.warm_updates
        rollout = collector.collect(network, critic, settings.n_steps, _epsilon(settings, update))
        advantage = advantages(rollout, settings.discount, settings.trace)
        shuffled = torch.from_numpy(rng.permutation(settings.n_episodes))
        for which in shuffled.chunk(settings.warm_minibatches if warm else settings.n_minibatches):
            loss = losses(network, critic, rollout, advantage, which, settings.clip)
            _descend(optimizer, loss, settings, warm)
        progress(update + 1, _figures(rollout, loss))
    return network


def _descend(optimizer: torch.optim.Optimizer, loss: Losses, settings: HyperParameters, warm: bool) -> None:
    guided = loss.imitation if warm else loss.actor - settings.entropy * loss.entropy
    total = guided + loss.critic + settings.goal_weight * loss.goal
    optimizer.zero_grad()
    total.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], settings.max_gradient)
    optimizer.step()


def _epsilon(settings: HyperParameters, update: int) -> float:
    """Falls linearly over the warm start, then stays."""
    done = min(update / max(settings.warm_updates, 1), 1.0)
    return settings.epsilon_first + done * (settings.epsilon_last - settings.epsilon_first)


def _figures(rollout: Rollout, loss: Losses) -> dict[str, float]:
    ended = float(rollout.ended.sum())
    return {
        "steps": rollout.ended.numel() / max(ended, 1.0),
        "imitation": loss.imitation.item(),
        "critic": loss.critic.item(),
        "goal": loss.goal.item(),
        "entropy": loss.entropy.item(),
        "ratio": loss.ratio.mean().item(),
    }
