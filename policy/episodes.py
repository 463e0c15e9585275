"""Episodes that follow one another without end, with the exact belief beside each: what training plays on."""

import numpy as np
import torch
from torch import Tensor

from bci_app.gridworld import GridWorld
from policy.belief import Belief
from policy.observation import STEP_LIMIT
from policy.simulator import Bools, Floats, Ints, Outcome, Pairs, Simulator
from policy.verdicts import Draw, Stock

GOAL_REWARD = 20.0  # paper IV.A
STEP_REWARD = -0.01  # paper IV.A
NEVER = -1e9  # logit of an illegal action in training: finite, for a gradient goes through it


class Episodes:
    """``n`` episodes at once; those that end begin anew with another start, goal and decoder.

    Parameters
    ----------
    world : the map.
    n : number of episodes in parallel.
    weights : (n_cells, n_cells), probability of each start and goal, as ``pair_weights`` gives.
    draw : the decoders of new episodes.
    rng : all randomness comes from here.
    limit : steps after which an episode is truncated.
    believes : whether the belief is kept; without, `belief` stays at the prior.
    """

    def __init__(
        self,
        world: GridWorld,
        n: int,
        weights: Floats,
        draw: Draw,
        rng: np.random.Generator,
        limit: int = STEP_LIMIT,
        believes: bool = True,
    ) -> None:
        self._believes = believes
        self.world, self.n, self._draw, self.rng = world, n, Stock(draw), rng
        self._pairs = Pairs(weights)
        self.simulator = Simulator(world, *self._pairs.draw(n, rng), draw(n, rng), rng, limit)
        self.belief = Belief(world, weights, self.simulator.view())

    def move(self, action: Ints) -> Outcome:
        """Move every episode; those that are over stay so until `renew`."""
        outcome = self.simulator.step(action)
        if self._believes:
            self.belief.update(self.simulator.view())
        return outcome

    def renew(self, done: Bools) -> None:
        """Begin the episodes of the mask ``done``, (n,), anew."""
        n_new = int(done.sum())
        if n_new:
            start, goal = self._pairs.draw(n_new, self.rng)
            self.simulator.begin(done, start, goal, self._draw(n_new, self.rng))
            if self._believes:
                self.belief.begin(done, self.simulator.view())

    def legal(self) -> Tensor:
        """Legal actions, bool, (n, 4)."""
        return torch.from_numpy(self.world.legal[self.simulator.cell])


def drawn(log_probabilities: Tensor, rng: np.random.Generator) -> Tensor:
    """Actions drawn by numpy's generator, int64, (n,), so that one seed fixes everything (Gumbel's trick)."""
    uniform = rng.random(log_probabilities.shape, np.float32)
    gumbel = -np.log(-np.log(np.clip(uniform, 1e-12, 1 - 1e-7)))
    return (log_probabilities + torch.from_numpy(gumbel)).argmax(dim=1)
