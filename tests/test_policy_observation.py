"""What a live episode gives the policy is what the simulator gave it in training, and the goal is no part of it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import N_ACTIONS, STEP, compile_map, load_map
from policy.observation import GOAL_NEXT, Tracker, View, sense_codes
from policy.simulator import Pairs, Simulator, pair_weights
from policy.verdicts import anybody

WORLDS = {
    "open": load_map("open"),
    "obstacles": load_map("obstacles"),
    "oblong": compile_map("....\n.##.\n....", "oblong"),
}
NOTHING = (False,) * 5
FIELDS = [field.name for field in dataclasses.fields(View)]


@given(st.sampled_from(sorted(WORLDS)), st.integers(0, 2**32 - 1), st.integers(1, 70))
@settings(max_examples=30, deadline=None)
def test_a_live_episode_and_the_simulator_see_the_same(name, seed, n_steps):
    world, rng, n = WORLDS[name], np.random.default_rng(seed), 4
    start, goal = Pairs(pair_weights(world, "pairs")).draw(n, rng)
    simulator = Simulator(world, start, goal, anybody(n, rng), rng)
    told = simulator.decoders.information
    trackers = [
        Tracker(world, int(s), world.goal_sensed(int(s), int(g)), float(bits))
        for s, g, bits in zip(start, goal, told, strict=True)
    ]
    for _ in range(n_steps):
        simulated, live = simulator.view(), [tracker.view() for tracker in trackers]
        for field in FIELDS:
            expected = getattr(simulated, field)
            found = np.concatenate([getattr(view, field) for view in live])
            np.testing.assert_array_equal(found, expected)
            assert found.dtype == expected.dtype
        actions = np.array([rng.choice(np.flatnonzero(world.legal[cell])) for cell in simulator.cell])
        simulator.step(actions)
        for i, tracker in enumerate(trackers):
            cell = int(simulator.cell[i])
            sensed = world.goal_sensed(cell, int(goal[i]))
            tracker.moved(int(actions[i]), cell, sensed, float(simulator.evidence[i]))


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_a_goal_is_sensed_here_and_next_door_and_nowhere_else(world):
    codes = sense_codes(world)
    for cell, (row, column) in enumerate(world.cells.tolist()):
        for goal, (goal_row, goal_column) in enumerate(world.cells.tolist()):
            offset = (goal_row - row, goal_column - column)
            expected = 1 if cell == goal else STEP.index(offset) + GOAL_NEXT if offset in STEP else 0
            assert codes[cell, goal] == expected
            sensed = world.goal_sensed(cell, goal)
            assert expected == (sensed.index(True) + 1 if any(sensed) else 0)


def test_the_first_view_tells_the_start_and_nothing_else():
    world = WORLDS["open"]
    view = Tracker(world, 60, NOTHING, 0.25).view()
    assert view.move[0] == world.n_cells * N_ACTIONS + 60
    assert (view.cell[0], view.evidence[0], view.sensed[0], view.step[0], view.information[0]) == (60, 0, 0, 0, 0.25)
    assert np.flatnonzero(view.visited[0]).tolist() == [60]


def test_a_move_is_told_by_the_cell_left_and_the_action():
    tracker = Tracker(WORLDS["open"], 60, NOTHING, 0.25)
    tracker.moved(3, 61, (False, True, False, False, False), -1.5)
    view = tracker.view()
    assert view.move[0] == 60 * N_ACTIONS + 3
    assert (view.cell[0], view.evidence[0], view.sensed[0], view.step[0]) == (61, -1.5, GOAL_NEXT, 1)
    assert np.flatnonzero(view.visited[0]).tolist() == [60, 61]


def test_the_goal_is_no_part_of_what_the_agent_perceives():
    assert "goal" not in FIELDS
    world, actions = WORLDS["open"], np.array([0, 0])
    # Two goals out of sight, the same start and moves, no verdicts: the same views.
    rng = np.random.default_rng(0)
    simulator = Simulator(world, np.array([60, 60]), np.array([0, 120]), anybody(2, rng), rng)
    for _ in range(2):
        view = simulator.view()
        for field in set(FIELDS) - {"evidence", "information"}:
            np.testing.assert_array_equal(getattr(view, field)[0], getattr(view, field)[1])
        simulator.step(actions)
