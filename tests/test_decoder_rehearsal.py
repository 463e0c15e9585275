"""A participant learnt from a recording: what is learnt is what was there, and what is played never repeats a trial."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import ClassifierConfig, Config, validated
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.recording import Recording
from bci_app.rehearsing import likeness_of
from decoder.calibration import contiguous_folds, held_out_log_odds, score
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.rehearsal import FADE_S, STRETCH_S, Likeness, Noise, RedrawnBackground, Rehearsed, learn, reproducible
from decoder.rehearsal_file import load, save
from decoder.rehearsal_scale import Watch, scale_for, watched

SFREQ, NAMES = 100.0, ("Fz", "FCz", "Cz", "Pz", "Oz", "C3")
MAP = np.array([1.0, 0.9, 0.5, 0.1, 0.0, 0.3])
VISUAL = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 0.2])
TIMES = np.arange(100) / SFREQ
COURSE = np.exp(-(((TIMES - 0.35) / 0.06) ** 2) / 2)
Recorded = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def record(n_moves: int, size: float, spread: float = 0.5, seed: int = 0) -> Recorded:
    """Samples, stamps, onsets and errors: drifting, offset electrodes, an ErrP of `size` uV times 1 +- `spread`."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n_moves) < 0.3 * n_moves)
    onsets = 1000.0 + np.round(8 + 3.02 * np.arange(n_moves), 2)
    n_times = round((8 + 3.02 * n_moves + 2) * SFREQ)
    samples = rng.normal(0, 4, (n_times, 6)) + rng.normal(0, 0.3, (n_times, 6)).cumsum(axis=0) + 1000 * np.arange(6)
    for onset, wrong in zip(onsets, error, strict=True):
        first = round((onset - 1000) * SFREQ)
        gain = size * (float(wrong) + spread * rng.normal())
        samples[first : first + 100] += np.outer(COURSE, gain * MAP + 3 * VISUAL)
    return samples, 1000 + np.arange(n_times) / SFREQ, onsets, error


def likeness_from(recorded: Recorded) -> Likeness:
    samples, times, onsets, error = recorded
    return learn(samples, times, onsets.tolist(), error, NAMES, SFREQ)


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return record(400, 6.0)


@pytest.fixture(scope="module")
def likeness(recorded: Recorded) -> Likeness:
    return likeness_from(recorded)


def test_the_response_is_found(likeness: Likeness) -> None:
    truth = 6 * np.outer(COURSE, MAP)[5:95]
    found = likeness.errp_courses.T @ likeness.errp_maps
    assert np.corrcoef(found.ravel(), truth.ravel())[0, 1] > 0.95
    assert (found * truth).sum() / (truth**2).sum() == pytest.approx(1, abs=0.15)
    assert likeness.spread == pytest.approx(0.5, abs=0.12)
    common = likeness.courses.T @ likeness.maps
    assert common[30, 4] == pytest.approx(3, abs=0.5)


def test_the_background_has_no_response_left(recorded: Recorded, likeness: Likeness) -> None:
    samples, _, onsets, error = recorded
    at = np.round((onsets - 1000) * SFREQ).astype(int)[:, None] + np.arange(-20, 120)

    def difference(data: np.ndarray) -> float:
        epochs = data[at] - data[at][:, :20].mean(axis=1, keepdims=True)
        return float(np.abs(epochs[error].mean(axis=0) - epochs[~error].mean(axis=0))[50:60, 0].mean())

    assert difference(samples) > 4
    assert difference(likeness.background.astype(np.float64)) < 0.8


def test_without_an_errp_little_is_found() -> None:
    found = likeness_from(record(300, 0.0))
    assert np.abs(found.errp_courses.T @ found.errp_maps).max() < 1.5


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0, 5))
def test_what_only_one_half_has_is_made_small(seed: int, size: float) -> None:
    """Noise of mean 0 in both halves: what is left of it is less than there was, and the truth stays."""
    rng = np.random.default_rng(seed)
    truth = size * np.outer(COURSE, MAP)
    one, other = (truth + rng.normal(0, 0.3, truth.shape) for _ in range(2))
    courses, maps = reproducible(one, other, Noise(np.eye(len(truth)), np.eye(6)))
    error = ((courses.T @ maps - truth) ** 2).sum()
    assert error < (((one + other) / 2 - truth) ** 2).sum()


@settings(max_examples=15, deadline=None)
@given(chunks=st.lists(st.integers(1, 3000), min_size=1, max_size=10), seed=st.integers(0, 3))
def test_chunks_dont_matter(likeness: Likeness, chunks: list[int], seed: int) -> None:
    whole, parts = (Rehearsed(likeness, seed) for _ in range(2))
    for onset, error in [(3.0, True), (6.001, False), (19.3, True), (55.7, False)]:
        assert whole.respond(onset, error)
        assert parts.respond(onset, error)
    expected = whole.render(0, 6000)
    pieces, place, turn = [], 0, 0
    while place < 6000:
        n_new = min(max(20, chunks[turn % len(chunks)]), 6000 - place)
        pieces.append(parts.render(place, n_new))
        place, turn = place + n_new, turn + 1
    assert np.concatenate(pieces).tobytes() == expected.tobytes()


def test_stretches_meet_without_a_step(recorded: Recorded, likeness: Likeness) -> None:
    n_step = round((STRETCH_S - FADE_S) * SFREQ)
    played = RedrawnBackground(likeness, 1).samples(0, 200 * n_step)  # the electrodes drift by hundreds of uV
    usual = np.abs(np.diff(recorded[0], axis=0)).max()
    assert np.abs(np.diff(played, axis=0)).max() < 1.2 * usual
    assert np.isfinite(played).all()


def test_a_cycle_plays_every_stretch_once_and_the_next_cuts_them_elsewhere(likeness: Likeness) -> None:
    data = np.arange(len(likeness.background), dtype=np.float32)[:, None]
    counting = replace(likeness, background=data, names=("counter",))
    background = RedrawnBackground(counting, 1)
    begins = [background._order(cycle) for cycle in range(3)]
    step = round((STRETCH_S - FADE_S) * SFREQ)
    for begin in begins:
        assert (np.diff(np.sort(begin)) >= step).all()
        assert begin.max() + step + round(FADE_S * SFREQ) <= len(data)
    assert not set(begins[0]) & set(begins[1])
    assert not np.array_equal(np.argsort(begins[0]), np.argsort(begins[1]))


@settings(max_examples=30, deadline=None)
@given(lengths=st.lists(st.integers(100, 30_000), min_size=1, max_size=6), seed=st.integers(0, 9))
def test_no_stretch_spans_a_gap(likeness: Likeness, lengths: list[int], seed: int) -> None:
    lengths = [*lengths, 2100]
    edges = np.concatenate(([0], np.cumsum(lengths)))
    background = np.zeros((edges[-1], 6), dtype=np.float32)
    drawn = RedrawnBackground(replace(likeness, background=background, edges=edges), seed)
    begins = np.concatenate([drawn._order(cycle) for cycle in range(3)])
    piece = np.searchsorted(edges, begins, side="right")
    assert (begins >= edges[piece - 1]).all()
    assert (begins + round(STRETCH_S * SFREQ) <= edges[piece]).all()


def test_another_run_is_another_hour(likeness: Likeness) -> None:
    first, again, other = (Rehearsed(likeness, 1, run=run).render(0, 5000) for run in (0, 0, 7))
    assert first.tobytes() == again.tobytes()
    assert not np.array_equal(first, other)


def test_an_error_adds_the_errp_and_the_control_doesnt(likeness: Likeness) -> None:
    def fz(errp: bool, error: bool) -> float:
        person = Rehearsed(replace(likeness, spread=0.0), 1, errp)
        quiet = person.render(0, 2000)
        person = Rehearsed(replace(likeness, spread=0.0), 1, errp, t0=500.0)
        assert person.respond(505.0, error)
        return float((person.render(0, 2000) - quiet)[535, 0])

    assert fz(True, True) - fz(True, False) == pytest.approx(6, abs=1)
    assert fz(False, True) == fz(False, False)


def test_a_move_told_too_late_is_reported(likeness: Likeness) -> None:
    person = Rehearsed(likeness, 1, t0=1000.0)
    person.render(0, 1000)
    assert not person.respond(1009.0, error=True)
    assert person.respond(1009.96, error=True)


def test_the_size_found_gives_the_accuracy_asked_for(recorded: Recorded, likeness: Likeness) -> None:
    samples, times, onsets, error = recorded
    config, shape = ClassifierConfig(), Shape(SFREQ, 20, 60)

    def features(_: int, epoch: Epoch) -> np.ndarray:
        levelled = epoch.data - epoch.data[:20].mean(axis=0)
        return levelled[35:75].reshape(8, 5, 6).mean(axis=1).T.ravel()

    rows = np.stack([features(0, e) for e in cut_recording(samples, times, onsets, shape) if isinstance(e, Epoch)])
    folds = contiguous_folds(error, config)
    original = score(held_out_log_odds(rows, error, config, folds, 8), error).balanced_accuracy
    watch = Watch(onsets.tolist(), error, shape, features)
    scale, reached = scale_for(likeness, original.value, watch, config, 8, 1)
    assert scale == pytest.approx(1, abs=0.4)
    assert reached[0.0] == pytest.approx(0.5, abs=0.1)
    drawn, truth = watched(replace(likeness, scale=scale), watch, 1, 5)
    rehearsed = score(held_out_log_odds(drawn, truth, config, folds, 8), truth).balanced_accuracy.value
    assert original.low < rehearsed < original.high
    assert scale_for(likeness, 0.4, watch, config, 8, 1)[0] == 0


def test_a_recording_that_is_too_short_or_empty_of_moves_is_refused(recorded: Recorded) -> None:
    samples, times, onsets, error = recorded
    with pytest.raises(SetupError, match="without a gap is 20"):
        learn(samples[:2000], times[:2000], onsets[:3].tolist(), error[:3], NAMES, SFREQ)
    with pytest.raises(SetupError, match="Give a whole calibration"):
        learn(samples, times, onsets[:8].tolist(), error[:8], NAMES, SFREQ)
    gaps = times + 2.0 * (np.arange(len(times)) // 1500)
    with pytest.raises(SetupError, match="without a gap is 15"):
        learn(samples, gaps, onsets.tolist(), error, NAMES, SFREQ)


@pytest.mark.parametrize("factor", [0.0, 1000.0])
def test_a_bad_electrode_doesnt_spoil_the_others(recorded: Recorded, factor: float) -> None:
    samples, times, onsets, error = recorded
    broken = samples.copy()
    broken[:, 4] *= factor
    found = learn(broken, times, onsets.tolist(), error, NAMES, SFREQ)
    assert (found.errp_courses.T @ found.errp_maps)[30, 0] == pytest.approx(6, abs=1)
    assert found.spread == pytest.approx(0.5, abs=0.12)
    with pytest.raises(SetupError, match="are flat"):
        learn(broken * 0, times, onsets.tolist(), error, NAMES, SFREQ)


def test_what_is_no_number_is_silent(recorded: Recorded) -> None:
    samples, times, onsets, error = recorded
    broken = samples.copy()
    broken[:, 3] = np.nan
    found = learn(broken, times, onsets.tolist(), error, NAMES, SFREQ)
    assert np.isfinite(Rehearsed(found, 1).render(0, 5000)).all()


def test_a_file_holds_all_of_it(likeness: Likeness, tmp_path: Path) -> None:
    path = tmp_path / "x_person.safetensors"
    save(likeness, path, "P007", "0" * 64)
    again = load(path)
    assert Rehearsed(again, 1).render(0, 3000).tobytes() == Rehearsed(likeness, 1).render(0, 3000).tobytes()
    assert (again.spread, again.scale, again.names) == (likeness.spread, likeness.scale, likeness.names)
    with pytest.raises(SetupError, match="none is overwritten"):
        save(likeness, path, "P007", "0" * 64)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.999])
def test_a_cut_file_is_refused(likeness: Likeness, tmp_path: Path, share: float) -> None:
    path = tmp_path / "x_person.safetensors"
    save(likeness, path, "P007", "0" * 64)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(SetupError, match="damaged"):
        load(path)
    with pytest.raises(SetupError, match="Can't read"):
        load(tmp_path / "absent.safetensors")


def test_a_decoder_is_no_person(any_decoder: Path) -> None:
    with pytest.raises(SetupError, match="is no rehearsal"):
        load(any_decoder)


def test_a_recording_without_truth_is_refused(recorded: Recorded) -> None:
    eeg = EegDescription("A", "", "", NAMES, ("uV",) * 6, ("EEG",) * 6, SFREQ)
    recording = Recording(Path("x.xdf"), eeg, recorded[0], recorded[1], (), ())
    with pytest.raises(SetupError, match="no Truth message"):
        likeness_of(recording, Config(), lambda *_: None)


def test_a_person_has_one_background() -> None:
    with pytest.raises(SetupError, match="exclude each other"):
        validated({"simulation": {"background": "a.edf", "rehearse": "b.safetensors"}}, "here")
