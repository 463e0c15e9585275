import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.errors import SetupError
from bci_app.gridworld import compile_map, load_map
from policy.simulator import (
    COIN_FLIPS,
    DISTRIBUTIONS,
    NO_VERDICTS,
    Simulator,
    VerdictModel,
    pair_weights,
)

OPEN = load_map("open")


def simulator(n=4, verdicts=COIN_FLIPS, seed=0, limit=60, world=OPEN):
    return Simulator(world, n, pair_weights(world, "pairs"), verdicts, np.random.default_rng(seed), limit)


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 0.9), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_verdicts_come_at_the_stated_rates(hit, correct_rejection, missing, seed):
    rng = np.random.default_rng(seed)
    truth = np.repeat([True, False], 20_000)
    verdict = VerdictModel(hit, correct_rejection, missing).draw(truth, rng)
    given_one = verdict != 0
    assert np.mean(~given_one) == pytest.approx(missing, abs=0.02)
    assert np.mean(verdict[given_one & truth] == 1) == pytest.approx(hit, abs=0.06)
    assert np.mean(verdict[given_one & ~truth] == -1) == pytest.approx(correct_rejection, abs=0.06)


def test_no_verdicts_means_all_missing():
    assert not NO_VERDICTS.draw(np.array([True, False] * 50), np.random.default_rng(0)).any()


def test_the_experiments_distances_are_equally_likely():
    weights = pair_weights(OPEN, "distances")
    share = np.bincount(OPEN.distance.ravel(), weights.ravel())
    np.testing.assert_allclose(share[2:21], 1 / 19)
    assert share[:2].sum() == 0
    # Within one distance, pairs are alike.
    assert np.ptp(weights[OPEN.distance == 7]) == 0


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("name", ["open", "obstacles"])
def test_start_and_goal_are_never_adjacent(name, distribution):
    world = load_map(name)
    weights = pair_weights(world, distribution)
    assert weights.sum() == pytest.approx(1)
    assert weights[world.distance < 2].sum() == 0


def test_a_map_too_small_for_an_episode_is_refused():
    with pytest.raises(SetupError, match="at least 2 moves apart"):
        pair_weights(compile_map("..", "tiny"), "pairs")


def test_reaching_the_goal_terminates_and_the_limit_truncates():
    world = compile_map(".....", "corridor")
    one = Simulator(world, 2, pair_weights(world, "pairs"), COIN_FLIPS, np.random.default_rng(0), limit=2)
    one.begin(np.ones(2, bool), np.array([0, 0]), np.array([2, 4]))
    first, second = one.step(np.array([3, 3])), one.step(np.array([3, 3]))
    assert not first.done.any()
    assert second.terminated.tolist() == [True, False]
    assert second.truncated.tolist() == [False, True]


def test_reaching_the_goal_at_the_limit_is_termination():
    world = compile_map("...", "corridor")
    one = Simulator(world, 1, pair_weights(world, "pairs"), COIN_FLIPS, np.random.default_rng(0), limit=2)
    one.begin(np.ones(1, bool), np.array([0]), np.array([2]))
    one.step(np.array([3]))
    outcome = one.step(np.array([3]))
    assert outcome.terminated.all()
    assert not outcome.truncated.any()


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_truth_is_the_worlds(seed):
    sim = simulator(n=16, seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(10):
        before = sim.cell.copy()
        actions = np.array([rng.choice(np.flatnonzero(OPEN.legal[cell])) for cell in before])
        outcome = sim.step(actions)
        expected = [OPEN.is_error(*map(int, move)) for move in zip(before, actions, sim.goal, strict=True)]
        assert outcome.error.tolist() == expected


def test_a_restart_touches_only_the_episodes_that_are_over():
    sim = simulator()
    sim.step(np.argmax(OPEN.legal[sim.cell], axis=1))
    before = sim.cell.copy(), sim.goal.copy(), sim.visited.copy()
    sim.restart(np.array([False, True, False, True]))
    keep = [0, 2]
    for old, new in zip(before, (sim.cell, sim.goal, sim.visited), strict=True):
        np.testing.assert_array_equal(old[keep], new[keep])
    assert sim.step_number.tolist() == [1, 0, 1, 0]
    assert sim.visited[[1, 3]].sum(axis=1).tolist() == [1, 1]
    assert sim.view().action[[1, 3]].tolist() == [-1, -1]


def test_the_same_seed_gives_the_same_episodes():
    runs = [simulator(n=100, seed=3, verdicts=VerdictModel.right(0.7)) for _ in range(2)]
    for _ in range(5):
        for run in runs:
            run.step(np.argmax(OPEN.legal[run.cell], axis=1))
        np.testing.assert_array_equal(runs[0].verdict, runs[1].verdict)
        np.testing.assert_array_equal(runs[0].cell, runs[1].cell)
