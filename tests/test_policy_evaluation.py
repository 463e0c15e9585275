import numpy as np
import pytest

from bci_app.gridworld import compile_map, load_map
from policy.evaluation import UNLIMITED, BayesPlayer, evaluate, play, summarise, wilson
from policy.simulator import COIN_FLIPS, Simulator, VerdictModel, pair_weights

CORRIDOR = compile_map(".....", "corridor")


class East:
    """Always goes east, so every number of steps is known; at the wall it stays."""

    def begin(self, view):
        """Nothing to forget."""

    def act(self, view):
        """East."""
        return np.full(len(view.cell), 3)


def test_only_the_first_arrival_counts_and_a_goal_never_reached_is_lost():
    weights = pair_weights(CORRIDOR, "pairs")
    simulator = Simulator(CORRIDOR, 3, weights, COIN_FLIPS, np.random.default_rng(0), limit=30)
    # The second stays in its goal, the last cell, for ever after; the third goes away from its goal.
    simulator.begin(np.ones(3, bool), np.array([0, 2, 4]), np.array([3, 4, 0]))
    assert play(East(), simulator).tolist() == [3, 2, 31]


def test_the_figures_of_known_episodes():
    found = summarise(np.array([10, 60, 61, UNLIMITED + 1]))
    assert found.success == 0.5
    assert found.steps == (10 + 60 + 60 + 60) / 4
    assert found.successful_steps == 35
    assert found.unlimited_steps == (10 + 60 + 61 + UNLIMITED + 1) / 4
    assert found.steps_half_width == pytest.approx(1.96 * np.std([10, 60, 60, 60]) / 2)


def test_no_success_at_all_is_said_and_not_divided_by():
    found = summarise(np.array([90, 90]))
    assert found.success == 0
    assert np.isnan(found.successful_steps)


def test_wilsons_interval():
    """Example of Newcombe 1998 (Stat. Med. 17:857): 81 of 263."""
    low, high = wilson(np.array([True] * 81 + [False] * 182))
    assert (round(low, 4), round(high, 4)) == (0.2553, 0.3662)


def test_an_evaluation_is_deterministic_from_its_seed():
    world, verdicts = load_map("open"), VerdictModel.right(0.75)

    def run(seed):
        player = BayesPlayer(world, pair_weights(world, "pairs"), verdicts)
        return evaluate(player, world, verdicts, "distances", n=200, seed=seed)

    assert run(1) == run(1)
    assert run(1) != run(2)
