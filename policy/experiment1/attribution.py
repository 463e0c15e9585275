"""What an action depends on: how the logarithm of its probability answers to the verdict and to the position.

Gradients as in the paper (IV.A.3-4), and the two methods it leaves to the future (IV.B.4): integrated gradients
(Sundararajan et al. 2017, arXiv:1703.01365) and SmoothGrad (Smilkov et al. 2017, arXiv:1706.03825). The memory an agent
comes with is a fixed input: all of them tell of one step, not of what earlier verdicts left in the memory.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch
from captum.attr import IntegratedGradients, NoiseTunnel, Saliency
from numpy.typing import NDArray
from torch import Tensor

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.evaluation import NetworkPlayer, play
from policy.network import Actor, Inputs, Network, PaperInputs, PaperNetwork, ToldNetwork, doubting
from policy.observation import STEP_LIMIT, View
from policy.simulator import Bools, Ints, Pairs, Simulator, pair_weights
from policy.verdicts import Draw

Method = Literal["gradient", "integrated gradients", "SmoothGrad"]
METHODS: tuple[Method, ...] = get_args(Method)
Function = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Log-probabilities, (m,), of two inputs, (m, ...), at the steps of the indices (m,)."""
CHUNK = 4096
"""Steps taken at once: a chunk's tensors stay below 100 MB."""
PATH_POINTS = 64
"""Points of Gauss-Legendre quadrature between baseline and input: sums are then complete to a few thousandths."""
NOISE, NOISY_COPIES = 0.1, 16
"""Standard deviation as a share of an input's range (Smilkov et al.: 0.1 to 0.2), and how many are averaged."""


@dataclass(frozen=True)
class Steps:
    """Steps that a network played, one after another; the first of each episode, before any verdict, isn't among them.

    Attributes
    ----------
    world : the map.
    view : what was perceived, arrays (n, ...).
    hidden : float32, (n, n_hidden), the memory before the step.
    action : int64, (n,), the likeliest, which was taken.
    episode : int64, (n,), which episode each belongs to.
    """

    world: GridWorld
    view: View
    hidden: Tensor
    action: Ints
    episode: Ints

    def take(self, which: Bools) -> "Steps":
        """The steps of a mask, (n,)."""
        view = View(**{name: part[which] for name, part in vars(self.view).items()})
        hidden = self.hidden[torch.from_numpy(which)]
        return Steps(self.world, view, hidden, self.action[which], self.episode[which])


def record(network: Actor, world: GridWorld, draw: Draw, n: int, seed: int) -> Steps:
    """Play ``n`` random episodes of at most 60 steps, as people's are, and keep all steps."""
    rng = np.random.default_rng([seed, 2])
    start, goal = Pairs(pair_weights(world, "pairs")).draw(n, np.random.default_rng(seed))
    player = _Recorder(network, world)
    play(player, Simulator(world, start, goal, draw(n, rng), rng, STEP_LIMIT))
    views, hidden, actions, episodes = zip(*player.steps[1:], strict=True)
    joined = {name: np.concatenate([vars(view)[name] for view in views]) for name in vars(views[0])}
    return Steps(world, View(**joined), torch.cat(hidden), np.concatenate(actions), np.concatenate(episodes))


class _Recorder(NetworkPlayer):
    """Notes what it perceived, remembered and did."""

    def begin(self, simulator: Simulator) -> None:
        super().begin(simulator)
        self.steps: list[tuple[View, Tensor, Ints, Ints]] = []
        self._episode = np.arange(simulator.n)

    def act(self, view: View) -> Ints:
        hidden = self.hidden
        actions = super().act(view)
        kept = View(**{name: part.copy() for name, part in vars(view).items()})  # the simulator goes on with them
        self.steps.append((kept, hidden, actions, self._episode))
        return actions

    def keep(self, which: Bools) -> None:
        super().keep(which)
        self._episode = self._episode[which]


class Effect:
    """The log-probability of the action taken at each step, as a function of verdict and position, all else as it was.

    Parameters
    ----------
    steps : ``n`` of them.
    scale : evidence of a verdict `error`, so that verdicts of any accuracy are on one scale.

    Attributes
    ----------
    verdict : float32, (n, 1), 1 error, -1 correct, 0 missing.
    position : float32, (n, n_position), where the agent is, as its network reads it.
    nowhere : float32, (n_position,), the position that tells nothing, a baseline.
    """

    position: Tensor
    nowhere: Tensor

    def __init__(self, steps: Steps, scale: float) -> None:
        self.scale = scale
        self.verdict = torch.from_numpy(steps.view.evidence / scale)[:, None]
        self._hidden = steps.hidden
        self._legal = torch.from_numpy(steps.world.legal[steps.view.cell])
        self._action = torch.from_numpy(steps.action)

    def __len__(self) -> int:
        return len(self._action)

    def __call__(self, verdict: Tensor, position: Tensor, rows: Tensor) -> Tensor:
        """Log-probabilities, (m,), of verdicts, (m, 1), and positions, (m, n_position), at the steps ``rows``, (m,)."""
        logits = self._logits(verdict, position, rows).masked_fill(~self._legal[rows], -torch.inf)
        return torch.log_softmax(logits, dim=1).gather(1, self._action[rows, None])[:, 0]

    def _logits(self, verdict: Tensor, position: Tensor, rows: Tensor) -> Tensor:
        raise NotImplementedError


def effect_of(network: Actor, steps: Steps, scale: float) -> Effect:
    """The effect of verdict and position on a network of ours or the paper's."""
    if isinstance(network, ToldNetwork):  # which of its two plays depends on what it is told, the same at all steps
        alike = doubting(replace(steps.view, evidence=np.full_like(steps.view.evidence, scale)))
        steps, scale = replace(steps, view=doubting(steps.view)), float(alike.evidence[0])
        network = network.listening if steps.view.information.any() else network.searching
    if isinstance(network, Network):
        return _Ours(network, steps, scale)
    assert isinstance(network, PaperNetwork)
    return _Papers(network, steps, scale)


class _Ours(Effect):
    """Positions are two one-hot inputs: the cell that was left, to the memory, and the present one, to the head.

    A one-hot input sums to one, so only differences between rows of its table mean anything: rows are taken relative
    to the mean row, which is the baseline. The rows that the evidence scales belong to the verdict and are left alone.
    """

    def __init__(self, network: Network, steps: Steps, scale: float) -> None:
        super().__init__(steps, scale)
        self._network, n_cells = network, steps.world.n_cells
        self._hidden = self._hidden[:, : network.n_hidden]  # a part of a told policy may have the smaller memory
        self._inputs = network.look(steps.world, steps.view)
        self._last = self._inputs.move % N_ACTIONS
        legal = torch.from_numpy(steps.world.legal.ravel())
        moves = network.move.weight.detach()[: n_cells * N_ACTIONS]
        cells = network.from_cell.weight.detach()
        self._mean_move, self._mean_cell = moves[legal].mean(dim=0), cells.mean(dim=0)
        # Moves that can't be made have rows that were never learnt.
        self._moves = ((moves - self._mean_move) * legal[:, None]).view(n_cells, N_ACTIONS, -1)
        self._cells = cells - self._mean_cell
        one_hot = torch.eye(n_cells)
        self.position = torch.cat([one_hot[self._inputs.move // N_ACTIONS], one_hot[self._inputs.cell]], dim=1)
        self.nowhere = torch.zeros(2 * n_cells)

    def _logits(self, verdict: Tensor, position: Tensor, rows: Tensor) -> Tensor:
        inputs = Inputs(*(part[rows] for part in self._inputs))._replace(evidence=self.scale * verdict[:, 0])
        left, here = position.chunk(2, dim=1)
        move = self._mean_move.repeat(len(rows), 1)
        for action in range(N_ACTIONS):
            made = torch.nonzero(self._last[rows] == action)[:, 0]
            move = move.index_add(0, made, left[made] @ self._moves[:, action])
        cell = here @ self._cells + self._mean_cell
        return self._network.think(inputs, move, cell, self._hidden[rows]).logits


class _Papers(Effect):
    """Positions are the row and the column, from 0 to 1; the baseline is the middle of the grid."""

    def __init__(self, network: PaperNetwork, steps: Steps, scale: float) -> None:
        super().__init__(steps, scale)
        self._network = network
        self._vector = network.look(steps.world, steps.view).vector
        self.position = self._vector[:, 7:9]
        self.nowhere = torch.full((2,), 0.5)

    def _logits(self, verdict: Tensor, position: Tensor, rows: Tensor) -> Tensor:
        vector = self._vector[rows]
        # Its verdict is 1 for an error and 0 for a correct move.
        joined = torch.cat([(verdict + 1) / 2, vector[:, 1:7], position, vector[:, 9:]], dim=1)
        logits: Tensor = self._network(PaperInputs(joined), self._hidden[rows]).logits
        return logits


def attributions(effect: Effect, method: Method) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What the steps' actions owe to the verdict, (n,), and to the position, (n, n_position).

    Gradients are per unit of an input: from a missing verdict to `error`, from one edge of the grid to the other, or
    from out of a cell into it. Integrated gradients are in nats: they sum to the difference that the input makes
    against its baseline, a missing verdict or a position that tells nothing.
    """
    parts = [_METHODS[method](effect, rows) for rows in torch.split(torch.arange(len(effect)), CHUNK)]
    verdict, position = (torch.cat(part).detach().numpy() for part in zip(*parts, strict=True))
    return verdict[:, 0], position


def _gradient(effect: Effect, rows: Tensor) -> tuple[Tensor, Tensor]:
    inputs = effect.verdict[rows].requires_grad_(), effect.position[rows].requires_grad_()
    found: tuple[Tensor, Tensor] = Saliency(effect).attribute(inputs, abs=False, additional_forward_args=rows)
    return found


def _integrated(effect: Effect, rows: Tensor) -> tuple[Tensor, Tensor]:
    def attribute(varied: Function, at: Tensor, base: Tensor, other: Tensor) -> Tensor:
        found: Tensor = IntegratedGradients(varied).attribute(
            at,
            base.expand_as(at),
            additional_forward_args=(other, rows),
            n_steps=PATH_POINTS,
            internal_batch_size=CHUNK,
        )
        return found

    verdict, position = effect.verdict[rows], effect.position[rows]
    by_verdict = attribute(effect, verdict, torch.zeros(1), position)
    by_position = attribute(_turned(effect), position, effect.nowhere, verdict)
    return by_verdict.float(), by_position.float()


def _smooth(effect: Effect, rows: Tensor) -> tuple[Tensor, Tensor]:
    def attribute(varied: Function, at: Tensor, spread: float, other: Tensor) -> Tensor:
        found: Tensor = NoiseTunnel(Saliency(varied)).attribute(
            at,
            nt_samples=NOISY_COPIES,
            nt_samples_batch_size=1,
            stdevs=NOISE * spread,
            abs=False,
            additional_forward_args=(other, rows),
        )
        return found

    verdict, position = effect.verdict[rows], effect.position[rows]
    with torch.random.fork_rng():
        torch.manual_seed(int(rows[0]))  # captum draws from torch's own generator
        by_verdict = attribute(effect, verdict, 2.0, position)  # from -1 to 1; positions go from 0 to 1
        return by_verdict, attribute(_turned(effect), position, 1.0, verdict)


def _turned(effect: Effect) -> Function:
    return lambda position, verdict, rows: effect(verdict, position, rows)


_METHODS: dict[Method, Callable[[Effect, Tensor], tuple[Tensor, Tensor]]] = {
    "gradient": _gradient,
    "integrated gradients": _integrated,
    "SmoothGrad": _smooth,
}
