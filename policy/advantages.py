"""How much better than expected each action turned out, and what to make of it, for both kinds of reinforcement."""

import torch
from torch import Tensor


def generalised_advantages(
    rewards: Tensor, values: Tensor, following: Tensor, ended: Tensor, discount: float, trace: float
) -> Tensor:
    """Generalised advantage estimates (Schulman et al. 2016): TD(lambda) returns minus the values.

    Parameters
    ----------
    rewards, values, ended : (n_steps, n); an episode that was cut short has its future in its last reward.
    following : (n,), value after the last step, where the episode goes on.
    discount, trace : gamma and lambda.

    Returns
    -------
    (n_steps, n).
    """
    result = torch.zeros_like(rewards)
    later = torch.zeros_like(following)
    for step in reversed(range(len(rewards))):
        going_on = (~ended[step]).float()
        surprise = rewards[step] + discount * going_on * following - values[step]
        later = surprise + discount * trace * going_on * later
        result[step], following = later, values[step]
    return result


def clipped_surrogate(ratio: Tensor, advantages: Tensor, clip: float) -> Tensor:
    """What an update gains, a scalar (Schulman et al. 2017, eq. 7), from advantages brought to mean 0 and variance 1.

    Parameters
    ----------
    ratio : new to old probability of each action taken, of any shape.
    advantages : of the same shape.
    clip : largest relative change of a probability that is rewarded.
    """
    gain = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    return torch.minimum(ratio * gain, ratio.clamp(1 - clip, 1 + clip) * gain).mean()
