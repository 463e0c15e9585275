import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import load_map
from policy.baselines import BayesFilter
from policy.evaluation import BayesPlayer, evaluate
from policy.simulator import COIN_FLIPS, NO_VERDICTS, Simulator, VerdictModel, pair_weights

WORLDS = {name: load_map(name) for name in ("open", "obstacles")}


def walk(world, verdicts, n=50, n_steps=15, seed=0):
    """Random walks with a filter beside them; yields simulator, filter and the cells left with the actions."""
    rng = np.random.default_rng(seed)
    weights = pair_weights(world, "pairs")
    simulator = Simulator(world, n, weights, verdicts, rng)
    belief = BayesFilter(world, n, weights, verdicts)
    belief.begin(np.ones(n, bool), simulator.view())
    for _ in range(n_steps):
        left = simulator.cell.copy()
        actions = np.array([rng.choice(np.flatnonzero(world.legal[cell])) for cell in left])
        simulator.step(actions)
        belief.update(simulator.view())
        yield simulator, belief, left, actions


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_a_belief_sums_to_one_and_never_excludes_the_goal(world):
    for simulator, belief, _, _ in walk(world, VerdictModel.right(0.75)):
        np.testing.assert_allclose(belief.belief.sum(axis=1), 1, rtol=1e-4)
        assert (belief.belief[np.arange(50), simulator.goal] > 0).all()


@given(st.sampled_from(sorted(WORLDS)), st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.integers(0, 999))
@settings(max_examples=15, deadline=None)
def test_the_belief_is_bayes_rule_spelt_out(name, hit, correct_rejection, seed):
    world, n = WORLDS[name], 3
    model = VerdictModel(hit, correct_rejection, missing=0.1)
    posterior = None
    for simulator, belief, left, actions in walk(world, model, n=n, n_steps=12, seed=seed):
        if posterior is None:
            posterior = np.ones((n, world.n_cells))
            for i in range(n):
                posterior[i, world.distance[left[i]] < 2] = 0
        for i in range(n):
            here, goal = int(simulator.cell[i]), int(simulator.goal[i])
            for g in range(world.n_cells):
                agrees = world.goal_sensed(here, g) == world.goal_sensed(here, goal)
                chance = hit if world.is_error(int(left[i]), int(actions[i]), g) else 1 - correct_rejection
                said = {0: 1.0, 1: chance, -1: 1 - chance}[int(simulator.verdict[i])]
                posterior[i, g] *= agrees * said
        expected = posterior / posterior.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(belief.belief, expected, rtol=1e-3, atol=1e-6)


def test_coin_flips_and_missing_verdicts_teach_nothing():
    world = WORLDS["open"]
    flips = [belief.belief.copy() for _, belief, _, _ in walk(world, COIN_FLIPS)][-1]
    for row in flips:
        assert len(np.unique(row[row > 0].round(6))) == 1
    assert COIN_FLIPS.likelihood()[0].tolist() == [1, 1]


def test_belief_is_calibrated():
    """Of the goals believed with probability p, the share p is right."""
    *_, (simulator, belief, _, _) = walk(WORLDS["open"], VerdictModel.right(0.8), n=4000, n_steps=10)
    right = np.arange(121) == simulator.goal[:, None]
    for low, high in ((0.01, 0.05), (0.05, 0.2), (0.2, 0.6)):
        band = (belief.belief >= low) & (belief.belief < high)
        assert right[band].mean() == pytest.approx(belief.belief[band].mean(), rel=0.15)


@pytest.mark.parametrize(("accuracy", "expected"), [(None, 24.4), (0.70, 16.7), (0.75, 14.5), (0.80, 12.8), (1.0, 9.4)])
def test_the_filter_takes_the_documented_number_of_steps(accuracy, expected):
    """docs SPEC section 6: what is reachable on `open` with binary verdicts."""
    world = WORLDS["open"]
    verdicts = NO_VERDICTS if accuracy is None else VerdictModel.right(accuracy)
    player = BayesPlayer(world, pair_weights(world, "pairs"), verdicts)
    result = evaluate(player, world, verdicts, "pairs", n=2000)
    assert result.unlimited_steps == pytest.approx(expected, rel=0.06)


def test_with_perfect_verdicts_and_a_known_line_the_move_is_never_illegal():
    world = WORLDS["obstacles"]
    for _, belief, _, _ in walk(world, VerdictModel.right(1.0), n_steps=8):
        action = belief.greedy(np.random.default_rng(0))
        assert world.legal[belief._cell, action].all()
