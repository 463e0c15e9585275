import csv
import json
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from matplotlib.image import imread

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from policy import teachers
from policy.cards import PolicyCard
from policy.checkpoint import pack, write
from policy.experiment1 import published
from policy.experiment1.tables import TABLES, run
from policy.network import HIDDEN, Network, PaperNetwork
from policy.planner import PlannerSettings

torch.set_num_threads(1)  # small matrices: more threads only wait for each other


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Experiment 1 on a small map with a few policies that never learnt anything: result, folder, progress."""
    folder = tmp_path_factory.mktemp("experiment1")
    (folder / "hall.txt").write_text("....\n....\n#...")
    world, policies = load_map(str(folder / "hall.txt")), folder / "policies"
    lesson = teachers.make(world, PlannerSettings(n_episodes=16, updates=1, critic_updates=0))
    write(teachers.path_of(policies, world), lesson)
    torch.manual_seed(0)
    for kind, verdicts in [
        (Network, "none"),
        (Network, "binary:0.75"),
        (Network, "binary:1"),
        (PaperNetwork, "binary:0.7"),
    ]:
        recipe, story = ("ours", {}) if kind is Network else ("paper", {"curve": [[1000, 30.0], [2000, 20.0]]})
        card = PolicyCard("hall", world.digest, verdicts, recipe, kind.layout, world.n_cells, HIDDEN, story)
        write(policies / f"{card.name}.safetensors", pack(kind(world.n_cells), card))
    told = []
    found = run(folder / "out", policies, 6, lambda *words: told.append(words), maps=[str(folder / "hall.txt")])
    return found, folder / "out", told


def those(rows, **wanted):
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def test_what_is_returned_is_what_is_written(done):
    found, folder, _ = done
    assert json.loads((folder / "experiment1.json").read_text()) == found
    assert tuple(found["tables"]) == TABLES
    for name, rows in found["tables"].items():
        with (folder / f"{name}.csv").open(newline="") as file:
            assert len(list(csv.DictReader(file))) == len(rows) > 0


def test_absent_policies_are_named_and_those_that_tell_no_curve_too(done):
    found, _, _ = done
    assert {"hall_070", "hall_told", "hall_100_paper"} <= set(found["absent"])
    assert not {"hall_none", "hall_070_paper", "hall_teacher"} & set(found["absent"])
    assert len(set(found["absent"])) == len(found["absent"])
    assert found["without_curve"] == ["hall_none", "hall_075", "hall_100"]


def test_progress_goes_up_to_the_end(done):
    _, _, told = done
    assert [at for _, at, _ in told] == list(range(told[-1][2] + 1))


def test_steps_by_accuracy(done):
    rows = done[0]["tables"]["accuracy"]
    assert [row["accuracy"] for row in those(rows, series="ours")] == [None, 0.75, 1.0]
    assert len(those(rows, series="Bayes filter")) == 11
    for row in rows:
        assert row["ci_low"] <= row["mean_steps"] <= row["ci_high"]
    oracle, bayes = (those(rows, series=series)[-1]["mean_steps"] for series in ("oracle", "Bayes filter"))
    assert 2 <= oracle <= bayes < those(rows, series="ours", accuracy=None)[0]["mean_steps"]
    assert oracle <= those(rows, series="search")[0]["mean_steps"]


def test_a_policy_under_the_accuracy_it_was_trained_at_plays_as_in_the_other_table(done):
    tables = done[0]["tables"]
    here = those(tables["robustness"], series="ours", trained=0.75, accuracy=0.75)
    there = those(tables["accuracy"], series="ours", accuracy=0.75)
    assert here[0]["mean_steps"] == there[0]["mean_steps"]
    assert {(row["series"], row["trained"]) for row in tables["robustness"]} == {
        ("ours", 0.75), ("ours", 1.0)
    }  # fmt: skip
    assert len(tables["robustness"]) == 2 * 7


def test_gradients_of_verdict_and_position_by_all_methods(done):
    tables = done[0]["tables"]
    kinds = {(row["series"], row["accuracy"]) for row in tables["gradients"]}
    assert kinds == {("ours", 0.75), ("ours", 1.0), ("paper", 0.7)}
    assert len(tables["gradients"]) == len(kinds) * 3 * 2
    assert all(row["mean"] >= 0 for row in tables["gradients"])
    cells = those(tables["gradient_map"], series="ours", accuracy=0.75)
    mean = sum(row["gradient"] * row["steps"] for row in cells) / sum(row["steps"] for row in cells)
    (overall,) = those(tables["gradients"], series="ours", accuracy=0.75, method="gradient", input="verdict")
    assert mean == pytest.approx(overall["mean"])
    assert (2, 0) not in {(row["row"], row["column"]) for row in cells}


def test_success_by_distance(done):
    tables = done[0]["tables"]
    assert {(row["series"], row["accuracy"]) for row in tables["success"]} == {("ours", None), ("paper", 0.7)}
    rows = those(tables["success"], series="ours")
    assert [row["distance"] for row in rows] == [2, 3, 4, 5]
    assert sum(row["episodes"] for row in rows) == 3 * 4
    for row in rows:
        assert row["ci_low"] <= row["success"] <= row["ci_high"]
    (mean,) = those(tables["success_mean"], series="ours")
    assert mean["success"] == pytest.approx(np.mean([row["success"] for row in rows]))


def test_trajectories_are_moves_from_one_start_to_one_goal(done):
    rows = done[0]["tables"]["trajectories"]
    for accuracy in (None, 1.0):
        path = those(rows, accuracy=accuracy)
        places = np.array([(row["row"], row["column"]) for row in path])
        assert (places[0] == 0).all()
        assert [row["step"] for row in path] == list(range(len(path)))
        assert (np.abs(np.diff(places, axis=0)).sum(axis=1) == 1).all()
        assert len(path) == 61 or (places[-1] == (path[0]["goal_row"], path[0]["goal_column"])).all()


def test_figures_are_there_and_not_empty(done):
    found, folder, _ = done
    assert len(found["figures"]) == 8
    for paths in found["figures"].values():
        svg, pdf, png = (folder / path.rpartition("/")[2] for path in paths)
        assert ElementTree.parse(svg).getroot().tag.endswith("svg")
        assert pdf.read_bytes().startswith(b"%PDF")
        image = imread(png)
        assert image.shape[1] == 1050
        assert len(np.unique(image @ [1, 10, 100, 1000])) > 50  # so many colours


def test_without_any_policies_there_are_the_filter_and_the_published_numbers(tmp_path):
    found = run(tmp_path / "out", tmp_path / "nothing", 20, lambda *words: None, maps=["open"])
    assert {"open_told", "open_none", "open_055_paper", "open_teacher"} <= set(found["absent"])
    rows = found["tables"]["accuracy"]
    said = {row["accuracy"]: row["mean_steps"] for row in those(rows, series="published")}
    assert said == published.STEPS["open"]
    assert {row["series"] for row in rows} == {"published", "Bayes filter", "oracle"}
    assert set(found["figures"]) == {"figure3b_steps_by_accuracy", "figure4_robustness"}


def test_a_policy_of_another_map_is_refused(tmp_path):
    world = load_map("open")
    card = PolicyCard("open", "0" * 64, "none", "ours", Network.layout, world.n_cells, 64, {})
    write(tmp_path / "open_none.safetensors", pack(Network(world.n_cells), card))
    with pytest.raises(SetupError, match="was trained on map 'open'"):
        run(tmp_path / "out", tmp_path, 20, lambda *words: None, maps=["open"])
