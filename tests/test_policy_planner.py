"""The planner: it starts as the greedy moves on the exact belief and reinforcement doesn't make it worse."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import compile_map
from policy.advantages import generalised_advantages
from policy.baselines import NEARNESS, BayesPlayer, PlannerPlayer, ReplanningPlayer
from policy.coverage import search_paths
from policy.episodes import Episodes
from policy.evaluation import evaluate
from policy.planner import DISCOUNTS, GREEDY, LISTENS, REPLANS, Planner, PlannerSettings, train_planner
from policy.simulator import pair_weights
from policy.verdicts import Verdicts, anybody, telling

RING = compile_map("....\n.##.\n.##.\n....", "ring")
PATHS = search_paths(RING)
WEIGHTS = pair_weights(RING, "mixture")
SMALL = PlannerSettings(
    n_episodes=128, n_steps=8, n_minibatches=4, updates=40, critic_updates=4, learning_rate=4e-3, limit=30
)


@cache
def trained():
    return train_planner(RING, PATHS, SMALL)


def situation(planner, n_moves=4, n=64, draw=anybody):
    """What a planner sees after some moves, and the episodes."""
    episodes = Episodes(RING, n, WEIGHTS, draw, np.random.default_rng(0))
    for _ in range(n_moves):
        episodes.move(np.argmax(RING.legal[episodes.simulator.cell], axis=1))
    simulator = episodes.simulator
    return planner.look(episodes.belief, simulator.step_number, simulator.decoders.information), episodes


def test_a_fresh_planner_that_listens_is_the_greedy_move():
    assert DISCOUNTS[GREEDY] == NEARNESS  # as the baseline's
    planner = Planner(RING, PATHS)
    seen, episodes = situation(planner, draw=telling(LISTENS))
    worth = planner.nearness.worth(episodes.belief)[:, GREEDY]
    probabilities = planner.log_probabilities(seen).exp().detach().numpy()
    chosen = probabilities.argmax(axis=1)
    np.testing.assert_allclose(worth[np.arange(64), chosen], worth.max(axis=1), rtol=1e-6)
    assert (probabilities[~RING.legal[episodes.belief.cell]] == 0).all()
    # A worth 10 % lower is e^3 times rarer.
    legal = RING.legal[episodes.belief.cell]
    relative = np.where(legal, worth / worth.max(axis=1, keepdims=True), 0)
    expected = np.where(legal, np.exp(30 * relative), 0)
    np.testing.assert_allclose(probabilities, expected / expected.sum(axis=1, keepdims=True), atol=1e-5)


def test_near_chance_it_replans_whatever_it_learnt():
    kind = Verdicts("binary", (0.6,))
    assert (kind(1, np.random.default_rng(0)).information < REPLANS).all()
    replanning = evaluate(ReplanningPlayer(RING, WEIGHTS, PATHS), RING, kind, n=500)
    assert evaluate(PlannerPlayer(trained(), WEIGHTS), RING, kind, n=500) == replanning


def test_what_the_planner_sees_is_of_the_order_of_one_and_without_the_goal():
    planner = Planner(RING, PATHS)
    seen, episodes = situation(planner)
    assert seen.features.abs().max() <= 5
    assert torch.isfinite(seen.features).all()
    simulator = episodes.simulator
    simulator.goal = np.roll(simulator.goal, 1)
    again = planner.look(episodes.belief, simulator.step_number, simulator.decoders.information)
    for one, other in zip(seen, again, strict=True):
        assert torch.equal(one, other)


def test_training_doesnt_make_it_worse_than_the_greedy_move():
    kind = Verdicts("binary", (0.75,))
    planner = evaluate(PlannerPlayer(trained(), WEIGHTS), RING, kind, n=4000)
    greedy = evaluate(BayesPlayer(RING, pair_weights(RING, "pairs")), RING, kind, n=4000)
    assert planner.success_60 > 0.999
    assert planner.mean_steps < greedy.mean_steps + 0.15
    assert trained().correction.weight.abs().max() > 1e-3  # and it has learnt something


def test_the_same_seed_gives_the_same_planner_and_progress_is_told():
    short, told = replace(SMALL, updates=3, critic_updates=1), []
    runs = [train_planner(RING, PATHS, short, progress=lambda update, figures: told.append(update)) for _ in range(2)]
    for one, other in zip(*(run.state_dict().values() for run in runs), strict=True):
        assert torch.equal(one, other)
    assert told == [1, 2, 3] * 2
    other = train_planner(RING, PATHS, replace(short, seed=1))
    assert not torch.equal(other.correction.weight, runs[0].correction.weight)


def test_the_first_updates_teach_the_critic_alone():
    planner = train_planner(RING, PATHS, replace(SMALL, updates=2, critic_updates=2))
    assert not planner.correction.weight.any()
    assert planner.worth.weight.abs().max() > 0


def test_the_critic_knows_how_far_the_goal_is():
    """With a step's reward of -0.1 the value falls with the distance."""
    seen, episodes = situation(trained(), n_moves=0, n=256)
    simulator = episodes.simulator
    with torch.no_grad():
        values = trained().value(seen, torch.from_numpy(simulator.goal)).numpy()
    distance = RING.distance[simulator.cell, simulator.goal]
    assert values[distance == 2].mean() > values[distance >= 5].mean() + 0.05


@given(st.integers(1, 8), st.integers(1, 4), st.floats(0, 1), st.floats(0, 1), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_advantages_are_the_sums_they_are_defined_as(n_steps, n, discount, trace, seed):
    """Schulman et al. 2016, eq. 16: sums of temporal differences, each episode's own, up to its end."""
    rng = np.random.default_rng(seed)
    rewards, values = rng.normal(size=(2, n_steps, n)).astype(np.float32)
    following, ended = rng.normal(size=n).astype(np.float32), rng.random((n_steps, n)) < 0.3
    found = generalised_advantages(
        *map(torch.from_numpy, (rewards, values, following, ended)), discount=discount, trace=trace
    )
    next_value = np.concatenate([values[1:], following[None]])
    surprise = rewards + discount * np.where(ended, 0, next_value) - values
    for i in range(n):
        for t in range(n_steps):
            expected = 0.0
            for k in range(t, n_steps):
                expected += (discount * trace) ** (k - t) * surprise[k, i]
                if ended[k, i]:
                    break
            assert float(found[t, i]) == pytest.approx(expected, abs=1e-4)


def test_advantages_by_hand():
    """Three steps: the goal at the second, then one cut short, its future in its reward; discount and lambda 0.5."""
    rewards, values = torch.tensor([[0.0], [10.0], [3.0]]), torch.tensor([[1.0], [2.0], [4.0]])
    ended = torch.tensor([[False], [True], [True]])
    found = generalised_advantages(rewards, values, torch.tensor([100.0]), ended, 0.5, 0.5)
    assert found[:, 0].tolist() == [0 + 0.5 * 2 - 1 + 0.25 * 8, 10 - 2, 3 - 4]
