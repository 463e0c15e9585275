"""One episode at a time: what the live server and the replay both run. It never sees the goal."""

from dataclasses import dataclass

import torch

from bci_app.gridworld import GridWorld
from bci_app.protocol import VerdictUsed
from policy.ear import Ear
from policy.network import Actor, action_log_probabilities, greedy_actions
from policy.observation import Tracker

Sensed = tuple[bool, bool, bool, bool, bool]


@dataclass(frozen=True)
class Decision:
    """The next action, the probability the policy gives to each of the four, and what it took the verdict for."""

    action: int
    probabilities: tuple[float, ...]
    evidence: float


class Agent:
    """A network with the memory of one episode; float32 on one thread, so equal inputs give equal bits.

    Parameters
    ----------
    network : as ``checkpoint.load`` gives it.
    ear : how it hears verdicts.
    world : the map it was trained on (``checkpoint.check_fits``).
    """

    def __init__(self, network: Actor, ear: Ear, world: GridWorld) -> None:
        # One thread: the order of a sum, and so its last bit, mustn't depend on the machine's load.
        torch.set_num_threads(1)
        self.network, self.ear, self.world = network, ear, world
        self._tracker: Tracker | None = None

    def begin(self, start: int, sensed: Sensed) -> Decision:
        """Start an episode in a cell, with what is sensed there: the first decision."""
        self._tracker = Tracker(self.world, start, sensed, self.ear.information)
        self._hidden = torch.zeros(1, self.network.n_hidden)
        return self._decide(self._tracker, 0.0)

    def step(self, action: int, cell: int, sensed: Sensed, verdict: VerdictUsed, said: float | None = None) -> Decision:
        """Take in one move and decide the next.

        Parameters
        ----------
        action : the move that was made, whoever chose it.
        cell : where it led.
        sensed : goal in that cell, and through each of the four actions.
        verdict : ``error``, ``correct`` or ``missing``.
        said : the decoder's evidence, where it gives any.
        """
        if self._tracker is None:
            raise RuntimeError("Agent.step before Agent.begin: there is no episode")
        evidence = self.ear.evidence(verdict, said)
        self._tracker.moved(action, cell, sensed, evidence)
        return self._decide(self._tracker, evidence)

    @torch.no_grad()
    def _decide(self, tracker: Tracker, evidence: float) -> Decision:
        view = tracker.view()
        logits, _, self._hidden = self.network(self.network.look(self.world, view), self._hidden)
        legal = torch.from_numpy(self.world.legal[view.cell])
        probabilities = action_log_probabilities(logits, legal, epsilon=0).exp()[0]
        return Decision(int(greedy_actions(logits, legal)[0]), tuple(probabilities.tolist()), evidence)
