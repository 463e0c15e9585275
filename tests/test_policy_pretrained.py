"""The shipped policies keep what the README says of them, each on 1000 fresh episodes."""

import pytest
import torch

from bci_app.gridworld import load_map
from policy.checkpoint import check_fits, choose, load
from policy.evaluation import NetworkPlayer, evaluate
from policy.simulator import COIN_FLIPS, NO_VERDICTS, VerdictModel

torch.set_num_threads(1)  # small matrices: more threads only wait for each other
MAPS = ("open", "obstacles")


def shipped(name, accuracy):
    world = load_map(name)
    network, card = load(choose(accuracy, world).path)
    check_fits(card, world)
    assert card.accuracy == accuracy
    return NetworkPlayer(network, world), world


def result(name, trained, verdicts, distribution="distances", n=1000):
    player, world = shipped(name, trained)
    return evaluate(player, world, verdicts, distribution, n=n, seed=77)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("accuracy", "steps", "success"), [(0.70, 20.0, 0.98), (0.75, 18.0, 0.98), (0.80, 16.5, 0.98)])
def test_the_experiments_episodes_take_few_steps(name, accuracy, steps, success):
    found = result(name, accuracy, VerdictModel.right(accuracy))
    assert found.steps - found.steps_half_width < steps
    assert found.success_interval[1] > success
    assert found.success > success - 0.01


@pytest.mark.parametrize("name", MAPS)
def test_without_verdicts_the_map_is_still_searched(name):
    """Paper, Table 1: 51.2 and 50.7 steps, 79.7 and 69.4 % success without verdicts."""
    found = result(name, None, NO_VERDICTS)
    assert found.success > 0.94
    assert found.unlimited_steps < 30


@pytest.mark.parametrize("name", MAPS)
def test_coin_flips_are_worse_than_verdicts_and_worse_than_none(name):
    useful = result(name, 0.75, VerdictModel.right(0.75))
    flips = result(name, 0.75, COIN_FLIPS)
    assert flips.steps - flips.steps_half_width > useful.steps + useful.steps_half_width
    assert flips.success < useful.success
    assert flips.steps > result(name, None, NO_VERDICTS).steps


@pytest.mark.parametrize("name", MAPS)
def test_decoders_that_miss_errors_are_borne(name):
    """Hit .654 and correct rejection .859, of 16 real people (Ehrlich & Cheng 2018, our count)."""
    found = result(name, 0.75, VerdictModel(0.654, 0.859))
    assert found.success > 0.96
    assert found.steps < 21


def test_missing_verdicts_are_borne():
    found = result("open", 0.75, VerdictModel.right(0.75, missing=0.2))
    assert found.success > 0.95
