"""Training many policies: on this machine or on a cluster, each once, and each to the same bit."""

import shutil
import socket
from dataclasses import replace

import pytest
import torch
from joblib.externals.loky import get_reusable_executor

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from policy import library, teachers
from policy.actor_critic import ActorCriticSettings
from policy.checkpoint import load, read_card
from policy.distillation import DistillationSettings
from policy.evaluation import NetworkPlayer, evaluate
from policy.library import Backend, Settings, train
from policy.network import Network, PaperNetwork, ToldNetwork
from policy.planner import PlannerSettings
from policy.recitation import RecitationSettings
from policy.training import MISSING, PolicyJob
from policy.verdicts import Verdicts

TINY = Settings(
    teacher=PlannerSettings(n_episodes=16, n_steps=4, n_minibatches=2, updates=2, critic_updates=1),
    search=RecitationSettings(updates=40, learning_rate=1e-2, what_if=1.0),
    told=DistillationSettings(n_episodes=32, n_steps=5, updates=25, learning_rate=1e-2),
    special=DistillationSettings(n_episodes=16, n_steps=4, updates=2, guided=0.0),
    paper=ActorCriticSettings(n_episodes=32, n_steps=8, n_minibatches=2, updates=20, learning_rate=5e-3),
)
BINARY, SCORE = Verdicts("binary", (0.8,)), Verdicts("score", (0.7,))
LOCAL = Backend("local", n_workers=2)
NAMES = ["square_080", "square_none", "square_score070", "square_teacher", "square_told"]


@pytest.fixture(scope="module")
def square(tmp_path_factory):
    """A map of four cells."""
    path = tmp_path_factory.mktemp("map") / "square.txt"
    path.write_text("..\n..\n", encoding="ascii")
    return str(path)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory, square):
    """A library trained by two local processes, and the progress it told."""
    folder, told = tmp_path_factory.mktemp("library"), []
    run(square, folder, LOCAL, lambda *news: told.append(news))
    yield folder, told
    get_reusable_executor().shutdown(wait=True)


@pytest.fixture
def copy(shelf, tmp_path):
    """A library of one's own to spoil."""
    shutil.copytree(shelf[0], tmp_path / "copy")
    return tmp_path / "copy"


def run(square, folder, backend=LOCAL, progress=lambda *news: None, wanted=(BINARY, SCORE), settings=TINY):
    return train([square], wanted, "ours", folder, settings, backend, progress)


def state(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


def weights(path):
    return load(path)[0].state_dict()


def assert_same_weights(one, other):
    for first, second in zip(weights(one).items(), weights(other).items(), strict=True):
        assert first[0] == second[0]
        assert torch.equal(first[1], second[1]), first[0]


def test_a_library_is_trained_with_all_that_it_needs(shelf, square):
    folder, told = shelf
    assert sorted(path.name for path in folder.iterdir()) == [f"{name}.safetensors" for name in NAMES]
    cards = {name: read_card(folder / f"{name}.safetensors") for name in NAMES if name != "square_teacher"}
    words = {name: card.verdicts for name, card in cards.items()}
    assert words == {
        "square_080": "binary:0.8",
        "square_none": "none",
        "square_score070": "score:0.7",
        "square_told": "told",
    }
    assert {name: card.name for name, card in cards.items()} == {name: name for name in cards}
    assert all(card.map_digest == load_map(square).digest for card in cards.values())
    assert cards["square_080"].story["start"] == "square_told"
    assert isinstance(load(folder / "square_told.safetensors")[0], ToldNetwork)
    assert isinstance(load(folder / "square_080.safetensors")[0], Network)
    for what, done, of in told:
        assert "ready" in what
        assert 0 <= done <= of
    assert {what.split(",")[0] for what, _, _ in told} == {"teachers", "searches", "told policies", "policies"}


def test_figures_on_the_card_are_of_the_weights_in_the_file(shelf, square):
    network, card = load(shelf[0] / "square_080.safetensors")
    world = load_map(square)
    found = evaluate(NetworkPlayer(network, world), world, replace(BINARY, missing=MISSING), "pairs", 5000, seed=1)
    assert card.story["evaluation"]["pairs"]["mean_steps"] == found.mean_steps


def test_what_is_there_is_not_trained_again(shelf, square):
    before = state(shelf[0])
    paths = run(square, shelf[0])
    assert [path.stem for path in paths] == ["square_080", "square_score070"]
    assert state(shelf[0]) == before


def test_what_is_missing_alone_is_trained_and_comes_out_the_same(shelf, copy, square):
    lost = "square_080.safetensors"
    before = state(copy)
    (copy / lost).unlink()
    run(square, copy)
    after = state(copy)
    assert_same_weights(copy / lost, shelf[0] / lost)
    assert {name: now for name, now in after.items() if name != lost} == {k: v for k, v in before.items() if k != lost}


@pytest.mark.parametrize("kind", ["special", "told", "search", "teacher"])
def test_other_settings_are_refused_and_nothing_is_overwritten(copy, square, kind):
    before = state(copy)
    other = replace(TINY, **{kind: replace(getattr(TINY, kind), updates=3)})
    with pytest.raises(SetupError, match=r"already, trained with other settings, and it is not overwritten"):
        run(square, copy, settings=other)
    assert state(copy) == before


def test_a_map_of_the_same_name_is_not_the_same_map(copy, tmp_path):
    (tmp_path / "square.txt").write_text("...\n...\n", encoding="ascii")
    before = state(copy)
    with pytest.raises(SetupError, match="square"):
        run(str(tmp_path / "square.txt"), copy)
    assert state(copy) == before


def test_a_cluster_trains_the_same_policies(shelf, copy, square):
    from dask.distributed import LocalCluster

    lost = [copy / f"{name}.safetensors" for name in ("square_080", "square_score070", "square_told")]
    for path in lost:
        path.unlink()
    where = {"host": "127.0.0.1", "protocol": "tcp://", "dashboard_address": None}
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, **where) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://127.0.0.1:")
        run(square, copy, Backend("dask", scheduler=address))
    for path in lost:
        assert_same_weights(path, shelf[0] / path.name)


def test_a_cluster_without_workers_is_said_to_have_none(copy, square, monkeypatch):
    from dask.distributed import LocalCluster

    monkeypatch.setattr(library, "CONNECT_TIMEOUT_S", 1.0)
    (copy / "square_080.safetensors").unlink()
    where = {"host": "127.0.0.1", "protocol": "tcp://", "dashboard_address": None}
    with (
        LocalCluster(n_workers=0, processes=False, **where) as cluster,
        pytest.raises(SetupError, match=r"has no worker after 1 s.*dask worker tcp://127"),
    ):
        run(square, copy, Backend("dask", scheduler=cluster.scheduler_address))


def test_a_scheduler_that_does_not_answer_is_named(copy, square, monkeypatch):
    monkeypatch.setattr(library, "CONNECT_TIMEOUT_S", 0.5)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and doesn't listen
        address = f"tcp://127.0.0.1:{nobody.getsockname()[1]}"
        with pytest.raises(SetupError, match=rf"No Dask scheduler answers at {address} within 0\.5 s"):
            run(square, copy, Backend("dask", scheduler=address))


def test_a_cluster_needs_an_address(copy, square):
    with pytest.raises(SetupError, match="needs --scheduler ADDRESS"):
        run(square, copy, Backend("dask"))


def test_the_papers_recipe_needs_no_teacher_and_repeats_itself(square):
    job = PolicyJob(square, BINARY, TINY.paper)
    assert (job.name, job.recipe) == ("square_080_paper", "paper")
    told = []
    contents = job.run(lambda done, of, word: told.append((done, of)))
    assert told == [(number, 20) for number in range(1, 21)]
    from policy.checkpoint import unpack

    network, card = unpack(contents, "x")
    assert isinstance(network, PaperNetwork)
    assert card.layout == "paper-1"
    again, _ = unpack(replace(job).run(), "x")
    for one, other in zip(network.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_a_teacher_is_the_same_wherever_it_is_made(shelf, square):
    world = load_map(square)
    made = teachers.make(world, TINY.teacher)
    assert made == teachers.path_of(shelf[0], world).read_bytes()


def test_words_become_verdicts_each_once_and_settings_take_updates_and_a_seed():
    assert library.parsed(["told", "binary:0.70", "binary:0.7"]) == [Verdicts("told"), Verdicts("binary", (0.7,))]
    assert len(library.everything()) == 12
    assert str(library.everything()[-1]) == "binary:1"
    changed = TINY.with_(7, 3)
    for kind in ("search", "told", "special", "paper"):
        assert getattr(changed, kind) == replace(getattr(TINY, kind), updates=7, seed=3)
    assert TINY.with_(None, 3).told.updates == TINY.told.updates
    assert changed.teacher == TINY.teacher
