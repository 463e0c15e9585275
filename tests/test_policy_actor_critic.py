"""The paper's recipe: its book-keeping exact, its result deterministic, and its memory of use."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bci_app.gridworld import compile_map
from policy.actor_critic import ActorCriticSettings, Collector, Critic, losses, train_actor_critic
from policy.baselines import BayesPlayer
from policy.episodes import GOAL_REWARD, STEP_REWARD
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Network, PaperNetwork
from policy.simulator import pair_weights
from policy.verdicts import Verdicts, anybody

RING = compile_map("....\n.##.\n.##.\n....", "ring")
LINE = compile_map("." * 13, "line")
SMALL = ActorCriticSettings(n_episodes=8, n_steps=30, epsilon_first=0.2, epsilon_last=0.2)
KINDS = pytest.mark.parametrize("kind", [Network, PaperNetwork])


def collected(kind=PaperNetwork, settings=SMALL, world=RING):
    """A network, its critic, and its second rollout: it starts amid episodes, with a memory that isn't empty."""
    torch.manual_seed(0)
    network, critic = kind(world.n_cells), Critic(world.n_cells)
    collector = Collector(world, settings, anybody, np.random.default_rng(0), network.n_hidden)
    collector.collect(network, critic)
    assert collector.hidden.abs().max() > 0
    return network, critic, collector.collect(network, critic)


@KINDS
def test_the_ratio_before_the_first_update_is_one(kind):
    network, critic, rollout = collected(kind)
    assert rollout.episode_starts[1:].any()
    for which in torch.arange(8).chunk(2):
        loss = losses(network, critic, rollout, torch.zeros_like(rollout.rewards), which, clip=0.2)
        torch.testing.assert_close(loss.ratio, torch.ones_like(loss.ratio), rtol=0, atol=2e-6)


@KINDS
def test_with_a_mask_of_starts_that_is_one_step_late_the_ratio_is_not_one(kind):
    """The test above has teeth."""
    network, critic, rollout = collected(kind)
    late = replace(rollout, episode_starts=rollout.episode_starts.roll(1, dims=0))
    loss = losses(network, critic, late, torch.zeros_like(rollout.rewards), torch.arange(8), clip=0.2)
    assert (loss.ratio - 1).abs().max() > 1e-4


def test_an_episode_starts_after_one_that_ended():
    _, _, rollout = collected()
    torch.testing.assert_close(rollout.episode_starts[1:], rollout.ended[:-1])
    starts = rollout.inputs.vector[:, :, 9] == 0
    assert torch.equal(starts, rollout.episode_starts)


def test_termination_has_no_future_and_truncation_has_the_critics():
    settings = replace(SMALL, n_episodes=64, n_steps=80, epsilon_first=0.0, epsilon_last=0.0)
    _, critic, rollout = collected(settings=settings)
    goal = np.float32((GOAL_REWARD + STEP_REWARD) / GOAL_REWARD)
    step = np.float32(STEP_REWARD / GOAL_REWARD)
    assert (GOAL_REWARD, STEP_REWARD) == (20.0, -0.01)  # paper IV.A
    n_cells = RING.n_cells
    at, after_move = rollout.states, rollout.states.clone()
    # Where each move led, from the state before it: the goal stays, the cell and the step number follow.
    cell, target = at[:, :, n_cells : 2 * n_cells].argmax(dim=2), at[:, :, :n_cells].argmax(dim=2)
    there = torch.from_numpy(RING.next_cell)[cell, rollout.actions]
    distance = torch.from_numpy(RING.distance)[there, target]
    after_move[:, :, n_cells : 2 * n_cells] = torch.nn.functional.one_hot(there, n_cells)
    after_move[:, :, -2], after_move[:, :, -1] = distance / RING.distance.max(), at[:, :, -1] + 1 / 60
    last = (at[:, :, -1] * 60).round() == 59
    terminated, truncated = distance == 0, last & (distance > 0)
    assert terminated.any()
    assert truncated.any()
    assert torch.equal(rollout.ended, terminated | truncated)
    torch.testing.assert_close(rollout.rewards[terminated].unique(), torch.tensor([goal]))
    torch.testing.assert_close(rollout.rewards[~rollout.ended].unique(), torch.tensor([step]))
    with torch.no_grad():
        expected = float(step) + settings.discount * critic(after_move)[truncated]
    torch.testing.assert_close(rollout.rewards[truncated], expected, rtol=0, atol=1e-5)


def test_uniform_actions_become_rarer_with_the_episodes_until_they_are_as_rare_as_they_get():
    settings = replace(SMALL, n_episodes=16, epsilon_first=0.5, epsilon_last=0.05, annealed_over=40)
    network, critic = PaperNetwork(RING.n_cells), Critic(RING.n_cells)
    collector = Collector(RING, settings, anybody, np.random.default_rng(0), network.n_hidden)
    shares = []
    for _ in range(8):
        done = min(collector.n_ended / 40, 1)
        rollout = collector.collect(network, critic)
        shares.append(rollout.epsilon)
        assert rollout.epsilon == pytest.approx(0.5 - 0.45 * done)
    assert shares[0] == 0.5
    assert shares[1] < 0.5
    assert shares[-1] == pytest.approx(0.05)


@KINDS
def test_the_same_seed_gives_the_same_weights_and_progress_is_told(kind):
    short, told = replace(SMALL, n_steps=6, n_minibatches=2, updates=3), []

    def run(seed):
        torch.manual_seed(seed)
        settings = replace(short, seed=seed)
        trained = train_actor_critic(kind(RING.n_cells), RING, anybody, settings, lambda *news: told.append(news))
        return trained.state_dict()

    first, again, other = run(0), run(0), run(1)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["action.weight"], other["action.weight"])
    assert [update for update, _ in told] == [1, 2, 3] * 3
    assert told[0][1].keys() >= {"steps", "critic", "ratio"}


class Forgetful(Network):
    """The same network without a memory: feed-forward."""

    def forward(self, inputs, hidden):
        """One step from an empty memory."""
        return super().forward(inputs, torch.zeros_like(hidden))


def test_memory_is_learnt_and_needed():
    """On a line the way to go is known from all verdicts so far; the last one alone often errs."""
    settings = ActorCriticSettings(
        n_episodes=64, n_steps=10, n_minibatches=2, updates=80, learning_rate=4e-3, annealed_over=800, entropy=0.003
    )
    kind, results = Verdicts("binary", (0.85,)), {}
    for make in (Network, Forgetful):
        torch.manual_seed(0)
        network = train_actor_critic(make(LINE.n_cells, 32), LINE, kind, settings)
        results[make] = evaluate(NetworkPlayer(network, LINE), LINE, kind, n=20_000)
        if make is Network:
            robbed = Forgetful(LINE.n_cells, 32)
            robbed.load_state_dict(network.state_dict())
    remembering, feed_forward = results[Network], results[Forgetful]
    bayes = evaluate(BayesPlayer(LINE, pair_weights(LINE, "pairs")), LINE, kind, n=5000)
    assert remembering.mean_steps < 1.05 * bayes.mean_steps
    assert remembering.mean_steps_ci[1] < feed_forward.mean_steps_ci[0]
    robbed_of_it = evaluate(NetworkPlayer(robbed, LINE), LINE, kind, n=2000)
    assert robbed_of_it.mean_steps_60 > remembering.mean_steps_60 + 0.5
