"""The participant to rehearse with, judged by the decoder's own calibration."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.errors import SetupError
from decoder.background import RecordedBackground, SyntheticBackground, read_background
from decoder.calibration import Scores, held_out_log_odds, score, stratified_folds
from decoder.chain import design
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.operator import chain_operator, features
from decoder.participant import GAIN_UV, Participant, separation, stratified_normal
from decoder.spatial import common_average

DATA = Path(os.environ.get("BCI_APP_DATA", Path(__file__).parents[2] / "shared" / "data")) / "eegmmidb_s001"


def watch(person: Participant, n_moves: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples, onsets and errors of a calibration with moves 3 s apart, 30 % of them errors."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n_moves) < 0.3 * n_moves)
    onsets = 5 + 3 * np.arange(n_moves) + rng.uniform(0, 0.02, n_moves)
    for onset, wrong in zip(onsets.tolist(), error.tolist(), strict=True):
        assert person.respond(onset, wrong)
    return person.render(0, round((onsets[-1] + 2) * person.sfreq)), onsets, error


def cross_validate(recorded: tuple[np.ndarray, np.ndarray, np.ndarray], sfreq: float, config: ChainConfig) -> Scores:
    samples, onsets, error = recorded
    chain = design(config, sfreq)
    operator, spatial = chain_operator(chain), common_average(samples.shape[1])
    shape = Shape(sfreq, chain.n_before, chain.n_after)
    epochs = cut_recording(samples, np.arange(len(samples)) / sfreq, onsets.tolist(), shape)
    rows = np.stack([features(epoch.data, operator, spatial) for epoch in epochs if isinstance(epoch, Epoch)])
    assert len(rows) == len(error)
    classifier = ClassifierConfig()
    return score(held_out_log_odds(rows, error, classifier, stratified_folds(error, classifier)), error)


@pytest.fixture(scope="module")
def calibration() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return watch(Participant(1, 250.0, decodability=0.9), 300)


def test_the_decoder_reads_this_person(calibration: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    scores = cross_validate(calibration, 250.0, ChainConfig())
    assert scores.balanced_accuracy.value > 0.75
    assert abs(scores.hit_rate.value - scores.correct_rejection_rate.value) < 0.15


def test_eeg_before_the_move_says_nothing(calibration: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Control: windows that end at the onset are at chance, so nothing leaks backwards.

    The high-pass lets the answer to the last move reach into these windows, so its label may be read there. The labels
    of this seed don't follow from the ones before.
    """
    error = calibration[2]
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.02
    auc = cross_validate(calibration, 250.0, ChainConfig(start_ms=-450.0)).auc
    assert auc.low < 0.5 < auc.high


def test_without_an_errp_verdicts_are_at_chance() -> None:
    auc = cross_validate(watch(Participant(1, 250.0, 0.9, errp=False), 200), 250.0, ChainConfig()).auc
    assert auc.low < 0.5 < auc.high


def test_error_minus_correct_has_the_published_shape(
    calibration: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Paper V.C.1: at Fz negative near 200 ms, positive near 300 ms, negative near 400 ms."""
    samples, onsets, error = calibration
    names = Participant(1, 250.0).names
    at = np.round(onsets * 250).astype(int)[:, None] + np.arange(-75, 150)
    epochs = samples[:, names.index("Fz")][at] - samples.mean(axis=1)[at]
    epochs -= epochs[:, :75].mean(axis=1, keepdims=True)
    difference = epochs[error].mean(axis=0) - epochs[~error].mean(axis=0)
    times = np.arange(-75, 150) / 250
    assert 0.25 < times[np.argmax(difference)] < 0.35
    early, late = (times > 0.15) & (times < 0.27), (times > 0.35) & (times < 0.47)
    assert difference[early].min() < -3
    assert difference[late].min() < -3
    assert difference.max() > 6


@settings(max_examples=8, deadline=None)
@given(chunks=st.lists(st.integers(1, 3000), min_size=1, max_size=10), seed=st.integers(0, 3))
def test_chunks_dont_matter(chunks: list[int], seed: int) -> None:
    onsets = [(3.0, True), (6.001, False), (7.5, True), (15.7, False)]
    whole, parts = (Participant(seed, 250.0) for _ in range(2))
    for onset, error in onsets:
        whole.respond(onset, error)
        parts.respond(onset, error)
    expected = whole.render(0, 4500)
    pieces, place, turn = [], 0, 0
    while place < 4500:
        n_new = min(max(20, chunks[turn % len(chunks)]), 4500 - place)
        pieces.append(parts.render(place, n_new))
        place, turn = place + n_new, turn + 1
    assert np.concatenate(pieces).tobytes() == expected.tobytes()
    assert Participant(seed, 250.0).render(1234, 10).tobytes() == Participant(seed, 250.0).render(1234, 10).tobytes()


def test_a_seed_is_a_person() -> None:
    assert not np.array_equal(Participant(1, 250.0).render(0, 100), Participant(2, 250.0).render(0, 100))


def test_a_move_told_too_late_is_reported() -> None:
    person = Participant(1, 250.0, t0=1000.0)
    person.render(0, 2500)
    assert not person.respond(1009.0, error=True)
    assert person.respond(1009.96, error=True)  # nothing of an answer shows in its first 50 ms
    assert person.respond(1011.0, error=True)


def test_answers_come_at_session_time() -> None:
    early, late = Participant(1, 250.0, t0=0.0), Participant(1, 250.0, t0=1000.0)
    early.respond(3.0, True)
    late.respond(1003.0, True)
    np.testing.assert_allclose(early.render(0, 1500), late.render(0, 1500), atol=1e-2)


def test_another_run_is_another_hour_of_the_same_person() -> None:
    first, again, other = (Participant(1, 250.0, run=run) for run in (0, 0, 5))
    assert first.render(0, 500).tobytes() == again.render(0, 500).tobytes()
    assert not np.array_equal(first.render(500, 500), other.render(500, 500))
    np.testing.assert_array_equal(first._maps, other._maps)


def test_the_background_looks_like_eeg() -> None:
    background = SyntheticBackground(1, 250.0)
    samples = background.samples(0, 250 * 60)
    assert np.abs(samples.mean(axis=0)).max() > 1000  # electrode offsets
    spectrum = np.abs(np.fft.rfft(samples - samples.mean(axis=0), axis=0)) ** 2
    hz = np.fft.rfftfreq(len(samples), 1 / 250)

    def power(low: float, high: float, name: str) -> float:
        return float(spectrum[(hz >= low) & (hz < high), background.names.index(name)].mean())

    assert power(2, 4, "Cz") > 10 * power(20, 40, "Cz")
    assert power(9, 11, "Oz") > 5 * power(6, 7.5, "Oz")
    assert power(49.9, 50.1, "Cz") > 20 * power(45, 49, "Cz")
    correlation = np.corrcoef(np.diff(samples, axis=0).T)
    c3, c1, p8 = (background.names.index(name) for name in ("C3", "C1", "P8"))
    assert correlation[c3, c1] > correlation[c3, p8]


def test_amplitudes_are_normal_and_stratified() -> None:
    deviates = np.array([stratified_normal(1, 0, number) for number in range(200)])
    assert abs(deviates.mean()) < 0.03
    assert abs(deviates.std() - 1) < 0.06
    assert separation(0.5) == 0
    assert GAIN_UV * separation(0.9) > GAIN_UV * separation(0.75) > 0


def test_a_recording_is_resampled_and_looped_without_a_step() -> None:
    rng = np.random.default_rng(0)
    data = rng.normal(0, 1, (1600, 3)).cumsum(axis=0) + np.array([0, 1000, -3000])
    background = RecordedBackground(data, ("Fz", "FCz", "Cz"), 160.0, 500.0)
    looped = background.samples(0, 20_000)
    assert np.abs(np.diff(looped, axis=0)).max() < 5 * np.abs(np.diff(looped[600:4000], axis=0)).max()
    np.testing.assert_array_equal(looped[:1000], background.samples(4500, 1000))
    with pytest.raises(SetupError, match="longer than 2 s"):
        RecordedBackground(data[:300], ("Fz", "FCz", "Cz"), 160.0, 500.0)


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.edf").write_bytes(b"nothing")
    with pytest.raises(SetupError, match="Can't read EEG"):
        read_background(tmp_path / "x.edf")


@pytest.mark.skipif(not DATA.exists(), reason=f"no real EEG at {DATA}")
def test_a_real_recording_answers_too() -> None:
    background = read_background(DATA / "S001R03.edf", 250.0)
    assert len(background.names) == 64
    recorded = watch(Participant(1, decodability=0.9, background=background), 200)
    assert 1 < recorded[0].std(axis=0).mean() < 200
    assert cross_validate(recorded, 250.0, ChainConfig()).auc.value > 0.7


def test_answers_that_are_over_can_be_forgotten() -> None:
    one, other = (Participant(3, 128.0) for _ in range(2))
    for number in range(20):
        onset = 1.0 + 3.0 * number
        start, n_times = round((onset - 0.5) * 128), 3 * 128
        assert one.respond(onset, number % 3 == 0)
        assert other.respond(onset, number % 3 == 0)
        other.forget(start)
        np.testing.assert_array_equal(one.render(start, n_times), other.render(start, n_times))
    assert len(other._answers) <= 2 < len(one._answers)
