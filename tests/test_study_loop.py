"""The loop in one process, a study through it, and that loop against the one over LSL."""

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from conftest import Cli
from dask.distributed import LocalCluster
from sklearn.linear_model import LogisticRegression

from bci_app import fitting, watching
from bci_app.config import Config, SimulationConfig, changed
from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.metrics import truths
from bci_app.protocol import Action, Electrodes, EpisodeEnd, EpisodeGoal, SessionEnd, SessionStart, Truth, Verdict
from bci_app.recording import Recording, read
from bci_app.rehearsing import likeness_of
from bci_app.runs import read_sidecar
from bci_app.study import alone, plan, running
from bci_app.study.conditions import coin
from bci_app.study.conduct import names_of
from bci_app.study.jobs import Made
from bci_app.study.parts import Kept
from decoder import rehearsal_file
from decoder.attention import Attention
from decoder.model import DecoderModel, load, save
from policy import cards

OPEN = load_map("open")
SMALL = {
    "stimulus": {"headless": True},
    "calibration": {"n_blocks": 1, "moves_per_block": 60},
    "online": {"distances": [2, 4]},
    "classifier": {"n_folds": 2, "min_per_class": 5},
    "simulation": {
        "sfreq": 256.0,
        "decodability": 0.9,
        "errp_at_edge": 0.8,
        "errp_habituation": 0.1,
        "errp_online": 0.9,
    },
}
CONFIG = changed(Config(), SMALL)


@pytest.fixture(scope="module")
def calibration() -> Recording:
    return alone.calibrate(CONFIG, "P1", seed=3)


@pytest.fixture(scope="module")
def decoder(calibration: Recording) -> DecoderModel:
    return fitting.decoder_of(calibration, "P1", CONFIG)[2]


def test_a_calibration_is_whole(calibration: Recording, decoder: DecoderModel) -> None:
    assert [end.reason for _, end in calibration.of(SessionEnd)] == ["complete"]
    assert {verdict.outcome for _, verdict in calibration.of(Verdict)} == {"unjudged"}
    assert len(calibration.of(Truth)) == 60
    onsets = [stamp for stamp, _ in calibration.of(Truth)]
    assert min(np.diff(onsets)) == pytest.approx(3.0)
    assert decoder.info.n_rejected == 0


def test_an_online_run_is_the_same_each_time_and_ends_at_the_goals(decoder: DecoderModel) -> None:
    card = cards.choose_told(OPEN)
    assert card.path is not None
    told = str(decoder.info.evidence.told)
    runs = [alone.online(CONFIG, "P1", 5, OPEN, decoder, card.path, told) for _ in range(2)]
    assert plain(runs[0]) == plain(runs[1])
    assert sorted(goal.distance for _, goal in runs[0].of(EpisodeGoal)) == [2, 3, 4]
    assert len(runs[0].of(Verdict)) == len(runs[0].of(Truth))
    # One action a move: the last of an episode is answered by none, its first is before any verdict.
    assert len(runs[0].of(Action)) == len(runs[0].of(Truth))
    assert {end.reason for _, end in runs[0].of(EpisodeEnd)} <= {"goal", "limit"}


def test_who_hears_no_verdicts_moves_the_same_without_eeg(decoder: DecoderModel) -> None:
    card = cards.choose_without(OPEN)
    assert card.path is not None
    silent = alone.online(CONFIG, "P1", 5, OPEN, None, card.path, None)
    judged = alone.online(CONFIG, "P1", 5, OPEN, decoder, card.path, None)
    assert [a.action for _, a in silent.of(Action)] == [a.action for _, a in judged.of(Action)]
    assert not silent.of(Verdict)


def test_a_decoder_is_judged_on_another_hour(decoder: DecoderModel) -> None:
    another = alone.calibrate(CONFIG, "P1", 9, model=decoder)
    known = truths(another)
    right = [(verdict.log_odds or 0) > 0 for verdict in another.verdicts.values()]
    assert len(right) == 60
    assert np.mean(np.array(right) == list(known.values())) > 0.6


def test_attention_fades_at_the_edge_after_errors_and_online() -> None:
    config = SimulationConfig(errp_at_edge=0.5, errp_habituation=0.2, errp_online=0.9)
    layout = tuple("." * 11 for _ in range(11))
    opening = SessionStart(session="s", task="online", participant="P1", map="open", layout=layout, n_episodes=1)
    attention = Attention(config)
    attention.open(opening.task, opening.layout)
    truth = Truth(session="s", episode=0, step=1, error=True, distance=3)
    sizes = [attention.size(truth, (5, 5)) for _ in range(6)]
    assert sizes == pytest.approx([0.9, 0.72, 0.54, 0.36, 0.36, 0.36])
    assert attention.size(truth.model_copy(update={"error": False}), (5, 5)) == pytest.approx(0.9)
    assert attention.size(truth, (0, 5)) == pytest.approx(0.45)
    assert Attention(SimulationConfig()).is_even
    assert not attention.is_even


def small_study(folder: Path, **changes: Any) -> plan.Study:
    values: dict[str, Any] = {
        "name": "small",
        "folder": str(folder),
        "through": "one-process",
        "conditions": list(plan.CONDITIONS),
        "maps": ["open"],
        "config": SMALL,
        "participants": [{"name": "P1", "seed": 2, "published": "S2"}],
    }
    return plan.parse(values | changes, "small")


def test_a_study_in_one_process_is_kept_and_shown_and_goes_on(tmp_path: Path) -> None:
    study = small_study(tmp_path, conditions=["none", "ours"])
    told = running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    assert set(told["conditions"]) == {"none", "ours"}
    row = told["conditions"]["ours"]["open"]
    assert {"participants", "success", "mean_steps", "steps_vs_none"} <= set(row)
    assert row["participants"] == 1
    assert told["participants"]["P1"]["ours"]["open"]["success"] == row["success"]
    assert told["unfinished"] == []
    page = Path(told["report"])
    assert "Beside the paper" in page.read_text(encoding="utf-8")
    assert (page.parent / "tables" / "table_2_ours.csv").exists()
    # With more conditions it goes on: what is done isn't made again, and the control gets its decoder.
    before = Kept.of(study, study.participants[0], "one-process").parts
    more = small_study(tmp_path)
    running.run(more, "one-process", None, "local", None, lambda what, done, of: None)
    kept = Kept.of(more, more.participants[0], "one-process")
    assert set(kept.parts) == set(names_of(more, more.participants[0]))
    assert {name: kept.parts[name] for name in before} == before
    assert kept.stopped == {}
    # The paper's condition decodes as the paper did.
    decoders = tmp_path / "one-process" / "decoders"
    ours, papers = (load(decoders / f"P1{name}_decoder.safetensors") for name in ("", "_paper"))
    assert not np.array_equal(ours.classifier.weights, papers.classifier.weights)
    assert kept.parts["calibration"]["tenfold"] == ours.info.tenfold
    assert kept.parts["calibration"]["paper"]["tenfold"] == papers.info.tenfold


def test_somebody_rehearsed_takes_part(calibration: Recording, tmp_path: Path) -> None:
    """Learnt from a calibration of 60 moves; the same person gives another calibration and goes online."""
    likeness, _ = likeness_of(calibration, CONFIG, lambda what, done, of: None)
    rehearsal_file.save(likeness, tmp_path / "P1_person.safetensors", "P1", "0" * 64)
    people = [{"name": "R1", "kind": "rehearsed", "recording": str(tmp_path / "P1_person.safetensors"), "seed": 2}]
    study = small_study(tmp_path / "study", conditions=["none", "ours"], participants=people)
    told = running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    assert told["unfinished"] == []
    assert told["participants"]["R1"]["ours"]["open"]["participants"] == 1
    parts = Kept.of(study, study.participants[0], "one-process").parts
    assert parts["calibration"]["n_moves"] == 60
    assert parts["calibration"]["contiguous"]["auc"]["value"] > 0.6


def test_a_study_on_a_cluster_is_kept_here(tmp_path: Path) -> None:
    study = small_study(tmp_path, conditions=["none"])
    cluster = {"processes": False, "threads_per_worker": 1, "host": "127.0.0.1", "protocol": "tcp://"}
    with LocalCluster(n_workers=1, dashboard_address=None, **cluster) as made:
        told = running.run(study, "one-process", None, "dask", made.scheduler_address, lambda what, done, of: None)
    assert told["unfinished"] == []
    assert set(Kept.of(study, study.participants[0], "one-process").parts) == {"calibration", "none open"}


def test_what_is_kept_of_another_study_is_refused(tmp_path: Path) -> None:
    study = small_study(tmp_path)
    Kept.of(study, study.participants[0], "one-process").save()
    other = small_study(tmp_path, seed=7)
    with pytest.raises(SetupError, match="was begun with other settings than the study file has now"):
        running.run(other, "one-process", None, "local", None, lambda what, done, of: None)
    path = tmp_path / "one-process" / "P1.json"
    path.write_text("{", encoding="utf-8")
    with pytest.raises(SetupError, match="can't be read"):
        Kept.of(study, study.participants[0], "one-process")


def test_whoever_was_begun_with_other_settings_keeps_nobody_else_from_coming(tmp_path: Path) -> None:
    both = [{"name": "P1", "decodability": 0.8, "seed": 3}, {"name": "P2", "decodability": 0.8, "seed": 4}]
    before = small_study(tmp_path, participants=both)
    Kept.of(before, before.participants[0], "one-process").save()
    study = small_study(tmp_path, participants=both, seed=7, conditions=["none"])
    told = running.run(study, "one-process", "P2", "local", None, lambda what, done, of: None)
    assert set(told["participants"]) == {"P2"}
    (lacking,) = told["unfinished"]
    assert (lacking["participant"], "begun with other settings" in lacking["why"]) == ("P1", True)


def test_a_part_that_fails_is_told_and_costs_nobody_else(tmp_path: Path) -> None:
    few = {**SMALL, "classifier": {"n_folds": 2, "min_per_class": 50}}
    study = small_study(tmp_path, config=few, conditions=["none"])
    seen: list[tuple[str, int, int]] = []
    told = running.run(study, "one-process", None, "local", None, lambda *news: seen.append(news))
    assert seen[-1] == ("calibrations and runs, 0 of 1 participants through", 0, 2)
    assert told["report"] is None
    assert "stopped in calibration: A decoder needs at least 50" in told["unfinished"][0]["why"]


def test_an_error_nobody_foresaw_is_raised_once_all_others_are_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def breaks_once() -> LogisticRegression:
        calls.append(1)
        if len(calls) == 1:
            raise RuntimeError("out of luck")
        return LogisticRegression(class_weight="balanced")

    laboratory = ModuleType("laboratory")
    laboratory.breaks_once = breaks_once  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "laboratory", laboratory)
    settings = {**SMALL, "classifier": {"n_folds": 2, "min_per_class": 5, "estimator": "laboratory:breaks_once"}}
    people = [{"name": name, "seed": 2} for name in ("P1", "P2")]
    study = small_study(tmp_path, config=settings, conditions=["none"], participants=people, side_by_side=1)
    with pytest.raises(RuntimeError, match=r"Of 2 participants 1 ended .*report: .*\nParticipant P1: Traceback"):
        running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    first, second = (Kept.of(study, who, "one-process") for who in study.participants)
    assert first.stopped["why"] == "an error of the program, RuntimeError: out of luck"
    assert set(second.parts) == {"calibration", "none open"}
    again = running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    assert again["unfinished"] == []


def test_whose_parts_cant_be_kept_costs_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "POLL_S", 0.01)
    people = [{"name": name, "seed": 2} for name in ("P1", "P2")]
    study = small_study(tmp_path, conditions=["none"], participants=people, side_by_side=1)
    (tmp_path / "one-process" / ".P1.json.partial").mkdir(parents=True)
    seen: list[tuple[int, int]] = []
    with pytest.raises(SetupError, match=r"Of 2 participants 1 couldn't go on; .*report: .*Participant P1: Can't keep"):
        running.run(study, "one-process", None, "local", None, lambda what, done, of: seen.append((done, of)))
    assert set(Kept.of(study, study.participants[1], "one-process").parts) == {"calibration", "none open"}
    assert seen == sorted(seen)
    assert list(dict.fromkeys(seen)) == [(0, 4), (1, 4), (2, 4)]  # while it was done


def test_what_a_cluster_made_and_cant_be_kept_here_costs_nobody_else(tmp_path: Path) -> None:
    people = [{"name": name, "seed": 2} for name in ("P1", "P2")]
    study = small_study(tmp_path, conditions=["none"], participants=people)
    (tmp_path / "one-process" / ".P1.json.partial").mkdir(parents=True)
    troubles = running._Troubles(study, "one-process", 2)
    made = Made({"parts": {"calibration": {"n_moves": 60}}, "stopped": {}})
    assert [troubles.take(name, made) for name in ("P1", "P2")] == [False, True]
    assert not troubles.take("P2", Made(refusal="The cluster gave it up.", crash="Traceback"))
    with pytest.raises(
        RuntimeError, match=r"2 participants 1 .*\(there\)\.\nParticipant P1: Can't keep(.|\n)*P2: The clu"
    ):
        troubles.end("there")


def test_after_a_calibration_that_cant_be_fitted_there_can_be_another(tmp_path: Path) -> None:
    few = {**SMALL, "classifier": {"n_folds": 2, "min_per_class": 50}}
    study = small_study(tmp_path, config=few, conditions=["none"])
    running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    kept = Kept.of(study, study.participants[0], "one-process")
    assert kept.stopped["part"] == "calibration"
    assert kept.recorded == {}


def test_a_map_without_a_policy_is_refused_before_anybody_comes(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("....\n.##.\n....\n", encoding="utf-8")
    study = small_study(tmp_path / "study", maps=["open", str(tmp_path / "mine.txt")])
    with pytest.raises(SetupError, match="No policy of the kind 'none' for map 'mine'"):
        running.run(study, "one-process", None, "local", None, lambda what, done, of: None)
    assert not (tmp_path / "study").exists()


def test_the_coins_tosses_are_as_large_on_new_moves_as_what_the_decoder_says(
    calibration: Recording, decoder: DecoderModel
) -> None:
    epochs, result, fitted = fitting.decoder_of(calibration, "P1", CONFIG)
    tosses = coin(fitted, result, epochs.features, epochs.error, CONFIG.classifier, 1)
    another = alone.calibrate(CONFIG, "P1", 9, model=tosses)
    ours = alone.calibrate(CONFIG, "P1", 9, model=decoder)
    large, wanted = (np.std([verdict.log_odds for verdict in each.verdicts.values()]) for each in (another, ours))
    assert 0.6 < large / wanted < 1.7


def test_the_loop_over_lsl_and_that_in_one_process_do_the_same(decoder: DecoderModel, tmp_path: Path, cli: Cli) -> None:
    """With a live session's flips and looks, all else is made anew: EEG, truths, verdicts, actions, to the bit."""
    config = tmp_path / "config.json"
    ours = {"recordings": str(tmp_path / "recordings"), "online": {"distances": [2, 3]}}
    mine = changed(CONFIG, {**ours, "simulation": {"delay_s": 0.1}})  # so that no truth is late on a busy machine
    config.write_text(mine.model_dump_json(), encoding="utf-8")
    model = tmp_path / "P1_decoder.safetensors"
    save(decoder, model)
    words = ("--model", model, "--policy", "told", "--config", config, "--seed", 11, "--speed", 20, "--json")
    done = cli("online", "--participant", "P1", "--map", "open", "--simulate", *words)
    assert done.returncode == 0, done.stderr
    path = Path(json.loads(done.stdout)["recording"])
    recording, sidecar = read(path), read_sidecar(path)
    policy = Path(sidecar["policy"]["path"])
    again = alone.again(recording, sidecar, decoder, policy)
    assert len(recording.of(Action)) > 0
    assert plain(again) == plain(recording)


def plain(recording: Recording) -> list[dict[str, Any]]:
    """What two runs have in common if they are the same: not when things were said, nor in which session."""
    exclude = {"latency_ms", "protocol", "session"}
    return [
        message.model_dump(exclude=exclude)
        for kind in (Electrodes, Verdict, Action, Truth)
        for _, message in recording.of(kind)
    ]
