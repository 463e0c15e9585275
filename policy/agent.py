"""One episode at a time: what the live server and the replay both run. It never sees the goal."""

from dataclasses import dataclass
from typing import Any

import torch

from bci_app.gridworld import GridWorld
from bci_app.protocol import VerdictUsed
from policy.belief import Belief
from policy.ear import Ear
from policy.network import Actor, Output, action_log_probabilities, greedy_actions
from policy.observation import Tracker, View
from policy.simulator import pair_weights

Sensed = tuple[bool, bool, bool, bool, bool]


@dataclass(frozen=True)
class Decision:
    """The next action, the probability the policy gives to each of the four, and what it took the verdict for."""

    action: int
    probabilities: tuple[float, ...]
    evidence: float


@dataclass(frozen=True)
class Believed:
    """Where the goal is believed to be, (n_cells,); ``exact`` where that is Bayes' rule, not the network."""

    goal: tuple[float, ...]
    exact: bool


class Agent:
    """A network with the memory of one episode; float32 on one thread, so equal inputs give equal bits.

    Parameters
    ----------
    network : as ``checkpoint.load`` gives it.
    ear : how it hears verdicts.
    world : the map it was trained on (``cards.check_fits``).
    """

    def __init__(self, network: Actor, ear: Ear, world: GridWorld) -> None:
        # One thread: the order of a sum, and so its last bit, mustn't depend on the machine's load.
        torch.set_num_threads(1)
        self.network, self.ear, self.world = network, ear, world
        self._tracker: Tracker | None = None
        self._output: tuple[Any, Output] | None = None
        self._views: list[View] = []  # that the filter hasn't taken in yet
        self._filter: Belief | None = None

    def begin(self, start: int, sensed: Sensed) -> Decision:
        """Start an episode in a cell, with what is sensed there: the first decision."""
        self._tracker = Tracker(self.world, start, sensed, self.ear.information)
        self._hidden = torch.zeros(1, self.network.n_hidden)
        self._views, self._filter = [], None
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
    def believed(self) -> Believed:
        """Where the goal was believed to be at the last decision, which doesn't depend on this being asked."""
        if self._output is None:
            raise RuntimeError("Agent.believed before Agent.begin: there is no episode")
        logits = self.network.goal_logits(*self._output)
        if logits is not None:
            return Believed(tuple(torch.softmax(logits, dim=1)[0].tolist()), exact=False)
        for view in self._views:
            if self._filter is None:
                self._filter = Belief(self.world, pair_weights(self.world, "mixture"), view)
            else:
                self._filter.update(view)
        self._views = []
        assert self._filter is not None
        return Believed(tuple(self._filter.probability[0].tolist()), exact=True)

    @torch.no_grad()
    def _decide(self, tracker: Tracker, evidence: float) -> Decision:
        view = tracker.view()
        inputs = self.network.look(self.world, view)
        output = self.network(inputs, self._hidden)
        logits, _, self._hidden = output
        self._output = inputs, output
        self._views.append(view)
        legal = torch.from_numpy(self.world.legal[view.cell])
        probabilities = action_log_probabilities(logits, legal, epsilon=0).exp()[0]
        return Decision(int(greedy_actions(logits, legal)[0]), tuple(probabilities.tolist()), evidence)
