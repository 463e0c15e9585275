"""Planning anew after every move: without verdicts the search, with certainty the shortest way, else no worse."""

import numpy as np
import pytest

from bci_app.gridworld import compile_map
from policy.baselines import BayesPlayer, ReplanningPlayer, SearchPlayer
from policy.belief import Belief
from policy.coverage import search_paths
from policy.evaluation import evaluate
from policy.observation import sense_codes
from policy.replanning import Replanning
from policy.simulator import Simulator, pair_weights
from policy.verdicts import Verdicts

RING = compile_map("....\n.##.\n.##.\n....", "ring")
TEE = compile_map(".....\n##.##\n##.##", "tee")
SEVEN = compile_map("\n".join(["......."] * 7), "seven")
BOTH = pytest.mark.parametrize("world", [RING, TEE], ids=lambda world: world.name)


def believing(world, cell, probability):
    """A belief that was come by somehow."""
    n = len(cell)
    simulator = Simulator(world, cell, cell, Verdicts("none")(n, None), np.random.default_rng(0))
    belief = Belief(world, np.ones((world.n_cells, world.n_cells)), simulator.view())
    belief.probability = probability.astype(np.float32)
    return belief


def walked(world, paths, start, goal, first):
    """Moves to a goal of one who makes these moves first and then follows the path laid down from where they lead."""
    codes, cell, moves = sense_codes(world), start, 0
    plan = list(first)
    for _ in range(100):
        if cell == goal:
            return moves
        if moves >= len(first) and codes[cell, goal] >= 2:
            action = int(codes[cell, goal]) - 2
        else:
            if not plan:
                plan = [int(action) for action in paths[cell] if action >= 0]
            action = plan.pop(0)
        cell, moves = int(world.next_cell[cell, action]), moves + 1
    raise AssertionError("never found")


@BOTH
def test_costs_are_those_of_walks(world):
    """No action costs more than its move and the search from where it leads, and what a path promises it keeps."""
    paths = search_paths(world)
    planning, rng = Replanning(world, paths), np.random.default_rng(0)
    cell = np.repeat(np.arange(world.n_cells), 3)
    cost = planning.cost(believing(world, cell, rng.dirichlet(np.ones(world.n_cells), len(cell))))
    np.testing.assert_array_equal(np.isfinite(cost), world.legal[cell])
    for here in range(world.n_cells):
        for goal in np.flatnonzero(np.arange(world.n_cells) != here):
            certain = planning.cost(believing(world, np.array([here]), np.eye(world.n_cells)[[goal]]))[0]
            assert certain.min() == world.distance[here, goal]
            for action in np.flatnonzero(world.legal[here]):
                assert certain[action] <= walked(world, paths, here, goal, [action])


def test_with_certainty_it_goes_straight_and_without_verdicts_it_searches():
    paths = search_paths(SEVEN)
    weights = pair_weights(SEVEN, "pairs")
    player, greedy = ReplanningPlayer(SEVEN, weights, paths), BayesPlayer(SEVEN, weights)

    def steps(player, words):
        return evaluate(player, SEVEN, Verdicts.parse(words), n=2000).mean_steps

    assert steps(player, "binary:1") < 1.1 * steps(greedy, "binary:1")
    assert steps(player, "none") < 1.02 * steps(SearchPlayer(paths), "none")


@pytest.mark.parametrize("words", ["binary:0.55", "score:0.6"])
def test_where_verdicts_say_little_it_beats_the_greedy_move_and_the_search(words):
    verdicts, weights = Verdicts.parse(words), pair_weights(SEVEN, "pairs")
    paths = search_paths(SEVEN)
    planned, greedy, laid_down = (
        evaluate(player, SEVEN, verdicts, n=8000).mean_steps
        for player in (ReplanningPlayer(SEVEN, weights, paths), BayesPlayer(SEVEN, weights), SearchPlayer(paths))
    )
    assert planned < 0.98 * greedy
    assert planned < laid_down
