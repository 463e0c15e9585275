"""`bci-app evaluate` and `train`: one JSON object, or one sentence and exit code 2."""

import json

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from bci_app.cli import app
from bci_app.config import Config
from bci_app.gridworld import load_map
from decoder.calibration import calibrate
from decoder.chain import design
from decoder.model import make_model, save
from policy.cards import PolicyCard
from policy.checkpoint import pack, write
from policy.network import Network


@pytest.fixture
def folder(tmp_path):
    """A folder with an untrained policy of `obstacles`, a small map and a file that is no policy."""
    world = load_map("obstacles")
    torch.manual_seed(0)
    card = PolicyCard(world.name, world.digest, "binary:0.75", "ours", Network.layout, world.n_cells, 4, {})
    write(tmp_path / "obstacles_075.safetensors", pack(Network(world.n_cells, 4), card))
    (tmp_path / "square.txt").write_text("..\n..\n", encoding="ascii")
    (tmp_path / "junk.bin").write_bytes(b"no policy at all")
    return tmp_path


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def figures(*words):
    done = run("evaluate", *words, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


def refused(*words):
    done = run(*words)
    assert done.exit_code == 2, (done.stdout, done.stderr, done.exception)
    assert isinstance(done.exception, SystemExit)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return " ".join(done.stderr.replace("│", " ").split())


def test_an_evaluation_prints_the_contracts_keys():
    found = figures("--map", "open", "--verdicts", "binary:0.7", "--policy", "bayes", "--episodes", 200)
    contract = {"episodes", "mean_steps", "mean_steps_ci", "success_60", "success_60_by_distance_mean"}
    assert found.keys() >= contract | {"map", "verdicts", "policy"}
    assert (found["map"], found["verdicts"], found["policy"], found["episodes"]) == ("open", "binary:0.7", "bayes", 200)
    assert found["mean_steps_ci"][0] < found["mean_steps"] < found["mean_steps_ci"][1]
    assert 14 < found["mean_steps"] < 20
    assert 0.95 < found["success_60"] <= 1
    assert set(found["success_60_by_distance"]) == {str(distance) for distance in range(2, 21)}


def test_the_same_command_prints_the_same_and_what_is_heard_matters(folder):
    words = ("--map", "obstacles", "--policies", folder, "--policy", "075", "--episodes", 20, "--verdicts")
    assert figures(*words, "binary:0.9") == figures(*words, "binary:0.9")
    oracle = ("--map", "open", "--policy", "oracle", "--episodes", 50, "--verdicts", "none", "--seed")
    assert figures(*oracle, 1)["mean_steps"] != figures(*oracle, 2)["mean_steps"]
    bayes = ("--map", "open", "--policy", "bayes", "--episodes", 200, "--verdicts", "binary:0.8")
    rightly, silent = figures(*bayes)["mean_steps"], figures(*bayes, "--missing", 0.9)["mean_steps"]
    wrongly = figures(*bayes, "--taken-for", "binary:0.999")["mean_steps"]
    assert rightly + 0.5 < wrongly
    assert rightly + 5 < silent


def test_without_json_it_is_for_people():
    done = run("evaluate", "--map", "open", "--verdicts", "none", "--policy", "oracle", "--episodes", 20)
    assert done.exit_code == 0
    assert "success_60: 1.0" in done.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--verdicts", "binary:1.2", "--policy", "bayes"), "with probabilities; found 'binary:1.2'"),
        (("--verdicts", "binary:0.5", "--policy", "bayes"), "above 0.5 and at most 1, found 0.5"),
        (("--verdicts", "seventy", "--policy", "bayes"), "Verdicts must be none, binary:P"),
        (("--verdicts", "told", "--policy", "bayes"), "is for training"),
        (("--verdicts", "binary:0.7", "--policy", "nobody"), "No policy 'nobody': expected a policy file, told"),
        (("--verdicts", "binary:0.7", "--policy", "obstacles_075"), "trained on map 'obstacles'"),
        (("--verdicts", "binary:0.7", "--policy", "junk.bin"), "No policy 'junk.bin'"),
        (("--verdicts", "binary:0.7"), "No policy of the kind 'told'"),
        (("--verdicts", "binary:0.7", "--policy", "planner"), "The search and the planner of map 'open' must be in"),
        (("--verdicts", "binary:0.7", "--policy", "bayes", "--taken-for", "score:0.7"), "--taken-for must be of"),
        (("--verdicts", "binary:0.7", "--policy", "bayes", "--episodes", 1), "--episodes"),
        (("--verdicts", "binary:0.7", "--policy", "bayes", "--missing", 1.5), "--missing"),
    ],
)
def test_a_mistake_in_an_evaluation_is_one_sentence(folder, words, says):
    assert says in refused("evaluate", "--map", "open", "--policies", folder, *words)


def test_a_file_that_is_no_policy_and_a_map_that_is_none_are_refused(folder):
    words = ("evaluate", "--map", "open", "--verdicts", "none", "--policy")
    assert "must be a policy written by" in refused(*words, folder / "junk.bin")
    assert "expected one of open, obstacles" in refused(
        "evaluate", "--map", "nowhere", "--verdicts", "none", "--policy", "bayes"
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--backend", "cloud"), "--backend must be one of local, dask; found 'cloud'"),
        (("--recipe", "cake"), "--recipe must be one of ours, paper; found 'cake'"),
        (("--verdicts", "binary:0.4"), "above 0.5"),
        (("--verdicts", "none", "--library"), "--library trains all verdicts"),
        (("--backend", "dask"), "needs --scheduler ADDRESS"),
        (("--quick", "--recipe", "paper", "--library"), "--quick shortens our recipe"),
        (("--updates", 0), "--updates"),
        (("--recipe", "paper"), "--recipe paper trains for one kind of verdicts each"),
        (("--recipe", "paper", "--verdicts", "told"), "The paper's network hears a verdict's word"),
        (("--workers", 0), "--workers must be 1 or more"),
        (("--map", "nowhere.txt"), "No map 'nowhere.txt'"),
    ],
)
def test_a_mistake_in_a_training_is_one_sentence_and_nothing_is_written(tmp_path, words, says):
    out = tmp_path / "out"
    assert says in refused("train", "--out", out, *words)
    assert not out.exists()


def test_a_policy_is_trained_and_then_evaluated(folder):
    words = ("--map", folder / "square.txt", "--verdicts", "binary:0.8")
    done = run("train", *words, "--recipe", "paper", "--updates", 5, "--workers", 1, "--out", folder / "out", "--json")
    assert done.exit_code == 0, done.stderr
    path = folder / "out" / "square_080_paper.safetensors"
    assert json.loads(done.stdout) == {"policies": [str(path)]}
    found = figures(*words, "--policies", folder / "out", "--policy", "square_080_paper", "--episodes", 50)
    assert found["mean_steps"] >= 2


def test_quick_training_makes_the_told_policy_and_goes_nowhere_near_a_full_one(folder):
    words = ("--map", folder / "square.txt", "--workers", 1, "--out", folder / "quick")
    done = run("train", *words, "--quick", "--updates", 12, "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout) == {"policies": [str(folder / "quick" / "square_told.safetensors")]}
    assert figures(*words[:2], "--verdicts", "score:0.8", "--policies", folder / "quick", "--episodes", 50)
    assert "trained with other settings" in refused("train", *words)


def decoder_file(folder, shift):
    """A decoder whose held-out scores of errors and correct moves lie this far apart."""
    rng, error = np.random.default_rng(0), np.arange(200) % 2 == 0
    fitted = calibrate(rng.normal(shift * error[:, None], 1, (200, 60)), error, Config().classifier)
    chain = design(Config().chain, 500.0)
    details = {"participant": "P1", "channels": ("Fz", "FCz", "Cz", "Pz"), "n_rejected": 0}
    path = folder / f"decoder_{shift:g}.safetensors"
    save(make_model(fitted, error, chain, Config().classifier, **details), path)
    return path


def test_a_participants_own_decoder_tells_what_to_expect(folder):
    words = ("--map", "open", "--policy", "bayes", "--episodes", 300)
    good, dead = (figures(*words, "--decoder", decoder_file(folder, shift)) for shift in (0.4, 0.0))
    assert good["verdicts"].endswith("decoder_0.4.safetensors")
    assert good["mean_steps"] < 12
    assert dead["mean_steps_ci"][0] > 20


def test_a_decoder_that_cant_be_used_so_is_refused(folder):
    path = decoder_file(folder, 0.4)
    words = ("evaluate", "--map", "obstacles", "--policies", folder, "--policy")
    assert "nor take a decoder's own scores" in refused(*words, "075", "--decoder", path)
    assert "either --verdicts" in refused(*words, "bayes", "--decoder", path, "--verdicts", "none")
    assert "either --verdicts" in refused(*words, "bayes")
    assert "for simulated --verdicts" in refused(*words, "bayes", "--decoder", path, "--missing", 0.2)
    assert "Can't read the decoder" in refused(*words, "bayes", "--decoder", folder / "absent")
