"""Episodes are the same for everyone, orders are permutations, the calibrating agent errs as often as it should."""

from collections.abc import Iterator
from itertools import islice
from random import Random

import pytest

from bci_app.config import CalibrationConfig, OnlineConfig
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, compile_map, load_map
from stimulus.episodes import (
    Episode,
    calibration_action,
    calibration_plan,
    episode_order,
    online_episodes,
    online_plan,
    random_episode,
    random_episodes,
)

LINE_OF_THREE = compile_map("...", "three")
PAIR = compile_map("..", "pair")
FROZEN_OPEN = [(63, 73), (54, 41), (41, 27), (10, 5), (90, 72)]
FROZEN_ORDER = (1, 4, 2, 3, 0)


class Fixed(Random):
    """A generator that returns what it is told."""

    def __init__(self, *values: float) -> None:
        super().__init__()
        self._values: Iterator[float] = iter(values)

    def random(self) -> float:
        return next(self._values)


@pytest.mark.parametrize("name", ["open", "obstacles"])
def test_online_episodes_have_every_distance_from_2_to_20(name: str) -> None:
    world = load_map(name)
    episodes = online_episodes(world, (2, 20), 2022)
    assert [world.distance[one.start, one.goal] for one in episodes] == list(range(2, 21))


def test_online_episodes_are_frozen() -> None:
    # These very cells are what every participant sees: a change of this list changes the study.
    chosen = [(one.start, one.goal) for one in online_episodes(load_map("open"), (2, 6), 2022)]
    assert chosen == FROZEN_OPEN


def test_online_episodes_stop_at_the_longest_path_of_the_map() -> None:
    assert online_episodes(LINE_OF_THREE, (2, 20), 0) in ((Episode(0, 2),), (Episode(2, 0),))


def test_further_rounds_bring_other_episodes_of_the_same_distances() -> None:
    world = load_map("open")
    once, thrice = (list(online_plan(OnlineConfig(rounds=n), world, "s", "P", 1).episodes) for n in (1, 3))
    distances = sorted(int(world.distance[episode.start, episode.goal]) for episode in thrice)
    assert distances == sorted([*range(2, 21)] * 3)
    assert set(once) < set(thrice)


@pytest.mark.parametrize(("world", "distances"), [(PAIR, (2, 20)), (LINE_OF_THREE, (1, 2)), (LINE_OF_THREE, (3, 2))])
def test_online_episodes_that_can_not_be_are_refused(world: GridWorld, distances: tuple[int, int]) -> None:
    with pytest.raises(SetupError, match=r"online\.distances"):
        online_episodes(world, distances, 0)


def test_episode_order_is_a_permutation_that_the_seed_fixes() -> None:
    orders = {episode_order(19, seed) for seed in range(50)}
    assert len(orders) == 50
    assert all(sorted(order) == list(range(19)) for order in orders)
    assert episode_order(19, 7) == episode_order(19, 7)
    assert episode_order(5, 1) == FROZEN_ORDER
    assert episode_order(0, 1) == ()


def test_episode_order_has_no_favourites() -> None:
    first = [episode_order(3, seed)[0] for seed in range(600)]
    assert all(150 < first.count(number) < 250 for number in range(3))


def test_random_episode_is_more_than_one_move_long() -> None:
    world = load_map("obstacles")
    episodes = list(islice(random_episodes(world, Random(3)), 500))
    assert min(int(world.distance[one.start, one.goal]) for one in episodes) == 2
    assert len(set(episodes)) > 400


def test_random_episode_takes_the_last_pair_when_the_generator_is_at_its_end() -> None:
    assert random_episode(LINE_OF_THREE, Fixed(1 - 2**-53)) == Episode(2, 0)


def test_a_map_too_small_is_refused_before_the_run() -> None:
    with pytest.raises(SetupError, match="too small"):
        random_episodes(PAIR, Random(0))


def test_calibration_action_is_of_the_kind_that_was_drawn() -> None:
    world = load_map("open")
    cell, goal = world.cell_at(5, 5), world.cell_at(5, 9)
    assert calibration_action(world, cell, goal, Fixed(0.29, 0.0), 0.3) == 0  # north, the first error
    assert calibration_action(world, cell, goal, Fixed(0.29, 0.99), 0.3) == 2  # west, the last
    assert calibration_action(world, cell, goal, Fixed(0.3, 0.5), 0.3) == 3  # east is the only correct one


def test_calibration_action_takes_the_other_kind_where_there_is_no_choice() -> None:
    assert calibration_action(LINE_OF_THREE, 0, 2, Fixed(0.0, 0.0), 0.3) == 3  # a dead end: no error possible
    assert calibration_action(LINE_OF_THREE, 1, 1, Fixed(0.9, 0.0), 0.3) == 2  # at the goal: nothing is correct


@pytest.mark.parametrize("name", ["open", "obstacles"])
def test_calibration_action_is_always_legal(name: str) -> None:
    world, rng = load_map(name), Random(5)
    for _ in range(500):
        one = random_episode(world, rng)
        assert world.legal[one.start, calibration_action(world, one.start, one.goal, rng, 0.5)]


def test_plans_say_what_is_going_to_happen() -> None:
    world = load_map("open")
    calibration = calibration_plan(CalibrationConfig(), world, "s", "P001", 4, wait_for_key=False).opening
    assert (calibration.task, calibration.n_blocks, calibration.n_moves) == ("calibration", 5, 600)
    online = online_plan(OnlineConfig(), world, "s", "P001", 4).opening
    assert (online.task, online.n_episodes, online.map) == ("online", 19, "open")
    assert online.layout == world.layout()


def test_participants_get_the_same_episodes_in_another_order() -> None:
    one, other = (list(online_plan(OnlineConfig(), load_map("obstacles"), "s", "P", s).episodes) for s in (1, 2))
    assert one != other
    assert set(one) == set(other)
