from dataclasses import replace

import numpy as np
import pytest
import torch

from bci_app.gridworld import compile_map
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Critic, Network
from policy.observation import input_size
from policy.rollout import GOAL_REWARD, STEP_REWARD, Collector, Rollout
from policy.simulator import VerdictModel, pair_weights
from policy.training import HyperParameters, advantages, losses, train

torch.set_num_threads(1)  # small matrices: more threads only wait for each other
CROSS = compile_map("#.#\n...\n#.#", "cross")
RING = compile_map("....\n.##.\n.##.\n....", "ring")
QUICK = HyperParameters(n_episodes=64, n_steps=10, warm_minibatches=4, warm_updates=0, updates=60)


def collected(n=8, n_steps=30, seed=0, epsilon=0.2):
    torch.manual_seed(seed)
    collector = Collector(RING, n, pair_weights(RING, "pairs"), VerdictModel.right(0.8), np.random.default_rng(seed))
    network = Network(input_size(RING), RING.n_cells)
    critic = Critic(collector.state().shape[1])
    # The second rollout starts in the middle of episodes, with a memory that isn't empty.
    collector.collect(network, critic, 5, epsilon)
    return network, critic, collector.collect(network, critic, n_steps, epsilon)


def test_the_ratio_before_the_first_update_is_one():
    network, critic, rollout = collected()
    assert rollout.episode_starts.any()
    for which in torch.arange(8).chunk(2):
        loss = losses(network, critic, rollout, torch.zeros_like(rollout.rewards), which, clip=0.2)
        torch.testing.assert_close(loss.ratio, torch.ones_like(loss.ratio), rtol=0, atol=2e-6)


def test_the_stored_mask_is_the_one_the_network_was_fed():
    """With a mask that is one step late the ratio isn't one: the test above has teeth."""
    network, critic, rollout = collected()
    late = replace(rollout, episode_starts=rollout.episode_starts.roll(1, dims=0))
    loss = losses(network, critic, late, torch.zeros_like(rollout.rewards), torch.arange(8), clip=0.2)
    assert (loss.ratio - 1).abs().max() > 1e-4


def test_an_episode_starts_after_one_that_ended():
    _, _, rollout = collected()
    torch.testing.assert_close(rollout.episode_starts[1:], rollout.ended[:-1])


def test_termination_has_no_future_and_truncation_has_the_critics():
    _, _, rollout = collected(n=64, n_steps=80)
    terminated = rollout.rewards > 0.5
    truncated = rollout.ended & ~terminated
    assert terminated.any()
    assert truncated.any()
    assert (rollout.next_values[terminated] == 0).all()
    # Not the value of the episode that started in its place.
    last, following = rollout.next_values[:-1], rollout.values[1:]
    assert (last[truncated[:-1]] != following[truncated[:-1]]).all()
    going_on = ~rollout.ended[:-1]
    torch.testing.assert_close(last[going_on], following[going_on])


def test_advantages_by_hand():
    """Three steps: the goal at the second, then a truncated one; discount 0.5, lambda 0.5."""
    zeros = torch.zeros(3, 1)
    rollout = Rollout(
        *[zeros] * 7,
        values=torch.tensor([[1.0], [2.0], [4.0]]),
        rewards=torch.tensor([[0.0], [10.0], [0.0]]),
        ended=torch.tensor([[False], [True], [True]]),
        next_values=torch.tensor([[2.0], [0.0], [6.0]]),
        beliefs=zeros,
        taught=zeros,
        epsilon=0.0,
    )
    expected = [0 + 0.5 * 2 - 1 + 0.25 * 8, 10 - 2, 0.5 * 6 - 4]
    assert advantages(rollout, discount=0.5, trace=0.5)[:, 0].tolist() == expected


def test_the_reward_is_the_papers():
    _, _, rollout = collected()
    assert set(rollout.rewards.unique().tolist()) <= {
        np.float32((20 - 0.01) / 20).item(),
        np.float32(-0.01 / 20).item(),
    }
    assert (GOAL_REWARD, STEP_REWARD) == (20.0, -0.01)


@pytest.mark.parametrize("warm", [0, 30], ids=["reinforcement", "imitation"])
def test_training_learns_a_small_task_that_needs_memory(warm):
    """On the ring the nearest way round is only known from verdicts of several moves."""
    verdicts = VerdictModel.right(0.9)
    torch.manual_seed(0)
    untrained = NetworkPlayer(Network(input_size(RING), RING.n_cells), RING)
    before = evaluate(untrained, RING, verdicts, "pairs", n=500)
    network = train(RING, 0.9, replace(QUICK, warm_updates=warm))
    after = evaluate(NetworkPlayer(network, RING), RING, verdicts, "pairs", n=500)
    assert after.success > 0.99
    assert after.steps < before.steps / 2
    assert after.steps < 6.0  # 4 steps on average with perfect knowledge


def test_training_is_deterministic_from_its_seed_and_reports_progress():
    short, seen = replace(QUICK, updates=3, warm_updates=1), []
    networks = [train(CROSS, None, short, lambda update, figures: seen.append((update, figures))) for _ in range(2)]
    for one, other in zip(*(network.state_dict().values() for network in networks), strict=True):
        assert torch.equal(one, other)
    assert [update for update, _ in seen] == [1, 2, 3] * 2
    assert seen[0][1].keys() >= {"steps", "critic", "ratio"}
