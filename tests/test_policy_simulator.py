"""The simulator keeps the rules of the stimulus, and many episodes in parallel are as many single ones."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, compile_map, load_map
from bci_app.protocol import Action, EpisodeEnd, EpisodeStart, MoveOnset, Truth
from policy.simulator import DISTRIBUTIONS, FAR_SHARE, Pairs, Simulator, pair_weights
from policy.verdicts import Decoders
from stimulus.episodes import Episode, online_plan
from stimulus.paradigm import Paradigm

WORLDS = {name: load_map(name) for name in ("open", "obstacles")}
OPEN = WORLDS["open"]
CORRIDOR = compile_map(".....", "corridor")
CONFIG = Config.model_validate({"stimulus": {"headless": True}})


def a_walk(world, rng, greed, n_steps):
    """A start, a goal and legal actions, of which the share ``greed`` lead towards the goal."""
    start, goal = (int(cell[0]) for cell in Pairs(pair_weights(world, "pairs")).draw(1, rng))
    cell, actions = start, []
    for _ in range(n_steps):
        legal = np.flatnonzero(world.legal[cell])
        good = [action for action in legal if not world.is_error(cell, int(action), goal)]
        actions.append(int(rng.choice(good if good and rng.random() < greed else legal)))
        cell = int(world.next_cell[cell, actions[-1]])
    return start, goal, actions


def on_the_stimulus(world, start, goal, actions):
    """What the paradigm sends when it is given these actions, step by step: (position, sensed, error), and its end."""
    plan = online_plan(CONFIG.online, world, "s", "P001", 7)
    paradigm = Paradigm(CONFIG.stimulus, world, replace(plan, episodes=iter([Episode(start, goal)])))
    now, shown, truths, end = 0.0, [], [], None
    paradigm.start(now)
    while True:
        for message in (out.message for out in paradigm.take_messages()):
            if isinstance(message, EpisodeStart | MoveOnset):
                shown.append((message.position, message.sensed))
                step = len(shown)
                if step <= len(actions):
                    probabilities = {"probabilities": (1, 0, 0, 0), "verdict": "missing"}
                    chosen = {"session": "s", "episode": 0, "step": step, "action": ACTIONS[actions[step - 1]]}
                    paradigm.offer_action(Action.model_validate(chosen | probabilities))
            elif isinstance(message, Truth):
                truths.append((message.error, message.distance))
            elif isinstance(message, EpisodeEnd):
                end = message
        due = paradigm.next_due()
        if due is None:
            return shown, truths, end
        now = max(now, due)
        paradigm.update(now)
        if paradigm.awaiting_flip:
            paradigm.flipped(now)


def begun(world, start, goal, limit=60, seed=0):
    start, goal = np.atleast_1d(start), np.atleast_1d(goal)
    decoders = Decoders.binary(len(start), 0.7, 0.8, missing=0.1)
    return Simulator(world, start, goal, decoders, np.random.default_rng(seed), limit)


@given(st.sampled_from(sorted(WORLDS)), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.4, 0.9, 1.0]))
@settings(max_examples=40, deadline=None)
def test_an_episode_is_the_same_on_the_stimulus_and_in_the_simulator(name, seed, greed):
    world = WORLDS[name]
    start, goal, actions = a_walk(world, np.random.default_rng(seed), greed, 60)
    shown, truths, end = on_the_stimulus(world, start, goal, actions)
    assert end is not None
    simulator = begun(world, start, goal)
    for step, (position, sensed) in enumerate(shown):
        assert tuple(world.cells[simulator.cell[0]]) == position
        assert simulator.view().sensed[0] == (sensed.index(True) + 1 if any(sensed) else 0)
        if step == end.steps:
            break
        outcome = simulator.step(np.array([actions[step]]))
        assert (bool(outcome.error[0]), int(world.distance[simulator.cell[0], goal])) == truths[step]
        assert outcome.done[0] == (step + 1 == end.steps)
    assert len(shown) == end.steps + 1 == simulator.step_number[0] + 1
    assert (bool(outcome.terminated[0]), bool(outcome.truncated[0])) == (end.reason == "goal", end.reason == "limit")


@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
@settings(max_examples=20, deadline=None)
def test_parallel_episodes_are_as_many_single_ones(seed, n):
    world, rng = WORLDS["obstacles"], np.random.default_rng(seed)
    walks = [a_walk(world, rng, 0.7, 25) for _ in range(n)]
    start, goal, actions = (np.array(column) for column in zip(*walks, strict=True))
    together, alone = begun(world, start, goal, 20), [begun(world, *walk[:2], 20) for walk in walks]
    for step in range(25):
        outcome = together.step(actions[:, step])
        outcomes = [one.step(actions[i : i + 1, step]) for i, one in enumerate(alone)]
        for part in ("terminated", "truncated", "error"):
            singles = [getattr(each, part)[0] for each in outcomes]
            np.testing.assert_array_equal(getattr(outcome, part), singles)
        for part in ("move", "cell", "sensed", "visited", "step", "information"):
            singles = np.concatenate([getattr(one.view(), part) for one in alone])
            np.testing.assert_array_equal(getattr(together.view(), part), singles)


def test_an_episode_that_begins_anew_leaves_the_others_alone():
    start, goal, _ = (
        np.array(c) for c in zip(*(a_walk(OPEN, np.random.default_rng(i), 0, 0) for i in range(4)), strict=False)
    )
    disturbed, left_alone = begun(OPEN, start, goal), begun(OPEN, start, goal)
    which, others = np.array([False, True, False, True]), [0, 2]
    for step in range(12):
        actions = np.argmax(OPEN.legal[disturbed.cell], axis=1)
        left_alone.step(np.where(which, np.argmax(OPEN.legal[left_alone.cell], axis=1), actions))
        disturbed.step(actions)
        if step == 5:
            disturbed.begin(which, np.array([60, 7]), np.array([0, 120]), Decoders.score(2, 0.9))
            view = disturbed.view()
            assert view.move[which].tolist() == [4 * 121 + 60, 4 * 121 + 7]
            assert view.step[which].tolist() == [0, 0]
            assert view.evidence[which].tolist() == [0, 0]
            assert [np.flatnonzero(row).tolist() for row in view.visited[which]] == [[60], [7]]
            assert disturbed.decoders.is_score.tolist() == which.tolist()
        for part in ("move", "cell", "sensed", "visited", "step"):
            one, other = (getattr(each.view(), part)[others] for each in (disturbed, left_alone))
            np.testing.assert_array_equal(one, other)


def test_kept_episodes_go_on_as_before():
    start, goal, _ = (
        np.array(c) for c in zip(*(a_walk(OPEN, np.random.default_rng(i), 0, 0) for i in range(5)), strict=False)
    )
    all_of_them, kept = begun(OPEN, start, goal), begun(OPEN, start, goal)
    which = np.array([True, False, False, True, True])
    for step in range(8):
        if step == 3:
            kept.keep(which)
            assert kept.n == len(kept.decoders.information) == 3
        actions = np.argmax(OPEN.legal[all_of_them.cell], axis=1)
        error = all_of_them.step(actions).error
        np.testing.assert_array_equal(kept.step(actions[which] if step >= 3 else actions).error[-2:], error[-2:])
    for part in ("move", "cell", "sensed", "visited", "step"):
        one, other = getattr(kept.view(), part), getattr(all_of_them.view(), part)[which]
        np.testing.assert_array_equal(one, other)


def test_reaching_the_goal_terminates_even_at_the_limit_and_the_limit_truncates():
    simulator = begun(CORRIDOR, np.array([0, 0]), np.array([2, 4]), limit=2)
    first, second = simulator.step(np.array([3, 3])), simulator.step(np.array([3, 3]))
    assert not first.done.any()
    assert second.terminated.tolist() == [True, False]
    assert second.truncated.tolist() == [False, True]


def test_the_same_seed_gives_the_same_verdicts_and_another_seed_others():
    start, goal = Pairs(pair_weights(OPEN, "pairs")).draw(50, np.random.default_rng(0))
    runs = [begun(OPEN, start, goal, seed=seed) for seed in (3, 3, 4)]
    heard = [[], [], []]
    for _ in range(5):
        for evidence, run in zip(heard, runs, strict=True):
            run.step(np.argmax(OPEN.legal[run.cell], axis=1))
            evidence.append(run.evidence)
    np.testing.assert_array_equal(heard[0], heard[1])
    assert not np.array_equal(heard[0], heard[2])


def test_the_experiments_distances_are_equally_likely():
    weights = pair_weights(OPEN, "distances")
    share = np.bincount(OPEN.distance.ravel(), weights.ravel())
    np.testing.assert_allclose(share[2:21], 1 / 19)
    assert share[:2].sum() == 0
    assert np.ptp(weights[OPEN.distance == 7]) == 0  # within one distance, pairs are alike
    mixture = (1 - FAR_SHARE) * pair_weights(OPEN, "pairs") + FAR_SHARE * weights
    np.testing.assert_allclose(pair_weights(OPEN, "mixture"), mixture)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_starts_and_goals_are_drawn_as_weighted_and_never_adjacent(world, distribution):
    weights = pair_weights(world, distribution)
    assert weights.sum() == pytest.approx(1)
    start, goal = Pairs(weights).draw(20_000, np.random.default_rng(0))
    distance = world.distance[start, goal]
    assert distance.min() == 2
    expected = np.bincount(world.distance.ravel(), weights.ravel())
    found = np.bincount(distance, minlength=len(expected)) / 20_000
    np.testing.assert_allclose(found[: len(expected)], expected, atol=0.012)


def test_a_map_too_small_for_an_episode_is_refused():
    with pytest.raises(SetupError, match="at least 2 moves apart"):
        pair_weights(compile_map("..", "tiny"), "pairs")
