"""Training many policies: on this machine or on a cluster, each once, and each to the same bit."""

import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from joblib.externals.loky import get_reusable_executor

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from policy import library, teachers, workers
from policy.actor_critic import ActorCriticSettings
from policy.cards import read_card
from policy.checkpoint import load, pack, unpack, write
from policy.distillation import DistillationSettings
from policy.evaluation import NetworkPlayer, evaluate
from policy.library import TOLD, WITHOUT, Backend, Settings, train
from policy.network import Network, PaperNetwork, ToldNetwork
from policy.planner import PlannerSettings
from policy.processor import arithmetic, device
from policy.recitation import RecitationSettings
from policy.training import MISSING, PolicyJob, TeacherJob
from policy.verdicts import Verdicts

TINY = Settings(
    teacher=PlannerSettings(n_episodes=16, n_steps=4, n_minibatches=2, updates=2, critic_updates=1),
    search=RecitationSettings(updates=40, learning_rate=1e-2, what_if=1.0),
    told=DistillationSettings(n_episodes=32, n_steps=5, updates=25, learning_rate=1e-2),
    special=DistillationSettings(n_episodes=16, n_steps=4, updates=2, guided=0.0),
    paper=ActorCriticSettings(n_episodes=32, n_steps=8, n_minibatches=2, updates=20, learning_rate=5e-3),
)
BINARY, SCORE = Verdicts("binary", (0.8,)), Verdicts("score", (0.7,))
LOCAL, HERE = Backend("local", n_workers=2), Backend("local", n_workers=1)
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
    get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


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
    story = cards["square_080"].story
    assert story["start"] == "square_told"
    assert (story["missing"], story["evaluated_with"]) == (MISSING, "binary:0.8, 0.03 of them missing")
    assert (story["device"], story["arithmetic"]) == (device().type, arithmetic())
    assert isinstance(load(folder / "square_told.safetensors")[0], ToldNetwork)
    assert isinstance(load(folder / "square_080.safetensors")[0], Network)
    for what, done, of in told:
        assert "ready" in what
        assert 0 <= done <= of
    last = {what.split(",")[0]: (done, of) for what, done, of in told}
    assert all(done == of for done, of in last.values()), "the bar fills"
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
    with pytest.raises(SetupError, match=r"square.*It is not overwritten: move it"):
        run(str(tmp_path / "square.txt"), copy)
    assert state(copy) == before


def changed_card(path, **changes):
    """Write a policy again with something else on its card; what is None isn't in its story."""
    network, card = load(path)
    story = {key: value for key, value in (card.story | changes.pop("story", {})).items() if value is not None}
    write(path, pack(network, replace(card, story=story, **changes)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"layout": "evidence-1"}, r"trained on 'evidence-1'.*not overwritten: move it"),
        ({"story": {"settings": None}}, "trained with other settings"),
        ({"story": {"missing": 0.2}}, "trained with other missing"),
        ({"verdicts": "score:0.8"}, "trained with other verdicts"),
    ],
)
def test_a_file_that_is_not_what_is_wanted_is_not_taken_for_finished(copy, square, changes, says):
    changed_card(copy / "square_080.safetensors", **changes)
    before = state(copy)
    with pytest.raises(SetupError, match=says):
        run(square, copy, HERE)
    assert state(copy) == before


def test_a_damaged_file_is_not_taken_for_finished_and_one_that_tells_no_share_is(copy, square):
    path = copy / "square_080.safetensors"
    changed_card(path, story={"missing": None})
    run(square, copy, HERE)
    contents = path.read_bytes()
    path.write_bytes(contents[:-1] + bytes([contents[-1] ^ 1]))
    with pytest.raises(SetupError, match=r"can't be read as one.*not overwritten: move it"):
        run(square, copy, HERE)


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


def test_the_papers_recipe_needs_no_teacher_and_repeats_itself(square):
    job = PolicyJob(load_map(square), BINARY, TINY.paper)
    assert (job.name, job.recipe) == ("square_080_paper", "paper")
    told = []
    contents = job.run(lambda done, of, word: told.append((done, of)))
    assert told == [(number, 20) for number in range(1, 21)]
    network, card = unpack(contents, "x")
    assert isinstance(network, PaperNetwork)
    assert card.layout == "paper-1"
    assert (card.story["missing"], card.story["arithmetic"]) == (0.0, "float32")
    again, _ = unpack(replace(job).run(), "x")
    for one, other in zip(network.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_a_teacher_is_the_same_wherever_it_is_made(shelf, square):
    world = load_map(square)
    made = teachers.read(teachers.make(world, TINY.teacher), world, "made")
    found = teachers.load(shelf[0], world)
    assert (made.paths == found.paths).all()
    for one, other in zip(made.planner.state_dict().values(), found.planner.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_jobs_carry_their_map(square, tmp_path):
    """Another machine lacks its file, or has another of that name."""
    path = tmp_path / "hall.txt"
    path.write_text("..\n..\n", encoding="ascii")
    world = load_map(str(path))
    jobs = pickle.dumps((TeacherJob(world, TINY.teacher), PolicyJob(world, BINARY, TINY.paper)))
    path.write_text("..#\n...\n", encoding="ascii")
    load_map.cache_clear()
    teacher, policy = pickle.loads(jobs)  # noqa: S301 -- just made, as joblib and Dask do
    assert teachers.read(teacher.run(), world, "hall").paths.shape[0] == 4
    assert (policy.name, unpack(policy.run(), "hall")[1].map_digest) == ("hall_080_paper", world.digest)


def test_a_map_that_is_given_twice_is_trained_once(copy, square, tmp_path):
    (tmp_path / "other.txt").write_text("..\n..", encoding="ascii")
    before = state(copy)
    paths = train(
        [square, square, str(tmp_path / "other.txt")], (BINARY, BINARY), "ours", copy, TINY, HERE, lambda *news: None
    )
    assert [path.stem for path in paths] == ["square_080"]
    assert state(copy) == before


@pytest.mark.parametrize("name", ["square", "Square"])
def test_two_policies_of_one_file_are_refused_before_any_work(square, tmp_path, name):
    (tmp_path / f"{name}.txt").write_text("...\n...\n", encoding="ascii")
    with pytest.raises(SetupError, match=r"Two of the policies would be the file .*quare_"):
        train([square, str(tmp_path / f"{name}.txt")], (BINARY,), "ours", tmp_path / "out", TINY, HERE, None)
    assert not (tmp_path / "out").exists()


def test_verdicts_whose_names_agree_are_refused(square, tmp_path):
    alike = (Verdicts("binary", (0.7,)), Verdicts("binary", (0.7000001,)))
    with pytest.raises(SetupError, match=r"square_070\.safetensors.*differ by less than a name tells"):
        run(square, tmp_path / "out", HERE, wanted=alike)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("unheard", [TOLD, SCORE])
def test_the_papers_recipe_refuses_what_its_network_cant_hear(square, tmp_path, unheard):
    with pytest.raises(SetupError, match=rf"binary:P or rates:HIT:CR, found {unheard}\. Choose"):
        train([square], (BINARY, unheard), "paper", tmp_path / "out", TINY, HERE, None)
    assert not (tmp_path / "out").exists()


def test_the_papers_recipe_misses_no_verdicts_and_goes_on_where_it_was(square, tmp_path):
    def trained():
        return train([square], (BINARY,), "paper", tmp_path, TINY, HERE, lambda *news: None)

    (path,) = trained()
    assert path.stem == "square_080_paper"
    assert read_card(path).story["evaluated_with"] == "binary:0.8, 0 of them missing"
    before = state(tmp_path)
    assert trained() == [path]
    assert state(tmp_path) == before


def test_a_folder_that_cant_be_written_is_refused_before_any_work(square, tmp_path):
    (tmp_path / "taken").write_text("a file", encoding="ascii")
    for folder in (tmp_path / "taken", tmp_path / "taken" / "out"):
        told = []
        with pytest.raises(SetupError, match=r"Can't write into .*taken.*--out"):
            run(square, folder, HERE, lambda *news, told=told: told.append(news))
        assert told == []


def test_a_result_that_cant_be_written_is_kept_elsewhere(copy, square, tmp_path, monkeypatch):
    lost = copy / "square_080.safetensors"
    whole = lost.read_bytes()
    lost.unlink()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def full(path, contents, partial):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(library, "write_new", full)
    with pytest.raises(
        SetupError, match=r"square_080\.safetensors can't be written .*No space left.* kept as"
    ) as error:
        run(square, copy, HERE)
    (kept,) = tmp_path.glob("square_080_*.safetensors")
    assert str(kept) in str(error.value)
    write(lost, whole)
    assert_same_weights(kept, lost)


@pytest.mark.parametrize(("error", "says"), [(SetupError("no such goal."), "no such goal"), (KeyError("goal"), "goal")])
def test_one_job_that_fails_does_not_lose_the_others(copy, shelf, square, monkeypatch, error, says):
    both = [copy / f"square_{name}.safetensors" for name in ("080", "score070")]
    for path in both:
        path.unlink()
    trained = PolicyJob.run

    def run_or_fail(job, progress):
        if job.verdicts.kind == "binary":
            raise error
        return trained(job, progress)

    monkeypatch.setattr(PolicyJob, "run", run_or_fail)
    with pytest.raises(type(error), match=says) as raised:
        run(square, copy, HERE)
    text = f"1 of 2 policies failed; what else was trained is in {copy}. square_080: {error}".rstrip(".") + "."
    if isinstance(error, SetupError):
        assert str(raised.value) == text
    else:
        in_worker, summary = raised.value.__notes__
        assert "run_or_fail" in in_worker
        assert summary == text
    assert not both[0].exists()
    assert_same_weights(both[1], shelf[0] / both[1].name)


def test_a_training_that_diverged_is_not_kept(square):
    world = load_map(square)
    wild = PolicyJob(world, BINARY, replace(TINY.paper, updates=1, learning_rate=1e30))
    with pytest.raises(SetupError, match="The training of square_080_paper diverged"):
        wild.run()
    with pytest.raises(SetupError, match="The training of square teacher diverged"):
        TeacherJob(world, replace(TINY.teacher, updates=1, critic_updates=0, learning_rate=float("inf"))).run()


class Short:
    """A job that does next to nothing."""

    cost = 1000.0

    def run(self, progress):
        progress(1, 2, "half way")
        return b"done"


def test_progress_never_stops_a_training_and_makes_no_folder(tmp_path):
    assert workers._attempt_here(3, Short(), tmp_path / "gone", os.getpid()) == (3, b"done")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "1").mkdir()  # a note that can neither be read nor replaced
    workers._attempt_here(1, Short(), tmp_path, os.getpid())
    workers._attempt_here(0, Short(), tmp_path, os.getpid())
    watch = workers.watch([Short(), Short()], tmp_path, lambda *news: None, "policies")
    assert (watch._noted(0), watch._noted(1)) == (0.5, 0.0)


def test_a_late_note_takes_no_finished_job_back_and_the_end_is_told(tmp_path):
    told = []
    with workers.watch([Short()], tmp_path, lambda *news: told.append(news), "policies") as watch:
        watch.finished(0)
        watch._goes_on(0, 0.5)
    assert [news[1:] for news in (told[0], told[-1])] == [(0, 1), (1, 1)]
    assert told[-1][0].startswith("policies, 1 of 1 ready")


def test_with_gpus_there_is_a_worker_for_each(monkeypatch):
    monkeypatch.setattr(workers, "device", lambda: torch.device("cuda"))
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 3)
    assert (Backend().n_processes, LOCAL.n_processes) == (3, 2)
    monkeypatch.setattr(workers, "device", lambda: torch.device("cpu"))
    assert Backend().n_processes == -1


@pytest.mark.skipif(sys.platform == "win32", reason="a signal to a group of processes")
def test_an_interrupted_sweep_goes_on_with_what_is_missing(shelf, square, tmp_path):
    here = str(Path(__file__).parent)
    words = f"import sys; sys.path.insert(0, {here!r}); from pathlib import Path; import test_policy_library as test; "
    words += f"test.run({square!r}, Path({str(tmp_path)!r}))"
    sweep = subprocess.Popen([sys.executable, "-c", words], start_new_session=True, stderr=subprocess.DEVNULL)
    first = tmp_path / "square_teacher.safetensors"
    deadline = time.monotonic() + 60
    while not first.exists():
        assert sweep.poll() is None, "the sweep ended before it wrote anything"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(sweep.pid, signal.SIGINT)  # as Ctrl-C does: to the workers, too
    assert sweep.wait(timeout=30) != 0
    before = state(tmp_path)
    assert first.name in before
    assert len(before) < len(NAMES)
    run(square, tmp_path)
    after = state(tmp_path)
    assert after.keys() == {f"{name}.safetensors" for name in NAMES}, "and nothing half-written"
    assert {name: after[name] for name in before} == before
    assert_same_weights(tmp_path / "square_080.safetensors", shelf[0] / "square_080.safetensors")


def test_words_become_verdicts_each_once_and_settings_take_updates_and_a_seed():
    assert library.parsed(["told", "binary:0.70", "binary:0.7"]) == [Verdicts("told"), Verdicts("binary", (0.7,))]
    assert len(library.everything()) == 12
    assert str(library.everything()[-1]) == "binary:1"
    changed = TINY.with_(7, 3)
    for kind in ("search", "told", "special", "paper"):
        assert getattr(changed, kind) == replace(getattr(TINY, kind), updates=7, seed=3)
    assert TINY.with_(None, 3).told.updates == TINY.told.updates
    assert changed.teacher == TINY.teacher
    assert [each.kind for each in library.everything("paper")] == ["none"] + ["binary"] * 10


@pytest.mark.parametrize(
    ("wanted", "shortened"),
    [((BINARY,), {"special"}), ((TOLD,), {"told"}), ((WITHOUT, SCORE), {"search", "special"})],
)
def test_updates_are_of_the_kinds_that_are_asked_for(wanted, shortened):
    changed = TINY.with_(7, 3, wanted)
    for kind in ("search", "told", "special"):
        updates = 7 if kind in shortened else getattr(TINY, kind).updates
        assert getattr(changed, kind) == replace(getattr(TINY, kind), updates=updates, seed=3)
    assert changed.paper.updates == 7
