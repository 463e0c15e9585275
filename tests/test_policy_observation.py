import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import compile_map, load_map
from policy.observation import (
    CORRECT,
    ERROR,
    MISSING,
    Tracker,
    View,
    encode,
    fields,
    input_size,
    sensed_table,
)
from policy.simulator import Simulator, VerdictModel, pair_weights

WORLDS = {
    "open": load_map("open"),
    "obstacles": load_map("obstacles"),
    "oblong": compile_map("....\n.##.\n....", "oblong"),
}


@given(st.sampled_from(sorted(WORLDS)), st.integers(0, 2**32 - 1), st.integers(1, 70))
@settings(max_examples=40, deadline=None)
def test_one_live_episode_and_the_vectorised_simulator_give_identical_inputs(name, seed, n_steps):
    world, rng = WORLDS[name], np.random.default_rng(seed)
    simulator = Simulator(world, 5, pair_weights(world, "pairs"), VerdictModel(0.7, 0.8, 0.2), rng)
    sensed = [world.goal_sensed(int(c), int(g)) for c, g in zip(simulator.cell, simulator.goal, strict=True)]
    trackers = [Tracker(world, int(cell), s) for cell, s in zip(simulator.cell, sensed, strict=True)]
    for _ in range(n_steps):
        single = np.concatenate([encode(world, tracker.view()) for tracker in trackers])
        np.testing.assert_array_equal(single, encode(world, simulator.view()))
        actions = np.array([rng.choice(np.flatnonzero(world.legal[cell])) for cell in simulator.cell])
        simulator.step(actions)
        for i, tracker in enumerate(trackers):
            cell, goal = int(simulator.cell[i]), int(simulator.goal[i])
            verdict = int(simulator.verdict[i])
            tracker.moved(int(actions[i]), cell, world.goal_sensed(cell, goal), verdict)


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_the_fields_tile_the_input(world):
    covered = np.concatenate([np.arange(s.start, s.stop) for s in fields(world).values()])
    np.testing.assert_array_equal(covered, np.arange(input_size(world)))


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_the_table_of_what_is_sensed_agrees_with_the_world(world):
    table = sensed_table(world)
    for cell in range(world.n_cells):
        for goal in range(world.n_cells):
            assert tuple(table[cell, goal]) == world.goal_sensed(cell, goal)


def test_a_missing_verdict_is_told_from_a_correct_and_an_error():
    world = WORLDS["open"]
    rows = []
    for verdict in (CORRECT, MISSING, ERROR):
        tracker = Tracker(world, 0, (False,) * 5)
        tracker.moved(1, 11, (False,) * 5, verdict)
        rows.append(encode(world, tracker.view())[0])
    given_column = fields(world)["verdict_given"].start
    assert [row[given_column] for row in rows] == [1, 0, 1]
    assert [row[fields(world)["verdict"].start] for row in rows] == [-1, 0, 1]


def test_inputs_stay_within_their_maxima_beyond_the_step_limit():
    world = WORLDS["open"]
    tracker = Tracker(world, 0, (False,) * 5)
    for step in range(200):
        tracker.moved(1 - step % 2, 11 if step % 2 == 0 else 0, (False,) * 5, ERROR)
    assert np.abs(encode(world, tracker.view())).max() == 1


def test_the_goal_is_no_part_of_what_the_agent_perceives():
    assert "goal" not in {field.name for field in dataclasses.fields(View)}
    world = WORLDS["open"]
    # Two goals out of sight, the same start: the same inputs.
    inputs = [encode(world, Tracker(world, 60, world.goal_sensed(60, goal)).view()) for goal in (0, 120)]
    np.testing.assert_array_equal(*inputs)
