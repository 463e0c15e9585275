"""Our recipe: the recurrent actor plays, a planner that knows the exact belief says at each step what it would do.

The actor sees what a live agent sees; only the teacher sees the belief. The states are the actor's own, so it learns
what to do where it gets by its own mistakes (DAgger, Ross et al. 2011), and one pass through the network serves acting
and learning.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from bci_app.gridworld import GridWorld
from policy.belief import Belief
from policy.descent import Descent, Progress, unheard
from policy.episodes import Episodes, drawn
from policy.network import HIDDEN, Network
from policy.planner import Planner
from policy.processor import device, mixed_precision, moved
from policy.simulator import Distribution, Ints, pair_weights
from policy.verdicts import Draw


@dataclass(frozen=True)
class DistillationSettings:
    """The recipe of one policy; stored beside its weights."""

    seed: int = 0
    """Of weights, episodes, verdicts and actions."""
    n_hidden: int = HIDDEN
    """GRU units."""
    n_episodes: int = 1024
    """Episodes played in parallel."""
    n_steps: int = 20
    """Steps of each between updates, and the length of back-propagation through time."""
    taught_every: int = 3
    """At one in so many steps of an episode the teacher is asked what it would do; from step to step little changes."""
    updates: int = 2200
    guided: float = 0.3
    """Share of the updates over which the teacher leads, in half of the episodes at first and in fewer and fewer."""
    learning_rate: float = 4e-3
    """Adam's, falling linearly to a four-hundredth."""
    goal_weight: float = 1.0
    """Weight of the auxiliary head that learns the belief; it makes the memory keep what the planner knows."""
    sharpening: float = 2.0
    """Power of the teacher's probabilities: its entropy is a rest of its exploration."""
    max_gradient: float = 1.0
    """Norm at which the gradient is clipped."""
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
    episodes = Episodes(world, settings.n_episodes, weights, draw, rng)
    descent = Descent(network.parameters(), settings.learning_rate, 1 / 400, settings.max_gradient)
    hidden = torch.zeros(settings.n_episodes, network.n_hidden, device=device())
    for update in range(settings.updates):
        done = update / settings.updates
        descent.slow_down(1 - done)
        led = round(settings.n_episodes / 2 * max(0.0, 1 - done / settings.guided)) if settings.guided else 0
        segment = _Segment(network, planner, episodes, settings)
        hidden = segment.play(hidden.detach(), led)
        loss, figures = segment.loss()
        descent.step(loss)
        progress(update + 1, figures)
    planner.cpu()
    return network.cpu().eval()


class _Segment:
    """Some steps of all episodes, and what the teacher would have done in each."""

    def __init__(self, network: Network, planner: Planner, episodes: Episodes, settings: DistillationSettings) -> None:
        self.network, self.planner, self.episodes, self.settings = network, planner, episodes, settings
        self.imitation: list[Tensor] = []
        self.goal: list[Tensor] = []
        self.n_ended = 0

    def play(self, hidden: Tensor, led: int) -> Tensor:
        """Move on from a memory, the first ``led`` episodes as the teacher says; the memory after the last step."""
        with mixed_precision():  # one context, or the weights would be converted anew at every step
            for number in range(self.settings.n_steps):
                hidden = self._step(hidden, led, self._asked(number, led))
        return hidden

    def _asked(self, number: int, led: int) -> Ints:
        """Episodes whose teacher is asked at a step: those it leads, and of the others one in some, in turn."""
        every, turns = np.arange(self.settings.n_episodes), self.settings.taught_every
        return np.flatnonzero((every < led) | (every % turns == number % turns))

    def _step(self, hidden: Tensor, led: int, asked: Ints) -> Tensor:
        episodes, rows = self.episodes, moved(torch.from_numpy(asked))
        output = self.network(moved(self.network.look(episodes.world, episodes.simulator.view())), hidden)
        logits = output.logits.masked_fill(~moved(episodes.legal()), -1e9)
        belief = episodes.belief.of(asked)
        taught = self._teach(belief, asked)
        # Step by step, while all of it is in the processor's cache.
        self.imitation.append(nn.functional.cross_entropy(logits.index_select(0, rows), taught))
        guess = self.network.goal(output.features.index_select(0, rows)).float()
        self.goal.append(nn.functional.cross_entropy(guess, moved(torch.from_numpy(belief.probability))))
        actions = drawn(torch.log_softmax(logits.detach(), dim=1).cpu(), episodes.rng)
        actions[:led] = taught[:led].argmax(dim=1).cpu()
        done = episodes.move(actions.numpy()).done
        episodes.renew(done)
        self.n_ended += int(done.sum())
        kept: Tensor = output.hidden * moved(torch.from_numpy(~done))[:, None]
        return kept

    @torch.no_grad()
    def _teach(self, belief: Belief, asked: Ints) -> Tensor:
        simulator = self.episodes.simulator
        seen = self.planner.look(belief, simulator.step_number[asked], simulator.decoders.information[asked])
        return self.planner.log_probabilities(moved(seen), self.settings.sharpening).exp()

    def loss(self) -> tuple[Tensor, dict[str, float]]:
        """Cross-entropies of the actions and, beside, of the goal, with the figures to show."""
        imitation, goal = torch.stack(self.imitation).mean(), torch.stack(self.goal).mean()
        steps = self.settings.n_steps * self.settings.n_episodes / max(self.n_ended, 1)
        figures = {"steps": steps, "imitation": imitation.item(), "goal": goal.item()}
        return imitation + self.settings.goal_weight * goal, figures
