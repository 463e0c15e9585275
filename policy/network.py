"""The actors: a GRU between fully connected layers (paper IV.A). Ours reads tables, the paper's one long vector."""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import N_SENSES, STEP_LIMIT, View
from policy.verdicts import LIMIT

HIDDEN = 64  # GRU units (paper IV.A)
WIDTH = 256  # units of our fully connected layers: 128 need 1 to 3 % more steps (obstacles, 9 million moves)
PAPER_WIDTH = 128  # units of the paper's, which gives none; ours

SEARCH_BELOW = 0.008
"""Bits a verdict below which the search without verdicts needs fewer steps than any planner found (an accuracy of
0.55 gives 0.0072 bits; 0.57, 0.014)."""


class Inputs(NamedTuple):
    """What our actor reads, each (..., n) but `visited`, (..., n, n_cells); indices int64, else float32."""

    move: Tensor
    cell: Tensor
    evidence: Tensor
    sensed: Tensor
    visited: Tensor
    step: Tensor
    information: Tensor


class Output(NamedTuple):
    """Action logits (n, 4), the last features of the head (n, WIDTH) and the new memory (n, HIDDEN)."""

    logits: Tensor
    features: Tensor
    hidden: Tensor


class Actor(nn.Module):
    """What training, evaluation and the live agent need of a network.

    Attributes
    ----------
    layout : name and version of its inputs.
    n_hidden : size of its memory.
    """

    layout: str
    n_hidden: int

    def look(self, world: GridWorld, view: View) -> Any:
        """The network's inputs of a view: a named tuple of tensors, episodes along the first axis."""
        raise NotImplementedError

    def forward(self, inputs: Any, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, n_hidden), is zeros when an episode starts."""
        raise NotImplementedError


class Network(Actor):
    """Our actor. A fully connected layer on a one-hot input is a row of its weights, so it is looked up as one.

    What a verdict says of the goal depends on the cell left and the action: each move has a row that the evidence
    scales, so that the memory can add up evidence as a Bayes filter does its logarithms.

    Parameters
    ----------
    n_cells : free cells of the map.
    hidden : GRU units.
    """

    layout = "evidence-1"

    def __init__(self, n_cells: int, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.n_hidden = hidden
        n_moves = n_cells * (N_ACTIONS + 1)  # and a start from each cell
        # Rows of the three gates, reset, update and new.
        self.move = _table(n_moves, 3 * hidden)
        self.judged = _table(n_moves, 3 * hidden)
        self.judged_sure = _table(n_moves, 3 * hidden)
        self.sensed = _table(N_SENSES, 3 * hidden)
        self.told = nn.Linear(1, 3 * hidden)
        self.recurrent = nn.Linear(hidden, 3 * hidden)
        # The head sees the map's marks beside the memory, which then need not carry them.
        self.from_memory = nn.Linear(hidden, WIDTH)
        self.from_cell = _table(n_cells, WIDTH)
        self.from_sensed = _table(N_SENSES, WIDTH)
        self.from_visited = nn.Linear(n_cells, WIDTH, bias=False)
        self.from_told = nn.Linear(2, WIDTH, bias=False)
        self.head = nn.Linear(WIDTH, WIDTH)
        self.action = nn.Linear(WIDTH, N_ACTIONS)
        self.goal = nn.Linear(WIDTH, n_cells)

    def look(self, world: GridWorld, view: View) -> Inputs:
        """The view as tensors; they share memory with it where the simulator doesn't write into it later."""
        return Inputs(
            move=torch.from_numpy(view.move),
            cell=torch.from_numpy(view.cell),
            evidence=torch.from_numpy(view.evidence),
            sensed=torch.from_numpy(view.sensed.astype(np.int64)),
            visited=torch.from_numpy(view.visited.astype(np.float32)),
            step=torch.from_numpy((view.step / STEP_LIMIT).astype(np.float32)),
            # A copy: the decoders of new episodes are put into the same array, but the gradient still needs this.
            information=torch.from_numpy(view.information.copy()),
        )

    def forward(self, inputs: Inputs, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, n_hidden), is zeros when an episode starts."""
        return self.think(inputs, self.move(inputs.move), self.from_cell(inputs.cell), hidden)

    def think(self, inputs: Inputs, move: Tensor, cell: Tensor, hidden: Tensor) -> Output:
        """`forward` from rows already looked up, (n, 3 * n_hidden) and (n, WIDTH), for gradients by position."""
        gates = (
            move
            + self.judged(inputs.move) * (inputs.evidence / LIMIT)[:, None]
            + self.judged_sure(inputs.move) * torch.tanh(inputs.evidence / 2)[:, None]
            + self.sensed(inputs.sensed)
            + self.told(inputs.information[:, None])
        )
        hidden = self._gru(gates, hidden)
        features = torch.relu(
            self.from_memory(hidden)
            + cell
            + self.from_sensed(inputs.sensed)
            + self.from_visited(inputs.visited)
            + self.from_told(torch.stack([inputs.step, inputs.information], dim=1))
        )
        features = torch.relu(self.head(features))
        return Output(self.action(features).float(), features, hidden)

    def _gru(self, gates: Tensor, hidden: Tensor) -> Tensor:
        """A gated recurrent unit (Cho et al. 2014), written out because its input arrives multiplied already."""
        n = 2 * self.n_hidden
        recurrent = self.recurrent(hidden)
        reset, update = torch.sigmoid(gates[:, :n] + recurrent[:, :n]).chunk(2, dim=1)
        new = torch.tanh(gates[:, n:] + reset * recurrent[:, n:])
        return (new + update * (hidden - new)).float()


class ToldNetwork(Actor):
    """Our actor for any decoder: it listens, or searches where it is told that the verdicts say next to nothing.

    Parameters
    ----------
    n_cells : free cells of the map.
    hidden : GRU units of the one that listens.
    """

    layout = "told-1"

    def __init__(self, n_cells: int, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.n_hidden = max(hidden, HIDDEN)
        self.listening, self.searching = Network(n_cells, hidden), Network(n_cells)

    def look(self, world: GridWorld, view: View) -> Inputs:
        """The view as tensors."""
        return self.listening.look(world, view)

    def forward(self, inputs: Inputs, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, n_hidden), is zeros when an episode starts."""
        searches = inputs.information < SEARCH_BELOW
        if searches.all():
            return self._padded(self.searching, inputs, hidden)
        listened = self._padded(self.listening, inputs, hidden)
        if not searches.any():
            return listened
        searched = self._padded(self.searching, inputs, hidden)
        return Output(*(torch.where(searches[:, None], a, b) for a, b in zip(searched, listened, strict=True)))

    def _padded(self, network: Network, inputs: Inputs, hidden: Tensor) -> Output:
        """One of the two; a smaller memory leaves the rest of the larger as it is, empty."""
        output: Output = network(inputs, hidden[:, : network.n_hidden])
        return output._replace(hidden=torch.cat([output.hidden, hidden[:, network.n_hidden :]], dim=1))


def _table(rows: int, columns: int) -> nn.Embedding:
    table = nn.Embedding(rows, columns)
    nn.init.normal_(table.weight, std=0.1)
    return table


class PaperInputs(NamedTuple):
    """The paper's observation, float32, (..., n, PAPER_SCALARS + n_cells)."""

    vector: Tensor


class PaperNetwork(Actor):
    """The paper's actor on the paper's observation (IV.A-B), every input divided by its maximum.

    Parameters
    ----------
    n_cells : free cells of the map.
    """

    layout = "paper-1"

    def __init__(self, n_cells: int) -> None:
        super().__init__()
        self.n_hidden = HIDDEN
        self.encoder = nn.Sequential(nn.Linear(n_cells + PAPER_SCALARS, PAPER_WIDTH), nn.ReLU())
        self.memory = nn.GRUCell(PAPER_WIDTH, HIDDEN)
        self.head = nn.Sequential(nn.Linear(HIDDEN, PAPER_WIDTH), nn.ReLU())
        self.action = nn.Linear(PAPER_WIDTH, N_ACTIONS)

    def look(self, world: GridWorld, view: View) -> PaperInputs:
        """The view as one vector."""
        return PaperInputs(torch.from_numpy(paper_vector(world, view)))

    def forward(self, inputs: PaperInputs, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, HIDDEN), is zeros when an episode starts."""
        hidden = self.memory(self.encoder(inputs.vector), hidden)
        features = self.head(hidden)
        return Output(self.action(features), features, hidden)


PAPER_SCALARS = 10
"""Verdict, goal sensed here and through each action, last action, row, column, step."""


def paper_vector(world: GridWorld, view: View) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """The observation of the paper (IV.B), float32, (n, PAPER_SCALARS + n_cells).

    The verdict is 1 for an error and 0 for a correct move; one that is missing lies between. The goal's position is
    not in it.
    """
    n = len(view.cell)
    started = view.move >= world.n_cells * N_ACTIONS
    vector = np.zeros((n, PAPER_SCALARS + world.n_cells), np.float32)
    vector[:, 0] = (np.sign(view.evidence) + 1) / 2
    felt = np.flatnonzero(view.sensed)
    vector[felt, view.sensed[felt]] = 1
    vector[:, 6] = np.where(started, 0, view.move % N_ACTIONS + 1) / N_ACTIONS
    vector[:, 7:9] = world.cells[view.cell] / (max(world.height - 1, 1), max(world.width - 1, 1))
    vector[:, 9] = np.minimum(view.step / STEP_LIMIT, 1)
    vector[:, PAPER_SCALARS:] = view.visited
    return vector


def action_log_probabilities(logits: Tensor, legal: Tensor, epsilon: float) -> Tensor:
    """Log of P(u) = (1 - eps) softmax(z)_u + eps/|U| over the legal actions U (paper IV.A, eq. 4).

    Parameters
    ----------
    logits, legal : (..., 4), float32 and bool.
    epsilon : share of uniformly drawn actions.

    Returns
    -------
    (..., 4), -inf for illegal actions.
    """
    log_softmax = torch.log_softmax(logits.masked_fill(~legal, -torch.inf), dim=-1)
    if epsilon == 0:
        return log_softmax
    uniform = epsilon / legal.sum(dim=-1, keepdim=True)
    mixed = torch.log((1 - epsilon) * log_softmax.exp() + uniform)
    return mixed.masked_fill(~legal, -torch.inf)


def greedy_actions(logits: Tensor, legal: Tensor) -> Tensor:
    """The likeliest legal action, int64, (...); the first of equal ones."""
    return logits.masked_fill(~legal, -torch.inf).argmax(dim=-1)
