"""The actor, a GRU between fully connected layers (paper IV.A), and the critic that only training sees."""

import torch
from torch import Tensor, nn

from bci_app.gridworld import N_ACTIONS

HIDDEN = 64  # GRU units (paper IV.A)
WIDTH = 128  # units of the fully connected layers; ours, the paper gives none


class Network(nn.Module):
    """The actor: action logits and, as a training aid, a guess of the goal's cell.

    Parameters
    ----------
    n_inputs : size of an encoded view.
    n_cells : free cells of the map, for the guess.
    """

    def __init__(self, n_inputs: int, n_cells: int) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(n_inputs, WIDTH), nn.ReLU())
        self.memory = nn.GRUCell(WIDTH, HIDDEN)
        # The head sees the encoded view beside the memory, so the memory need not carry the visited marks.
        self.head = nn.Sequential(nn.Linear(HIDDEN + WIDTH, WIDTH), nn.ReLU())
        self.action = nn.Linear(WIDTH, N_ACTIONS)
        self.goal = nn.Linear(WIDTH, n_cells)

    def forward(self, inputs: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One step of ``n`` episodes.

        Parameters
        ----------
        inputs : float32, (n, n_inputs).
        hidden : float32, (n, HIDDEN); zeros when an episode starts.

        Returns
        -------
        Action logits (n, 4), goal logits (n, n_cells) and the new hidden state.
        """
        encoded = self.encoder(inputs)
        hidden = self.memory(encoded, hidden)
        features = self.head(torch.cat([hidden, encoded], dim=1))
        return self.action(features), self.goal(features), hidden

    def unroll(self, inputs: Tensor, hidden: Tensor, episode_starts: Tensor) -> tuple[Tensor, Tensor]:
        """Many steps of ``n`` episodes: as ``forward`` one by one, but fast and with gradients through time.

        Parameters
        ----------
        inputs : float32, (n_steps, n, n_inputs).
        hidden : float32, (n, HIDDEN), before the first step.
        episode_starts : bool, (n_steps, n), the steps before which the hidden state is zeroed.

        Returns
        -------
        Action logits (n_steps, n, 4) and goal logits (n_steps, n, n_cells).
        """
        encoded = self.encoder(inputs)
        keep = (~episode_starts).float()[:, :, None]
        states = []
        for step in range(len(inputs)):
            hidden = self.memory(encoded[step], hidden * keep[step])
            states.append(hidden)
        features = self.head(torch.cat([torch.stack(states), encoded], dim=2))
        return self.action(features), self.goal(features)


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


class Critic(nn.Module):
    """Feed-forward, several ReLU layers. It sees the goal, so it serves in training only (asymmetric)."""

    def __init__(self, n_inputs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(n_inputs, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 1)
        )

    def forward(self, state: Tensor) -> Tensor:
        """Value of each full state, (...,), for states (..., n_inputs), in units of the goal's reward."""
        values: Tensor = self.layers(state).squeeze(-1)
        return values
