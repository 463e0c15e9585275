"""What the report computes beyond what was told before: waveforms, areas, errors in a row, curves."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_by_hand import Wish, recording
from scipy.interpolate import CubicSpline

from bci_app.config import Config
from bci_app.gridworld import load_map
from bci_app.moves import electrodes, judges
from bci_app.recording import Recording
from bci_app.report import areas, calibrations, clusters, erp, in_a_row, online, steps, those
from bci_app.report.waveforms import Waveforms, nearest, together, waveforms
from decoder.calibration import auc, score
from decoder.judge import judge_without


@pytest.fixture(scope="module")
def run() -> Recording:
    return recording(Wish("online", "open", 6, 12, 0.4, 5))


@pytest.fixture(scope="module")
def waves(run: Recording) -> Waveforms:
    judge_of = judges(judge_without(Config(), run.eeg, ""), electrodes(run))
    return waveforms(run, Config().chain, judge_of, steps.move_rows(run))


def test_the_areas_of_the_paper_s_grid() -> None:
    cells = [steps.area_of((row, column), 11, 11) for row in range(11) for column in range(11)]
    assert (cells.count("central"), cells.count("edge")) == (49, 72)
    assert steps.area_of((2, 8), 11, 11) == "central"
    assert steps.area_of((5, 9), 11, 11) == "edge"


def test_errors_in_a_row_begin_anew_with_each_episode(run: Recording) -> None:
    rows, before = steps.move_rows(run), None
    for row in rows:
        goes_on = before is not None and before["episode"] == row["episode"] and before["error"]
        expected = (before["errors_in_a_row"] + 1 if goes_on else 1) if row["error"] else 0
        assert row["errors_in_a_row"] == expected
        before = row
    assert max(row["errors_in_a_row"] for row in rows) > 2


def test_a_way_is_made_of_single_steps_from_the_start(run: Recording) -> None:
    moves, world = steps.move_rows(run), load_map("open")
    for episode in steps.episode_rows(run):
        cells = np.array(steps.way(those(moves, episode=episode["episode"])))
        assert (cells[0] == (episode["start_row"], episode["start_column"])).all()
        assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()
        assert len(cells) == episode["steps"] + 1
        start, goal = (world.cell_at(episode[f"{x}_row"], episode[f"{x}_column"]) for x in ("start", "goal"))
        assert episode["distance"] == world.distance[start, goal]


def test_waveforms_are_those_of_mne(run: Recording, waves: Waveforms) -> None:
    """MNE's own way: resample, filter without delay, average reference, epochs, baseline."""
    import mne

    info = mne.create_info(list(run.eeg.channels), run.eeg.sfreq, "eeg")
    samples = run.samples.astype(np.float64)
    samples -= samples.mean(axis=0)  # an offset would ripple through the resampler, on another grid than ours
    raw = mne.io.RawArray(samples.T * 1e-6, info, verbose="error")
    raw.resample(256, method="polyphase", verbose="error").filter(1, 50, fir_design="firwin", verbose="error")
    raw.set_eeg_reference("average", verbose="error")
    keep = [move for move in waves.moves if move["episode"] != 3]  # there an electrode was bad, and is repaired
    onsets = np.array([[round(move["onset_s"] * 256), 0, 1 + move["error"]] for move in keep])
    epochs = mne.Epochs(raw, onsets, tmin=-0.3, tmax=0.8, baseline=(-0.3, 0), preload=True, verbose="error")
    theirs = epochs.get_data(["Fz"])[:, 0] * 1e6
    ours = waves.trials[[move["episode"] != 3 for move in waves.moves], waves.picks.index("Fz")]
    # Their grid is that of the whole recording: an onset lies up to 2 ms from it.
    late = [1e3 * (move["onset_s"] - onset / 256) for move, onset in zip(keep, onsets[:, 0], strict=True)]
    at = np.array([CubicSpline(epochs.times * 1e3, w)(waves.times_ms + o) for w, o in zip(theirs, late, strict=True)])
    inside = waves.times_ms < 790
    assert np.abs(at - ours)[:, inside].max() < 0.5
    assert np.corrcoef(at[:, inside].ravel(), ours[:, inside].ravel())[0, 1] > 0.9995


def test_a_mean_of_all_channels_is_that_of_the_single_trials(waves: Waveforms) -> None:
    for pick, name in enumerate(waves.picks):
        trials = waves.trials[:, pick]
        difference = trials[waves.error].mean(axis=0) - trials[~waves.error].mean(axis=0)
        assert waves.difference is not None
        assert waves.difference[waves.channels.index(name)] == pytest.approx(difference, abs=1e-9)
    twice = together([waves, waves])
    assert len(twice.moves) == 2 * len(waves.moves)
    assert twice.difference == pytest.approx(waves.difference)


def test_peaks_are_where_the_person_has_them(waves: Waveforms) -> None:
    rows = erp.mean_rows(waves, np.ones(len(waves.moves), bool), participant="P")
    peaks = {row["peak"]: row for row in erp.peak_rows(rows) if row["channel"] == "FCz"}
    assert peaks["negative 200"]["mean_uv"] < 0 < peaks["positive 300"]["mean_uv"]
    assert peaks["negative 400"]["mean_uv"] < 0
    for name, row in peaks.items():
        assert abs(row["time_ms"] - int(name.split()[1])) < 60


@pytest.mark.parametrize(
    ("names", "found"),
    [(["Cz", "fz."], "fz."), (["Cz", "FCZ"], "FCZ"), (["Oz", "Pz"], "Oz"), (["EEG Fz-REF"], "EEG Fz-REF")],
)
def test_another_channel_stands_in_for_fz(names: list[str], found: str) -> None:
    assert nearest("Fz", names) == found


def made_up(levels: list[int], size: float, seed: int) -> Waveforms:
    """Error moves whose positive peak loses `size` uV with each error in a row, in noise."""
    times, rng = np.arange(-300, 800, 4.0), np.random.default_rng(seed)
    shape = np.exp(-(((times - 300) / 30) ** 2))
    trials = np.array([(10 - size * level) * shape + rng.normal(0, 3, len(times)) for level in levels])
    moves = tuple({"errors_in_a_row": level, "error": True, "area": "edge"} for level in levels)
    return Waveforms(
        times, ("Fz",), moves, np.ones(len(levels), bool), trials[:, None], ("Fz",), np.zeros((2, 1, len(times))), 0
    )


def test_an_error_potential_that_shrinks_is_seen_to_shrink() -> None:
    rows = in_a_row.level_rows(made_up([1] * 80 + [2] * 40 + [3] * 20 + [4] * 10, 1.5, 0), source="online")
    assert [row["n"] for row in rows] == [80, 40, 20, 10]
    means = [row["mean"] for row in rows]
    assert means == sorted(means, reverse=True)
    (trend,) = in_a_row.trend_row(made_up([1] * 80 + [2] * 40 + [3] * 20 + [4] * 10, 1.5, 0))
    assert trend["high"] < 0
    assert trend["p"] < 0.01


def test_few_trials_don_t_make_an_error_potential_larger() -> None:
    """The paper's measure does grow with fewer trials, the one beside it doesn't."""
    growth: dict[str, list[float]] = {"mean": [], "peak_to_peak": []}
    for seed in range(40):
        many, few = in_a_row.level_rows(made_up([1] * 100 + [2] * 3, 0.0, seed))
        for name, values in growth.items():
            values.append(few[name] - many[name])
    assert np.mean(growth["peak_to_peak"]) > 2
    assert abs(np.mean(growth["mean"])) < 0.5


def verdicts() -> Iterator[st.SearchStrategy[list[tuple[int, bool]]]]:
    yield st.lists(st.tuples(st.integers(-5, 5), st.booleans()), min_size=6, max_size=40)


@settings(max_examples=60, deadline=None)
@given(next(verdicts()))
def test_the_curve_encloses_the_area_that_is_told(said: list[tuple[int, bool]]) -> None:
    log_odds, error = np.array([float(a) for a, _ in said]), np.array([b for _, b in said])
    rows = calibrations.roc_rows(log_odds, error, "here")
    if min(error.sum(), (~error).sum()) < 2:
        return
    x, y = ([row[name] for row in rows] for name in ("false_alarm_rate", "hit_rate"))
    assert np.trapezoid(y, x) == pytest.approx(auc(log_odds, error).value)
    assert (x[0], y[0], x[-1], y[-1]) == (0, 0, 1, 1)
    told = score(log_odds, error).as_dict()
    counts = calibrations.counts_of(told, "here")
    assert counts["hits"] == int((error & (log_odds > 0)).sum())
    assert counts["correct_rejections"] == int((~error & (log_odds <= 0)).sum())


def test_areas_that_differ_are_found_to_differ() -> None:
    def moves(area: str, n_right: int, n: int) -> list[dict[str, object]]:
        return [{"area": area, "error": k % 3 == 0, "verdict": _said(k % 3 == 0, k < n_right)} for k in range(n)]

    rows = moves("central", 180, 200) + moves("edge", 120, 200)
    (found,) = areas.difference_row(rows, map="open")
    assert found["difference"] == pytest.approx(0.3)
    assert found["low"] > 0.2
    assert found["p"] < 1e-6
    central, edge = areas.accuracy_rows(rows)
    assert (central["accuracy"], edge["accuracy"]) == (0.9, 0.6)
    assert not areas.difference_row(moves("edge", 5, 10))


def _said(error: bool, right: bool) -> str:
    return "error" if error == right else "correct"


def test_two_visits_of_six_people_are_six_people() -> None:
    """The least p of six pairs is 2 / 2 ** 6."""
    who = [{"participant": f"P{n}", "visit": visit} for n in range(6) for visit in ("A", "B")]
    rng = np.random.default_rng(0)
    values = rng.normal(1.0, 0.1, len(who))
    of_person = values.reshape(6, 2).mean(axis=1)

    rows = [
        {**each, "run": "1", "map": "open", "central": v, "edge": 0.0, "difference": v}
        for each, v in zip(who, values.tolist(), strict=True)
    ]
    (found,) = areas.group_rows(rows)
    assert (found["n"], found["p"]) == (6, pytest.approx(1 / 32))
    assert found["difference"] == pytest.approx(of_person.mean())
    half = 2.570582 * of_person.std(ddof=1) / 6**0.5
    assert found["high"] - found["difference"] == pytest.approx(half, rel=1e-5)

    rows = [{**each, "source": "online", "slope": v} for each, v in zip(who, values.tolist(), strict=True)]
    (trend,) = in_a_row.group_trend(rows)
    assert (trend["n"], trend["slope"]) == (6, pytest.approx(of_person.mean()))

    level = {"source": "online", "errors_in_a_row": 1, "n": 9, "peak_to_peak": 1.0, "channel": "Fz"}
    rows = [{**e, **level, "mean": v, "low": v - 1, "high": v + 1} for e, v in zip(who, values.tolist(), strict=True)]
    (mean,) = in_a_row.group_levels(rows)
    assert (mean["n"], mean["mean"]) == (6, pytest.approx(of_person.mean()))

    about = {"source": "online", "area": "all", "condition": "difference", "channel": "Fz"}
    rows = [
        {**e, **about, "time_ms": float(t), "mean_uv": v + 0.01 * t}
        for e, v in zip(who, values.tolist(), strict=True)
        for t in range(0, 40, 4)
    ]
    (cluster,) = clusters.group_cluster_rows(rows)
    assert cluster["n"] == 6
    assert cluster["p"] >= 1 / 32


def test_who_comes_more_often_weighs_no_more_in_the_paper_s_tables() -> None:
    visits = [("P1", "A", 1.0), ("P2", "A", 0.5), ("P2", "B", 0.6), ("P2", "C", 0.7)]
    runs = [{"participant": who, "visit": visit, "task": "online", "map": "open"} for who, visit, _ in visits]
    scores = [
        {"participant": who, "visit": visit, "source": "open", "measure": "accuracy", "value": v, "low": v, "high": v}
        for who, visit, v in visits
    ]
    mean = those(those(online.table_one(scores, runs), series="ours"), participant="mean")
    assert mean[0]["open_accuracy"] == pytest.approx((1.0 + 0.6) / 2)
    alone = [row for row in online.table_one(scores[1:], runs[1:]) if row["visit"] == "mean"]
    assert (alone[0]["participant"], alone[0]["open_accuracy"]) == ("P2", pytest.approx(0.6))


def test_the_moves_of_several_visits_are_as_one_mean() -> None:
    """Mean and interval of all moves follow from those of each visit."""
    one, other = (np.random.default_rng(seed).normal(5, 2, n) for seed, n in ((0, 30), (1, 1)))
    about = {"participant": "P", "source": "online", "errors_in_a_row": 2, "peak_to_peak": 1.0, "channel": "Fz"}
    rows = [
        {**about, "visit": visit, "n": len(values), **online.mean_interval(values.tolist())}
        for visit, values in (("A", one), ("B", other))
    ]
    (found,) = in_a_row.group_levels(rows)
    expected = online.mean_interval([*one, *other])
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    assert (found["visit"], found["n"]) == ("mean", 31)
