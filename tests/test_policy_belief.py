"""The filter is Bayes' rule, and finds what can be found."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from bci_app.gridworld import compile_map, load_map
from policy.belief import Belief, Nearness, error_table
from policy.episodes import Episodes
from policy.simulator import pair_weights
from policy.verdicts import LIMIT, Decoders, Verdicts, anybody

WORLDS = {
    "open": load_map("open"),
    "obstacles": load_map("obstacles"),
    "ring": compile_map("....\n.##.\n.##.\n....", "ring"),
}
PROBABLE = st.floats(0.05, 0.95)


def walk(world, draw, n=50, n_steps=15, seed=0, distribution="pairs"):
    """Random walks with a filter beside them, that go on beyond the goal; yields episodes, cells left and actions."""
    rng = np.random.default_rng(seed)
    episodes = Episodes(world, n, pair_weights(world, distribution), draw, rng)
    for _ in range(n_steps):
        left = episodes.simulator.cell.copy()
        actions = np.array([rng.choice(np.flatnonzero(world.legal[cell])) for cell in left])
        episodes.move(actions)
        yield episodes, left, actions


def likelihoods(decoders, i, evidence):
    """Of a verdict on an error and on a correct move, from the decoder's rates or densities, not from its evidence."""
    if evidence == 0:
        return 1.0, 1.0
    if decoders.is_score[i]:
        score, half = evidence / decoders.scale[i], decoders.distance[i] / 2
        return norm.pdf(score - half), norm.pdf(score + half)
    hit, correct_rejection = float(decoders.hit[i]), float(decoders.correct_rejection[i])
    return (hit, 1 - correct_rejection) if evidence == decoders.if_error[i] else (1 - hit, correct_rejection)


@given(st.sampled_from(sorted(WORLDS)), PROBABLE, PROBABLE, st.floats(0.55, 0.95), st.integers(0, 999))
@settings(max_examples=20, deadline=None)
def test_the_belief_is_bayes_rule_spelt_out(name, hit, correct_rejection, accuracy, seed):
    world, n = WORLDS[name], 4

    def draw(n, rng):
        decoders = Decoders.binary(n, hit, correct_rejection, missing=0.1)
        is_score = np.arange(n) % 2 == 0
        decoders.put(is_score, Decoders.score(int(is_score.sum()), accuracy, missing=0.1))
        return decoders

    prior = pair_weights(world, "mixture")
    posterior = None
    for episodes, left, actions in walk(world, draw, n, 10, seed, "mixture"):
        simulator = episodes.simulator
        if posterior is None:
            posterior = prior[simulator.start].copy()
        for i in range(n):
            here, goal = int(simulator.cell[i]), int(simulator.goal[i])
            if_error, if_correct = likelihoods(simulator.decoders, i, simulator.evidence[i])
            for g in range(world.n_cells):
                agrees = world.goal_sensed(here, g) == world.goal_sensed(here, goal)
                said = if_error if world.is_error(int(left[i]), int(actions[i]), g) else if_correct
                posterior[i, g] *= agrees * said
        posterior /= posterior.sum(axis=1, keepdims=True)
        found = episodes.belief.probability
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, posterior, rtol=2e-3, atol=1e-6)


@given(st.sampled_from(sorted(WORLDS)), st.integers(0, 999))
@settings(max_examples=10, deadline=None)
def test_a_belief_sums_to_one_and_excludes_what_was_sensed_otherwise_and_nothing_else(name, seed):
    world = WORLDS[name]
    possible = None
    for episodes, _, _ in walk(world, Verdicts("score", (0.8,)), n=20, seed=seed):
        simulator, view = episodes.simulator, episodes.simulator.view()
        if possible is None:
            possible = world.distance[simulator.start] >= 2
        codes = np.array([[sensed_code(world, int(c), g) for g in range(world.n_cells)] for c in view.cell])
        possible &= codes == view.sensed[:, None]
        np.testing.assert_array_equal(episodes.belief.probability > 0, possible)
        np.testing.assert_allclose(episodes.belief.probability.sum(axis=1), 1, rtol=1e-5)


def sensed_code(world, cell, goal):
    sensed = world.goal_sensed(cell, goal)
    return sensed.index(True) + 1 if any(sensed) else 0


@pytest.mark.parametrize("draw", [anybody, Verdicts("binary", (1.0,)), Verdicts("score", (0.999,))])
def test_the_goal_is_never_given_up_however_sure_the_decoder(draw):
    for episodes, _, _ in walk(WORLDS["open"], draw, n=500, n_steps=60):
        goal = episodes.simulator.goal
        assert (episodes.belief.probability[np.arange(500), goal] > 0).all()


def test_certain_verdicts_leave_only_goals_that_fit_all_of_them():
    world = WORLDS["open"]
    *_, (episodes, _, _) = walk(world, Verdicts("binary", (1.0,)), n=300, n_steps=20)
    belief, goal = episodes.belief.probability, episodes.simulator.goal
    right = belief[np.arange(300), goal]
    np.testing.assert_allclose(right, belief.max(axis=1), rtol=1e-4)
    assert (belief > np.exp(-LIMIT)).sum(axis=1).mean() < 30  # of 121


def test_verdicts_at_chance_and_missing_ones_teach_nothing():
    for draw in (Verdicts("rates", (0.5, 0.5)), Verdicts("none")):
        *_, (episodes, _, _) = walk(WORLDS["open"], draw)
        for row in episodes.belief.probability:
            assert np.ptp(row[row > 0]) < 1e-6


def test_belief_is_calibrated():
    """Of the goals believed with probability p, the share p is right."""
    *_, (episodes, _, _) = walk(WORLDS["open"], anybody, n=4000, n_steps=10)
    belief = episodes.belief.probability
    right = np.arange(121) == episodes.simulator.goal[:, None]
    for low, high in ((0.01, 0.05), (0.05, 0.2), (0.2, 0.6)):
        band = (belief >= low) & (belief < high)
        assert right[band].mean() == pytest.approx(belief[band].mean(), rel=0.15)


def test_episodes_that_begin_anew_forget_and_the_others_do_not():
    *_, (episodes, _, _) = walk(WORLDS["open"], Verdicts("binary", (0.8,)), n=6)
    before = episodes.belief.probability.copy()
    done = np.array([True, False, True, False, False, True])
    episodes.renew(done)
    after, start = episodes.belief.probability, episodes.simulator.start
    np.testing.assert_array_equal(after[~done], before[~done])
    np.testing.assert_array_equal(episodes.belief.cell, episodes.simulator.cell)
    prior = pair_weights(WORLDS["open"], "pairs")[start]
    np.testing.assert_allclose(after[done], (prior / prior.sum(axis=1, keepdims=True))[done], rtol=1e-5)


def test_kept_beliefs_go_on():
    *_, (episodes, _, _) = walk(WORLDS["open"], anybody, n=6)
    belief, which = episodes.belief, np.arange(6) % 2 == 0
    probability, cell = belief.probability[which], belief.cell[which]
    belief.keep(which)
    np.testing.assert_array_equal(belief.probability, probability)
    np.testing.assert_array_equal(belief.cell, cell)


def test_joined_beliefs_are_one_after_another():
    *_, (episodes, _, _) = walk(WORLDS["ring"], anybody, n=6)
    parts = [episodes.belief.of(np.array(which)) for which in ([4], [1, 5])]
    whole = Belief.joined(parts)
    np.testing.assert_array_equal(whole.cell, episodes.belief.cell[[4, 1, 5]])
    np.testing.assert_array_equal(whole.probability, episodes.belief.probability[[4, 1, 5]])
    whole.keep(np.array([0]))
    assert len(parts[1].cell) == 2  # the parts go on by themselves


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_the_table_of_errors_is_the_worlds(world):
    table = error_table(world)
    for cell in range(0, world.n_cells, 7):
        for action in range(4):
            errors = [world.is_error(cell, action, goal) for goal in range(world.n_cells)]
            assert table[4 * cell + action].tolist() == errors


def test_the_worth_of_an_action_is_the_expected_nearness_after_it():
    world = WORLDS["ring"]
    *_, (episodes, _, _) = walk(world, Verdicts("binary", (0.7,)), n=10, n_steps=3)
    belief: Belief = episodes.belief
    worth = Nearness(world, (0.3, 0.8)).worth(belief)
    for i in range(10):
        for action in range(4):
            cell = int(belief.cell[i])
            distance = world.distance[world.next_cell[cell, action]]
            expected = [(belief.probability[i] * d**distance).sum() for d in (0.3, 0.8)]
            legal = world.legal[cell, action]
            np.testing.assert_allclose(worth[i, :, action], expected if legal else [-1, -1], rtol=1e-5)
