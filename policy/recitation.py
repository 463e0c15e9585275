"""Teaching an actor the search without verdicts: a laid-down path from every start, recited until it is known by heart.

The path depends on nothing but the start, so all of it is one batch: every start side by side, step after step.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.coverage import Ints
from policy.descent import Descent, Progress, unheard
from policy.episodes import NEVER
from policy.network import Inputs, Network, perceived, sensing
from policy.observation import GOAL_NEXT, View
from policy.processor import device, mixed_precision, moved

DONE = -100
"""Taught after a path's end: `cross_entropy` leaves it out."""


@dataclass(frozen=True)
class RecitationSettings:
    """How the search is taught; stored beside the weights."""

    seed: int = 0
    """Of weights, and of where the goal is thought to be sensed."""
    updates: int = 500
    """Times all paths are gone through; after 400 every step of them is known, on both maps."""
    learning_rate: float = 4e-3
    """Adam's, falling linearly to a four-hundredth."""
    what_if: float = 0.1
    """Share of steps at which the goal is thought to be sensed next door, so that going there is learnt too."""
    max_gradient: float = 1.0
    """Norm at which the gradient is clipped."""


def recite(
    world: GridWorld,
    paths: Ints,
    settings: RecitationSettings,
    progress: Progress = unheard,
) -> Network:
    """Train an actor that searches along the paths, (n_cells, n_steps), until it senses the goal."""
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    network = Network(world.n_cells).to(device())
    descent = Descent(network.parameters(), settings.learning_rate, 1 / 400, settings.max_gradient)
    walked = Walk.along(world, paths).moved()
    for update in range(settings.updates):
        descent.slow_down(1 - update / settings.updates)
        loss, known = _go_through(network, walked, rng, settings.what_if)
        descent.step(loss)
        progress(update + 1, {"known": known, "loss": loss.item()})
    return deaf(network.cpu().eval())


@torch.no_grad()
def deaf(network: Network) -> Network:
    """The network with nothing where a verdict would enter: it never met one, so those weights are still random."""
    for weights in (network.judged.weight, network.judged_sure.weight, network.from_marks.weight[:, -1]):
        weights.zero_()
    return network


@dataclass(frozen=True)
class Walk:
    """All paths at once, step by step.

    Attributes
    ----------
    inputs : for each step what the actor perceives from every start, (n_cells, ...).
    taught : int64, (n_steps, n_cells), the path's action, `DONE` after its end.
    legal : bool, (n_steps, n_cells, 4).
    """

    inputs: list[Inputs]
    taught: Tensor
    legal: Tensor

    @classmethod
    def along(cls, world: GridWorld, paths: Ints) -> "Walk":
        """Walk the paths, (n_cells, n_steps)."""
        n = world.n_cells
        rows, cell = np.arange(n), np.arange(n)
        move, visited = n * N_ACTIONS + cell, np.eye(n, dtype=bool)
        nothing, unsensed, inputs, legal = np.zeros(n, np.float32), np.zeros(n, np.uint8), [], []
        for step, action in enumerate(paths.T):
            view = View(move, cell, nothing, unsensed, visited, np.full(n, step), nothing)
            inputs.append(perceived(view))
            legal.append(torch.from_numpy(world.legal[cell]))
            goes = np.maximum(action, 0)  # after its end a path stays where it is told nothing more
            move, cell = cell * N_ACTIONS + goes, np.where(action < 0, cell, world.next_cell[cell, goes])
            visited[rows, cell] = True
        taught = torch.from_numpy(np.where(paths.T < 0, DONE, paths.T))
        return cls(inputs, taught, torch.stack(legal))

    def moved(self) -> "Walk":
        """The same on the device that trains."""
        return Walk([moved(each) for each in self.inputs], moved(self.taught), moved(self.legal))


def _go_through(network: Network, walk: Walk, rng: np.random.Generator, what_if: float) -> tuple[Tensor, float]:
    """The loss over all steps of all paths, and the share of steps that are known.

    Only the memory is a chain from step to step; what is decided from it is decided at all steps at once.
    """
    imagined = np.flatnonzero(rng.random(len(walk.inputs)) < what_if)
    memory: list[Tensor] = []
    with mixed_precision():
        hidden = torch.zeros(len(walk.legal[0]), network.n_hidden, device=device())
        for inputs in walk.inputs:
            hidden = network.remember(inputs, hidden)
            memory.append(hidden)
        chosen = network.decide(_joined(walk.inputs), torch.cat(memory)).logits
    chosen = chosen.masked_fill(~walk.legal.flatten(0, 1), NEVER)
    taught = walk.taught.flatten()
    loss = nn.functional.cross_entropy(chosen, taught, ignore_index=DONE)
    if len(imagined):
        towards = moved(torch.multinomial(walk.legal[imagined].flatten(0, 1).float().cpu(), 1)[:, 0])
        inputs = sensing(_joined([walk.inputs[step] for step in imagined]), towards + GOAL_NEXT)
        with mixed_precision():
            next_door = network.decide(inputs, torch.cat([memory[step] for step in imagined])).logits
        loss = loss + nn.functional.cross_entropy(next_door, towards)
    told = taught != DONE
    known = float((chosen.argmax(dim=1)[told] == taught[told]).float().mean())
    return loss, known


def _joined(steps: list[Inputs]) -> Inputs:
    """The inputs of some steps, one after another."""
    return Inputs(*map(torch.cat, zip(*steps, strict=True)))
