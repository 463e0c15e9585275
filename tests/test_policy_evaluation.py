"""How policies are measured: on known episodes, with known figures, the same for everybody."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import compile_map, load_map
from policy.baselines import BayesPlayer, OraclePlayer
from policy.evaluation import UNLIMITED, Played, evaluate, paired_ratio, play, play_many, report, summarise, wilson
from policy.observation import STEP_LIMIT
from policy.simulator import Simulator, pair_weights
from policy.verdicts import Decoders, Verdicts

CORRIDOR = compile_map(".....", "corridor")
RING = compile_map("....\n.##.\n.##.\n....", "ring")
OPEN = load_map("open")


class East:
    """Always goes east, so every number of steps is known; at the wall it stays. Remembers how many it played."""

    def begin(self, simulator):
        """Nobody has moved."""
        self.n = [simulator.n]

    def act(self, view):
        """East."""
        assert len(view.cell) == self.n[-1]
        return np.full(len(view.cell), 3)

    def keep(self, which):
        """Some are over."""
        self.n.append(int(which.sum()))


def test_only_the_first_arrival_counts_and_a_goal_never_reached_is_lost():
    start, goal = np.array([0, 2, 4, 1]), np.array([3, 4, 0, 3])
    simulator = Simulator(CORRIDOR, start, goal, Decoders.nothing(4), np.random.default_rng(0), limit=30)
    player = East()
    assert play(player, simulator).tolist() == [3, 2, 30, 2]
    assert player.n == [4, 2, 1, 0]  # who is done is played no more


def test_the_figures_of_known_episodes():
    found = summarise(Played(np.array([2, 2, 3, 5]), np.array([10, 60, 61, UNLIMITED])))
    assert found.episodes == 4
    assert found.mean_steps == (10 + 60 + 61 + UNLIMITED) / 4
    half = 1.96 * np.std([10, 60, 61, UNLIMITED]) / 2
    assert found.mean_steps_ci == pytest.approx((found.mean_steps - half, found.mean_steps + half))
    assert found.mean_steps_60 == (10 + 60 + 60 + 60) / 4
    assert found.success_60 == 0.5
    assert found.success_60_by_distance == {2: 1.0, 3: 0.0, 5: 0.0}
    assert found.success_60_by_distance_mean == pytest.approx(1 / 3)


def test_wilsons_interval():
    """Example of Newcombe 1998 (Stat. Med. 17:857): 81 of 263."""
    low, high = wilson(np.array([True] * 81 + [False] * 182))
    assert (round(low, 4), round(high, 4)) == (0.2553, 0.3662)


@pytest.mark.parametrize("world", [OPEN, load_map("obstacles"), RING], ids=lambda world: world.name)
@pytest.mark.parametrize("distribution", ["pairs", "distances"])
def test_the_oracle_takes_the_shortest_path(world, distribution):
    played = play_many(OraclePlayer(world), world, Verdicts("none"), distribution, 2000, 0)
    np.testing.assert_array_equal(played.steps, played.distance)


def test_the_same_seed_gives_the_same_episodes_to_all_players_and_the_same_result():
    kind = Verdicts("binary", (0.75,))

    def run(seed):
        return evaluate(BayesPlayer(OPEN, pair_weights(OPEN, "pairs")), OPEN, kind, "distances", n=190, seed=seed)

    assert run(1) == run(1)
    assert run(1).mean_steps != run(2).mean_steps
    bayes = play_many(BayesPlayer(OPEN, pair_weights(OPEN, "pairs")), OPEN, kind, "pairs", 300, 1)
    oracle = play_many(OraclePlayer(OPEN), OPEN, kind, "pairs", 300, 1)
    np.testing.assert_array_equal(bayes.distance, oracle.distance)
    assert (bayes.steps >= oracle.steps).all()


def test_a_report_keeps_the_contract():
    figures = report(OraclePlayer(RING), RING, Verdicts("none"), 500, 0)
    contract = {"episodes", "mean_steps", "mean_steps_ci", "success_60", "success_60_by_distance_mean"}
    assert figures.keys() >= contract
    assert figures["episodes"] == 500
    low, high = figures["mean_steps_ci"]
    pairs = RING.distance[RING.distance >= 2]
    assert low < figures["mean_steps"] < high
    assert figures["mean_steps"] == pytest.approx(pairs.mean(), abs=0.15)
    assert figures["experiment"]["mean_steps"] == pytest.approx(np.arange(2, 7).mean(), abs=0.15)
    assert (figures["success_60"], figures["success_60_by_distance_mean"]) == (1, 1)
    assert set(figures["success_60_by_distance"]) == {2, 3, 4, 5, 6}


def test_a_ratio_of_steps_in_proportion_is_certain_and_one_of_other_episodes_is_refused():
    distance, steps = np.array([2, 3, 4, 5]), np.array([4, 10, 20, 60])
    assert paired_ratio(Played(distance, 3 * steps), Played(distance, steps)) == pytest.approx((3, 3, 3))
    with pytest.raises(ValueError, match="same episodes"):
        paired_ratio(Played(distance, steps), Played(distance[::-1], steps))


def test_the_interval_of_a_paired_ratio_covers_the_truth_19_times_in_20():
    """Two players whose steps share what the episode costs; the true ratio is 0.9. The unpaired one is far wider."""
    rng = np.random.default_rng(0)
    covered, width = [], []
    for _ in range(1000):
        hard = rng.exponential(20, 400)
        one, other = 0.9 * (hard + rng.exponential(4, 400)), hard + rng.exponential(4, 400)
        _, low, high = paired_ratio(Played(np.zeros(400, int), one), Played(np.zeros(400, int), other))
        covered.append(low <= 0.9 <= high)
        width.append(high - low)
    assert 0.93 < np.mean(covered) < 0.97
    assert np.mean(width) < 0.06  # 0.21 if the episodes weren't the same


@given(st.lists(st.tuples(st.integers(2, 20), st.integers(1, UNLIMITED)), min_size=1, max_size=40))
@settings(max_examples=50, deadline=None)
def test_figures_lie_within_their_intervals(episodes):
    distance, steps = (np.array(column) for column in zip(*episodes, strict=True))
    found = summarise(Played(distance, steps))
    assert found.mean_steps_ci[0] <= found.mean_steps <= found.mean_steps_ci[1]
    assert found.success_60_ci[0] - 1e-9 <= found.success_60 <= found.success_60_ci[1] + 1e-9
    assert found.mean_steps_60 <= min(found.mean_steps, STEP_LIMIT)
    assert found.success_60_by_distance.keys() == set(distance.tolist())
