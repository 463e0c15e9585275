"""Conditions against each other, and the tables of a study, of made-up parts."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.study import page, tables
from bci_app.study.comparing import paired_tests, ratio, share
from bci_app.study.power import curve, needed

DISTANCES = range(2, 21)
PLACE = {"start_row": 0, "start_column": 0, "goal_column": 0}
SCORES = {
    name: {"value": 0.7, "low": 0.65, "high": 0.75}
    for name in ("accuracy", "balanced_accuracy", "auc", "hit_rate", "correct_rejection_rate")
} | {"n_error": 30, "n_correct": 70}


def calibrated(papers: dict[str, Any]) -> dict[str, Any]:
    return {"tenfold": SCORES, "contiguous": SCORES, "paper": {"tenfold": papers, "contiguous": papers}}


def person(name: str, factor: float = 0.7, published: str | None = None, **missing: bool) -> dict[str, Any]:
    """Somebody who takes twice the distance without ErrP, and `factor` of that with it."""
    parts: dict[str, Any] = {"calibration": calibrated(SCORES)}
    for condition, times in {"none": 2.0, "ours": 2.0 * factor}.items():
        for place in ("open", "obstacles"):
            if not missing.get(f"{condition}_{place}"):
                parts[f"{condition} {place}"] = online(times, listens=condition != "none")
    return {"participant": name, "kind": "simulated", "published": published, "parts": parts, "stopped": {}}


def online(times: float, listens: bool) -> dict[str, Any]:
    rows = [
        {
            "episode": n,
            "distance": d,
            **PLACE,
            "goal_row": d,
            "steps": round(times * d),
            "reason": "goal",
            "success": True,
        }
        for n, d in enumerate(DISTANCES)
    ]
    rows[-1] |= {"steps": 60, "reason": "limit", "success": False}
    return {
        "episodes": rows,
        "scores": SCORES if listens else None,
        "areas": {"central": [8, 10], "edge": [6, 10]},
        "errors_in_a_row": {"1": [7, 10]},
        "policy": "told",
        "why": "",
        "listens": listens,
        "n_moves": 100,
        "n_rejected": 0,
        "recording": "",
    }


def test_a_ratio_of_pairs_has_an_interval_and_tests() -> None:
    found = ratio([7, 15, 19], [10, 20, 30])
    assert found.value == pytest.approx(41 / 60 - 1)
    assert found.low < found.value < found.high  # type: ignore[operator]
    assert found.n == 3
    assert ratio([7], [10]).low is None
    assert ratio([5, 6], [5, 6]).p == 1.0


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(2, 60), st.integers(2, 60)), min_size=3, max_size=20))
def test_pairs_turned_round_are_as_significant(pairs: list[tuple[int, int]]) -> None:
    a, b = np.array(pairs, dtype=float).T
    assert paired_tests(a - b) == pytest.approx(paired_tests(b - a))
    assert ratio(a.tolist(), a.tolist()).value == 0


def test_steps_against_no_errp_are_paired_over_participants() -> None:
    people = [person("A1", 0.7), person("A2", 0.8), person("A3", 0.6)]
    row = tables.compared(people, "ours", "none", ["open", "obstacles"])
    assert row is not None
    assert row["participants"] == row["n_pairs"] == 3
    assert row["n_episodes"] == 3 * 38
    assert row["success"] == pytest.approx(18 / 19)
    assert -0.35 < row["steps_vs_none"] < -0.2
    assert row["p"] < 0.05
    none = tables.compared(people, "none", "none", ["open"])
    assert none is not None
    assert none["steps_vs_none"] == 0
    assert tables.compared(people, "paper", "none", ["open"]) is None


def test_the_same_episodes_of_many_people_tell_no_more_of_success_than_those_of_one() -> None:
    one, many = (tables.compared([person(f"S{n}") for n in range(size)], "ours", "none", ["open"]) for size in (1, 9))
    assert one is not None
    assert many is not None
    for end in ("", "_low", "_high"):
        assert many[f"success{end}"] == pytest.approx(one[f"success{end}"])
    assert many["success_low"] < 0.8 < many["success"]


def test_two_episodes_of_one_distance_are_paired_each_with_its_own() -> None:
    somebody = person("S1")
    for condition, steps in {"none": (10, 30), "ours": (30, 10)}.items():
        rows = somebody["parts"][f"{condition} open"]["episodes"][:2]
        for number, row in enumerate(rows):
            row |= {"distance": 5, "goal_row": number, "steps": steps[number]}
        somebody["parts"][f"{condition} open"]["episodes"] = rows
    found = tables.compared([somebody], "ours", "none", ["open"])
    assert found is not None
    assert found["n_pairs"] == 2
    assert found["steps_vs_none"] == 0.0
    assert found["p"] == pytest.approx(1.0)


def test_a_share_has_an_interval_over_people_not_over_moves() -> None:
    value, low, high = share([60, 90, 75], [100, 100, 100])
    assert value == 0.75
    assert (low, high) == pytest.approx((0.3774, 1.0), abs=1e-4)
    assert share([6], [10]) == (0.6, None, None)
    assert share([60, 90], [100, 100]) == (0.75, None, None)
    value, low, high = share([60, 60, 60], [100, 100, 100])
    assert (value, low, high) == (0.6, 0.6, 0.6)


def test_enough_participants_are_enough_for_good() -> None:
    points = [{"participants": n, "power": power} for n, power in ((2, 0.5), (3, 0.81), (4, 0.79), (5, 0.8), (6, 0.9))]
    assert needed(points) == 5
    assert needed(points[:3]) is None


def test_one_participant_is_paired_over_episodes() -> None:
    row = tables.by_participant([person("A1")], ("none", "ours"), ("open",))[2]
    assert (row["condition"], row["map"], row["participants"], row["n_pairs"]) == ("ours", "open", 1, 19)


@pytest.mark.parametrize("number", [1, 2])
def test_of_one_or_two_participants_there_is_no_interval_over_participants(number: int) -> None:
    people = [person(f"A{n}", 0.7 + 0.1 * n) for n in range(number)]
    row = tables.headline(people, ("none", "ours"), ("open",), 0.7)[2]
    assert (row["condition"], row["participants"]) == ("ours", number)
    assert row["steps_vs_none"] is not None
    assert [row[name] for name in tables.OVER_PEOPLE] == [None] * len(tables.OVER_PEOPLE)


def test_without_the_condition_none_nothing_is_compared() -> None:
    people = [person(f"P{number}") for number in range(4)]
    alone = [{**each, "parts": {k: v for k, v in each["parts"].items() if not k.startswith("none")}} for each in people]
    for those, compares in ((people, True), (alone, False)):
        found = tables.headline(those, ("ours",), ("open",), 0.7)
        for row in (*found, *tables.by_participant(those, ("ours",), ("open",))):
            assert [row[key] is not None for key in ("steps_vs_none", "p", "p_ranks")] == [compares] * 3


def test_of_two_pairs_there_is_no_interval_over_pairs() -> None:
    people = [person("A1"), person("A2", 0.8), person("A3", 0.6, none_open=True)]
    row = tables.headline(people, ("none", "ours"), ("open",), 0.7)[2]
    assert (row["condition"], row["participants"], row["n_pairs"]) == ("ours", 3, 2)
    assert row["mean_steps_low"] is not None
    assert [row[name] for name in tables.OVER_PAIRS] == [None] * len(tables.OVER_PAIRS)


def test_a_mean_lies_within_its_interval_as_it_is_told() -> None:
    people = [person(f"A{n}") for n in range(3)]
    row = tables.headline(people, ("none", "ours"), ("open",), 0.7)[0]
    mean, low, high = (f"{row[name]:.2f}" for name in ("mean_steps", "mean_steps_low", "mean_steps_high"))
    assert page.cells(row)[1] == f"{mean} [{low},\u00a0{high}]"


def test_who_stopped_halfway_is_told_and_enters_only_what_is_whole() -> None:
    people = [person("A1"), person("A2"), person("A3", ours_obstacles=True)]
    people[2]["stopped"] = {"part": "ours obstacles", "why": "interrupted: Escape"}
    wanted = {each["participant"]: list(people[0]["parts"]) for each in people}
    assert tables.unfinished(people, wanted) == [
        {"participant": "A3", "lacks": "ours obstacles", "why": "stopped in ours obstacles: interrupted: Escape"}
    ]
    rows = tables.headline(people, ("none", "ours"), ("open", "obstacles"), 0.7)
    n = {(row["condition"], row["map"]): row["participants"] for row in rows if row["group"] == tables.ALL}
    assert n == {
        ("none", "open"): 3,
        ("none", "obstacles"): 3,
        ("none", "all"): 3,
        ("ours", "open"): 3,
        ("ours", "obstacles"): 2,
        ("ours", "all"): 2,
    }


def test_the_papers_tables_have_its_numbers_below_ours() -> None:
    people = [person("S2", published="S2"), person("B1")]
    found = tables.papers_tables(people, ("none", "ours"), ("open", "obstacles"))
    assert "table_1_none" not in found
    assert {"table_1_ours", "table_2_none", "table_2_ours", "table_a_open_ours", "table_a_obstacles_none"} <= set(found)
    names = [(row["series"], row["participant"]) for row in found["table_2_ours"]]
    assert names[:3] == [("ours", "S2"), ("ours", "B1"), ("ours", "mean")]
    assert names[3:5] == [("Wang et al. 2022, people", "S2"), ("Wang et al. 2022, people", "S4")]
    mean = found["table_2_ours"][-1]
    assert (mean["open_success"], mean["obstacles_success"]) == (0.8120, 0.8496)
    assert found["table_a_open_ours"][0]["distance_2"] == "3"


def test_who_is_below_the_papers_gate_is_a_group_of_its_own() -> None:
    people = [person("S2", published="S2"), person("B1")]
    people[1]["parts"]["calibration"] = calibrated(SCORES | {"accuracy": {"value": 0.62}})
    found = tables.groups(people, 0.7)
    assert {name: [each["participant"] for each in group] for name, group in found.items()} == {
        "all": ["S2", "B1"],
        "of the paper": ["S2"],
        "below the paper's gate": ["B1"],
    }


def test_power_grows_with_participants_and_chance_sees_what_it_may() -> None:
    rng = np.random.default_rng(0)
    points = curve(rng.normal(-1, 1, (20, 50)), 500, seed=1)
    powers = [point["power"] for point in points]
    # By the t distribution 10 participants see an effect of one standard deviation with a power of 80 %.
    assert needed(points) in (9, 10, 11)
    assert powers == sorted(powers) or np.diff(powers).min() > -0.05
    by_chance = curve(rng.normal(0, 1, (500, 50)), 500, seed=1)
    assert needed(by_chance) is None
    assert all(point["power"] < 0.06 for point in by_chance)
