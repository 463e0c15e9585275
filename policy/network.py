"""The actors: a GRU between fully connected layers (paper IV.A). Ours reads tables, the paper's one long vector."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import N_ACTIONS, GridWorld
from policy.observation import N_SENSES, STEP_LIMIT, View
from policy.verdicts import LIMIT

HIDDEN = 64  # GRU units (paper IV.A)
WIDTH, HEAD = 256, 128  # units of our two fully connected layers; 128 in the first cost 1 to 3 % more steps (obstacles)
PAPER_WIDTH = 128  # units of the paper's, which gives none; ours

TOLD = (0.0, 0.035, 0.085, 0.107, 0.214, 0.26, 0.32, 0.42)
HEARD = (0.08, 0.072, 0.152, 0.165, 0.214, 0.226, 0.268, 0.42)
"""What the square root of the bits a verdict gives is taken for, at some values of what is told, and in proportion
between them.

The root grows like the accuracy: words right at 0.51 are taken for 0.54, 0.55 for 0.59, 0.60 for 0.61, 0.65 for 0.63,
and from 0.75 on all as told. For a decoder is hardly ever what its calibration says: one that is better than told is
heard too little, which costs up to 17 % more steps, and one that is worse leads astray. Chosen on three seeds so that
ten points either way cost at most 10 % in the mean over them, on both maps, and no real decoder costs more than 2 %
against not listening at all; where the decoder is as told this much doubt costs 1 %."""
MOST_TRUST = 10.0  # times the evidence: a decoder told to say next to nothing is still not heard as saying much

N_MARKS = N_SENSES + 1
"""Of an actor's marks beside the visited cells: each thing that can be sensed, step and information."""


class Inputs(NamedTuple):
    """What our actor reads, each (n,) but `marks`, (n, n_cells + N_MARKS); indices int64, else float32.

    ``marks``: cells visited, then what is sensed, one column for each thing but nothing, then step and information.
    """

    move: Tensor
    cell: Tensor
    evidence: Tensor
    marks: Tensor
    information: Tensor


def perceived(view: View) -> Inputs:
    """The view as tensors; they share memory with it where the simulator doesn't write into it later."""
    n, n_cells = view.visited.shape
    marks = np.zeros((n, n_cells + N_MARKS), np.float32)
    marks[:, :n_cells] = view.visited
    felt = np.flatnonzero(view.sensed)
    marks[felt, _sense_column(n_cells, view.sensed[felt])] = 1
    marks[:, -2] = np.minimum(view.step / STEP_LIMIT, 1)
    marks[:, -1] = view.information
    return Inputs(
        move=torch.from_numpy(view.move),
        cell=torch.from_numpy(view.cell),
        evidence=torch.from_numpy(view.evidence),
        marks=torch.from_numpy(marks),
        # A copy: the decoders of new episodes are put into the same array, but the gradient still needs this.
        information=torch.from_numpy(view.information.copy()),
    )


def sensing(inputs: Inputs, code: Tensor) -> Inputs:
    """The same, were something sensed, as in ``View.sensed``, int64, (n,), where nothing is."""
    marks = inputs.marks.clone()
    n, n_columns = marks.shape
    marks[torch.arange(n, device=marks.device), _sense_column(n_columns - N_MARKS, code)] = 1
    return inputs._replace(marks=marks)


def _sense_column(n_cells: int, code: Any) -> Any:
    """Where among the marks something that is sensed stands; nothing has no column."""
    return n_cells - 1 + code


class Output(NamedTuple):
    """Action logits (n, 4), the last features of the head (n, HEAD) and the new memory (n, HIDDEN)."""

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

    def goal_logits(self, inputs: Any, output: Output) -> Tensor | None:
        """Where it believes the goal to be, (n, n_cells); None where it has learnt no belief (``policy.distillation``
        teaches it, to who hears verdicts)."""
        return None


class Network(Actor):
    """Our actor. A fully connected layer on a one-hot input is a row of its weights, so it is looked up as one.

    What a verdict says of the goal depends on the cell left and the action: each move has a row that the evidence
    scales, so that the memory can add up evidence as a Bayes filter does its logarithms.

    Parameters
    ----------
    n_cells : free cells of the map.
    hidden : GRU units.
    """

    layout = "evidence-2"

    def __init__(self, n_cells: int, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.n_hidden = hidden
        n_moves = n_cells * (N_ACTIONS + 1)  # and a start from each cell
        # Rows of the three gates, reset, update and new.
        self.move = _table(n_moves, 3 * hidden)
        self.judged = _table(n_moves, 3 * hidden)
        self.judged_sure = _table(n_moves, 3 * hidden)
        self.recurrent = nn.Linear(hidden, 3 * hidden)
        # The head sees the map's marks beside the memory, which then need not carry them.
        self.from_memory = nn.Linear(hidden, WIDTH)
        self.from_cell = _table(n_cells, WIDTH)
        self.from_marks = nn.Linear(n_cells + N_MARKS, WIDTH, bias=False)
        self.head = nn.Linear(WIDTH, HEAD)
        self.action = nn.Linear(HEAD, N_ACTIONS)
        self.goal = nn.Linear(HEAD, n_cells)

    def look(self, world: GridWorld, view: View) -> Inputs:
        """The view as tensors."""
        return perceived(view)

    def forward(self, inputs: Inputs, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, n_hidden), is zeros when an episode starts."""
        return self.think(inputs, self.move(inputs.move), self.from_cell(inputs.cell), hidden)

    def goal_logits(self, inputs: Inputs, output: Output) -> Tensor | None:
        """Of the auxiliary head; None for who hears nothing, and so never had a teacher with a belief."""
        return self.goal(output.features) if bool((inputs.information > 0).all()) else None

    def think(self, inputs: Inputs, move: Tensor, cell: Tensor, hidden: Tensor) -> Output:
        """`forward` from rows already looked up, (n, 3 * n_hidden) and (n, WIDTH), for gradients by position."""
        return self._decide(inputs, cell, self._remember(inputs, move, hidden))

    def remember(self, inputs: Inputs, hidden: Tensor) -> Tensor:
        """The first half of `forward`: the new memory."""
        return self._remember(inputs, self.move(inputs.move), hidden)

    def decide(self, inputs: Inputs, hidden: Tensor) -> Output:
        """The second half of `forward`, from the new memory; of any steps at once, for it remembers nothing itself."""
        return self._decide(inputs, self.from_cell(inputs.cell), hidden)

    def _remember(self, inputs: Inputs, move: Tensor, hidden: Tensor) -> Tensor:
        gates = (
            move
            + self.judged(inputs.move) * (inputs.evidence / LIMIT)[:, None]
            + self.judged_sure(inputs.move) * torch.tanh(inputs.evidence / 2)[:, None]
        )
        return self._gru(gates, hidden)

    def _decide(self, inputs: Inputs, cell: Tensor, hidden: Tensor) -> Output:
        features = torch.relu(cell + self.from_memory(hidden) + self.from_marks(inputs.marks))
        features = torch.relu(self.head(features))
        return Output(self.action(features).float(), features, hidden)

    def _gru(self, gates: Tensor, hidden: Tensor) -> Tensor:
        """A gated recurrent unit (Cho et al. 2014), written out because its input arrives multiplied already."""
        sizes = [2 * self.n_hidden, self.n_hidden]
        opening, new = torch.split(gates, sizes, dim=1)
        remembered_opening, remembered = torch.split(self.recurrent(hidden), sizes, dim=1)
        reset, update = torch.sigmoid(opening + remembered_opening).chunk(2, dim=1)
        new = torch.tanh(new + reset * remembered)
        return (new + update * (hidden - new)).float()


def doubting(view: View) -> View:
    """The view with what is told of the verdicts taken with doubt; a decoder told to say nothing says nothing."""
    told = np.sqrt(view.information)
    heard = np.where(told < TOLD[-1], np.interp(told, TOLD, HEARD), told)
    gain = np.divide(heard, told, out=np.ones(len(told)), where=told > 0)
    gain = np.minimum(gain, MOST_TRUST).astype(np.float32)
    return replace(view, evidence=np.clip(gain * view.evidence, -LIMIT, LIMIT), information=(told * gain) ** 2)


class ToldNetwork(Actor):
    """Our actor for any decoder: it listens, or searches where it is told that there are no verdicts.

    Parameters
    ----------
    n_cells : free cells of the map.
    hidden : GRU units of the one that listens.
    """

    layout = "told-3"

    def __init__(self, n_cells: int, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.n_hidden = max(hidden, HIDDEN)
        self.listening, self.searching = Network(n_cells, hidden), Network(n_cells)

    def look(self, world: GridWorld, view: View) -> Inputs:
        """The view as tensors, what is told taken with doubt."""
        return self.listening.look(world, doubting(view))

    def forward(self, inputs: Inputs, hidden: Tensor) -> Output:
        """One step of ``n`` episodes; ``hidden``, (n, n_hidden), is zeros when an episode starts."""
        searches = inputs.information == 0
        if searches.all():
            return self._padded(self.searching, inputs, hidden)
        listened = self._padded(self.listening, inputs, hidden)
        if not searches.any():
            return listened
        searched = self._padded(self.searching, inputs, hidden)
        return Output(*(torch.where(searches[:, None], a, b) for a, b in zip(searched, listened, strict=True)))

    def goal_logits(self, inputs: Inputs, output: Output) -> Tensor | None:
        """Of the one that listens; None where it searches."""
        return self.listening.goal_logits(inputs, output)

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
