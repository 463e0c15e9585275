"""The search without verdicts: complete, as short as can be, and the same for starts that are alike."""

import heapq

import numpy as np
import pytest

from bci_app.gridworld import compile_map, load_map
from policy.baselines import BayesPlayer, SearchPlayer
from policy.coverage import search_paths, searching, symmetries
from policy.evaluation import evaluate
from policy.simulator import pair_weights
from policy.verdicts import Verdicts

SMALL = {
    "ring": compile_map("....\n.##.\n.##.\n....", "ring"),
    "oblong": compile_map("....\n....\n....", "oblong"),
    "corridor": compile_map(".......", "corridor"),
    "tee": compile_map(".....\n##.##\n##.##", "tee"),
}
SEVEN = compile_map("\n".join(["......."] * 7), "seven")


def seen_from(world, cell):
    return {goal for goal in range(world.n_cells) if any(world.goal_sensed(cell, goal))}


def expected_steps(world, start, actions, weight):
    """Steps until a goal is sensed, weighed; and the goals that never are."""
    cell, steps = start, 0.0
    hidden = {goal for goal in range(world.n_cells) if weight[goal] > 0} - seen_from(world, start)
    for action in actions:
        if action < 0:
            break
        assert world.legal[cell, action]
        steps += sum(weight[goal] for goal in hidden)
        cell = int(world.next_cell[cell, action])
        hidden -= seen_from(world, cell)
    return steps, hidden


def fewest_steps(world, start, weight):
    """The best there is, by Dijkstra over every cell and set of goals still hidden."""
    seen = [sum(1 << goal for goal in seen_from(world, cell)) for cell in range(world.n_cells)]
    of_set = [sum(weight[g] for g in range(world.n_cells) if s >> g & 1) for s in range(1 << world.n_cells)]
    hidden = sum(1 << goal for goal in range(world.n_cells) if weight[goal] > 0) & ~seen[start]
    queue, done = [(0.0, start, hidden)], set()
    while queue:
        steps, cell, hidden = heapq.heappop(queue)
        if not hidden:
            return steps
        if (cell, hidden) in done:
            continue
        done.add((cell, hidden))
        for action in np.flatnonzero(world.legal[cell]):
            there = int(world.next_cell[cell, action])
            heapq.heappush(queue, (steps + of_set[hidden], there, hidden & ~seen[there]))
    raise AssertionError("some goal can't be sensed")


@pytest.mark.parametrize("world", SMALL.values(), ids=SMALL)
def test_every_goal_is_sensed_and_no_path_takes_fewer_steps_on_average(world):
    weights = pair_weights(world, "pairs")
    for start, path in enumerate(search_paths(world, far_share=0.0)):
        steps, hidden = expected_steps(world, start, path, weights[start])
        assert not hidden
        assert steps == pytest.approx(fewest_steps(world, start, weights[start]))


def test_starts_that_are_alike_have_paths_of_equal_cost():
    paths, weights = search_paths(SEVEN, beam=50), pair_weights(SEVEN, "pairs")
    cost = np.array([expected_steps(SEVEN, s, path, weights[s])[0] for s, path in enumerate(paths)])
    assert not any(expected_steps(SEVEN, s, path, weights[s])[1] for s, path in enumerate(paths))
    for cells, _ in symmetries(SEVEN):
        np.testing.assert_allclose(cost[cells], cost)


@pytest.mark.parametrize(
    ("world", "n"), [(load_map("open"), 8), (load_map("obstacles"), 4), (SMALL["ring"], 8), (SMALL["oblong"], 4)]
)
def test_symmetries_leave_the_map_as_it_is(world, n):
    turns = symmetries(world)
    assert len({tuple(cells) for cells, _ in turns}) == len(turns) == n
    for cells, actions in turns:
        assert sorted(cells) == list(range(world.n_cells))
        for action in range(4):
            np.testing.assert_array_equal(cells[world.next_cell[:, action]], world.next_cell[cells, actions[action]])
        np.testing.assert_array_equal(world.distance[cells][:, cells], world.distance)


def test_the_tee_has_but_one_mirror_image():
    assert len(symmetries(SMALL["tee"])) == 2


def test_the_search_beats_the_greedy_filter_without_verdicts():
    weights, none = pair_weights(SEVEN, "pairs"), Verdicts("none")
    search = evaluate(SearchPlayer(search_paths(SEVEN, beam=50)), SEVEN, none, n=20_000)
    greedy = evaluate(BayesPlayer(SEVEN, weights), SEVEN, none, n=20_000)
    assert search.success_60 == 1
    assert search.mean_steps_ci[1] < greedy.mean_steps_ci[0]


def test_a_goal_that_is_sensed_is_entered_and_the_path_left():
    paths = np.array([[3, 1, -1], [3, 1, -1], [0, 2, 2]])
    sensed = np.array([0, 4, 2], np.uint8)
    assert searching(paths, np.array([1, 1, 7]), sensed).tolist() == [1, 2, 0]
    assert searching(paths, np.array([0, 1, 7]), np.zeros(3, np.uint8)).tolist() == [3, 1, 2]
