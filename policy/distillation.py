"""Our recipe: the recurrent actor plays, a planner that knows the exact belief says at each step what it would do.

The actor sees what a live agent sees; only the teacher sees the belief. The states are the actor's own, so it learns
what to do where it gets by its own mistakes (DAgger, Ross et al. 2011), and one pass through the network serves acting
and learning.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import GridWorld
from policy.belief import Belief
from policy.descent import Descent, Progress, unheard
from policy.episodes import NEVER, Episodes, drawn
from policy.network import HIDDEN, Inputs, Network
from policy.planner import Planner
from policy.processor import device, mixed_precision, moved
from policy.simulator import Distribution, Ints, pair_weights
from policy.verdicts import Draw, Floats


@dataclass(frozen=True)
class DistillationSettings:
    """The recipe of one policy; stored beside its weights."""

    seed: int = 0
    """Of weights, episodes, verdicts and actions."""
    n_hidden: int = HIDDEN
    """GRU units."""
    n_episodes: int = 256
    """Episodes played in parallel. As many moves in four times as many updates as with 1024 teach far more: with 8
    million moves 6 % fewer steps at an accuracy of 0.7."""
    n_steps: int = 20
    """Steps of each between updates, and the length of back-propagation through time."""
    taught_every: int = 3
    """At one in so many steps of an episode the teacher is asked what it would do; from step to step little changes."""
    updates: int = 10_000
    guided: float = 0.3
    """Share of the updates over which the teacher leads, in half of the episodes at first and in fewer and fewer."""
    learning_rate: float = 3e-3
    """Adam's, falling linearly to a four-hundredth."""
    goal_weight: float = 1.0
    """Weight of the auxiliary head that learns the belief; it makes the memory keep what the planner knows."""
    sharpening: float = 2.0
    """Power of the teacher's probabilities: its entropy is a rest of its exploration."""
    max_gradient: float = 1.0
    """Norm at which the gradient is clipped."""
    limit: int = 120
    """Steps of an episode: beyond the 60 of the experiment, or who is lost by then would never have learnt to go on."""
    distribution: Distribution = "mixture"
    """Starts and goals: mostly as in random episodes, but also as in the experiment, so that far goals are learnt."""


def distil(
    world: GridWorld,
    planner: Planner,
    draw: Draw,
    settings: DistillationSettings,
    progress: Progress = unheard,
    network: Network | None = None,
) -> Network:
    """Train an actor for decoders as ``draw`` gives them; ``network`` is one to go on from, or None for a fresh one."""
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    network = (network or Network(world.n_cells, settings.n_hidden)).to(device()).train()
    planner.to(device())
    weights = pair_weights(world, settings.distribution)
    episodes = Episodes(world, settings.n_episodes, weights, draw, rng, settings.limit)
    descent = Descent(network.parameters(), settings.learning_rate, 1 / 400, settings.max_gradient)
    hidden = torch.zeros(settings.n_episodes, network.n_hidden, device=device())
    for update in range(settings.updates):
        done = update / settings.updates
        descent.slow_down(1 - done)
        led = round(settings.n_episodes / 2 * max(0.0, 1 - done / settings.guided)) if settings.guided else 0
        segment = _Segment(network, planner, episodes, settings)
        hidden = segment.play(hidden.detach(), led, update * settings.n_steps)
        loss, figures = segment.loss()
        descent.step(loss)
        progress(update + 1, figures)
    planner.cpu()
    return network.cpu().eval()


class _Known(NamedTuple):
    """What the teacher decides by, in ``n`` situations: the belief, and (n,) each moves made and bits a verdict."""

    belief: Belief
    step: Ints
    information: Floats


class _Segment:
    """Some steps of all episodes, and what the teacher would have done in each."""

    def __init__(self, network: Network, planner: Planner, episodes: Episodes, settings: DistillationSettings) -> None:
        self.network, self.planner, self.episodes, self.settings = network, planner, episodes, settings
        self.asked: list[tuple[Inputs, Tensor, Tensor]] = []
        self.known: list[_Known] = []
        self.n_ended = 0

    def play(self, hidden: Tensor, led: int, first: int) -> Tensor:
        """Move on from a memory, the first ``led`` episodes as the teacher says; the memory after the last step.

        ``first`` is the number of steps made before, so that the episodes take turns in asking the teacher.
        """
        every, turns = np.arange(self.settings.n_episodes), self.settings.taught_every
        with mixed_precision():  # one context, or the weights would be converted anew at every step
            for number in range(first, first + self.settings.n_steps):
                hidden = self._step(hidden, led, every[every % turns == number % turns])
        return hidden

    def _step(self, hidden: Tensor, led: int, asked: Ints) -> Tensor:
        """One move of all. Only the memory is a chain from step to step; what is decided from it to move on is decided
        once more, for those that are asked alone and of all steps at once, where its gradient is needed."""
        episodes, rows = self.episodes, moved(torch.from_numpy(asked))
        inputs, legal = moved(self.network.look(episodes.world, episodes.simulator.view())), moved(episodes.legal())
        hidden = self.network.remember(inputs, hidden)
        self.asked.append((Inputs(*(part[rows] for part in inputs)), hidden.index_select(0, rows), legal[rows]))
        self.known.append(self._known(asked))
        with torch.no_grad():
            logits = self.network.decide(inputs, hidden).logits.masked_fill(~legal, NEVER)
            actions = drawn(torch.log_softmax(logits, dim=1).cpu(), episodes.rng)
        if led:
            actions[:led] = self._teach(self._known(np.arange(led))).argmax(dim=1).cpu()
        done = episodes.move(actions.numpy()).done
        episodes.renew(done)
        self.n_ended += int(done.sum())
        kept: Tensor = hidden * moved(torch.from_numpy(~done))[:, None]
        return kept

    def _known(self, which: Ints) -> "_Known":
        simulator = self.episodes.simulator
        belief, step = self.episodes.belief.of(which), simulator.step_number[which]
        return _Known(belief, step, simulator.decoders.information[which])

    @torch.no_grad()
    def _teach(self, known: "_Known") -> Tensor:
        seen = self.planner.look(*known)
        return self.planner.log_probabilities(moved(seen), self.settings.sharpening).exp()

    def loss(self) -> tuple[Tensor, dict[str, float]]:
        """Cross-entropies of the actions and, beside, of the goal, with the figures to show.

        The teacher is asked about all steps at once, for that takes it far less time than step by step.
        """
        beliefs, step, information = zip(*self.known, strict=True)
        belief = Belief.joined(beliefs)
        seen, hidden, legal = zip(*self.asked, strict=True)
        with mixed_precision():
            taught = self._teach(_Known(belief, np.concatenate(step), np.concatenate(information)))
            output = self.network.decide(Inputs(*map(torch.cat, zip(*seen, strict=True))), torch.cat(hidden))
            guess = self.network.goal(output.features).float()
        imitation = nn.functional.cross_entropy(output.logits.masked_fill(~torch.cat(legal), NEVER), taught)
        goal = nn.functional.cross_entropy(guess, moved(torch.from_numpy(belief.probability)))
        steps = self.settings.n_steps * self.settings.n_episodes / max(self.n_ended, 1)
        figures = {"steps": steps, "imitation": imitation.item(), "goal": goal.item()}
        return imitation + self.settings.goal_weight * goal, figures
