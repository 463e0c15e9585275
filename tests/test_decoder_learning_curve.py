"""Learning curve, stop rule and warm start, on features whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from bci_app.config import ClassifierConfig
from decoder.classifier import fit
from decoder.learning_curve import EPOCHS, Point, measure, outlook, point, sentence, separation_at

CONFIG = ClassifierConfig(covariance="ledoit-wolf")  # the features here have no channels and windows


def person(n: int, distance: float, seed: int = 0, n_features: int = 30):
    """White features whose class means are `distance` apart, along all features alike."""
    rng = np.random.default_rng(seed)
    error = np.tile(np.arange(10) < 3, n // 10)
    return rng.normal(0, 1, (n, n_features)) + np.outer(error, np.full(n_features, distance / n_features**0.5)), error


def exact(n_train: int, limit: float) -> Point:
    return Point(n_train, float(separation_at(n_train, np.array(limit), EPOCHS)), 0.02)


@pytest.mark.parametrize("limit", [0.8, 1.5, 3.0])
@pytest.mark.parametrize("n", [120, 360])
def test_a_participant_on_the_typical_curve_is_predicted(limit: float, n: int) -> None:
    found = outlook([exact(round(0.4 * n), limit), exact(round(0.8 * n), limit)], n, 120, 600 - n)
    now, end = (float(ndtr(separation_at(m, np.array(limit), EPOCHS) / 2)) for m in (n, 600))
    assert found.balanced_accuracy.value == pytest.approx(now, abs=0.01)
    assert found.total_gain.value == pytest.approx(end - now, abs=0.01)
    assert found.total_gain.low <= end - now <= found.total_gain.high


points = st.builds(Point, st.integers(20, 600), st.floats(-1, 5), st.floats(0.05, 0.5))


@settings(max_examples=100, deadline=None)
@given(st.lists(points, min_size=1, max_size=4), st.integers(60, 600), st.integers(1, 200), st.integers(0, 600))
def test_whatever_was_measured_gains_are_shares_and_the_next_block_gains_part_of_all(
    known: list[Point], n: int, n_block: int, n_left: int
) -> None:
    found = outlook(known, n, n_block, n_left)
    assert 0.5 <= found.balanced_accuracy.low <= found.balanced_accuracy.value <= found.balanced_accuracy.high <= 1
    assert 0 <= found.total_gain.value < 0.5
    assert found.total_gain.low <= found.total_gain.value <= found.total_gain.high
    assert found.next_gain.value <= found.total_gain.value + 1e-12
    assert (found.total_gain.value == 0) == (n_left == 0)
    assert found.is_clear(0.6)
    assert not found.is_clear(0.0)


def test_the_more_is_known_the_less_there_is_to_gain() -> None:
    gains = [outlook([exact(n // 2, 1.5), exact(n, 1.5)], n, 120, 600 - n).total_gain.value for n in (120, 240, 360)]
    assert gains[0] > 1.5 * gains[1] > 2 * gains[2] > 0


def test_separation_of_gaussian_log_odds_and_its_standard_error() -> None:
    rng = np.random.default_rng(1)
    error = np.arange(600) < 180
    found = [point(rng.normal(np.where(error, 1.4, 0), 1), error, 540) for _ in range(300)]
    assert np.mean([one.separation for one in found]) == pytest.approx(1.4, abs=0.02)
    assert np.std([one.separation for one in found]) == pytest.approx(found[0].error, rel=0.15)
    assert point(np.zeros(600), error, 540).separation == 0


def test_the_measured_curve_rises_to_what_fresh_epochs_bear_out() -> None:
    fresh, truth = person(3000, 2.0, seed=99)
    found, borne_out = [], []
    for seed in range(20):
        features, error = person(300, 2.0, seed)
        half, full = measure(features, error, CONFIG, 15)
        assert (half.n_train, full.n_train) == (120, 240)
        found.append((half.separation, full.separation))
        classifier = fit(features, error, CONFIG)
        borne_out.append(point(fresh @ classifier.weights + classifier.bias, truth, 300).separation)
    # Trained on 240 and not on 300, and log odds of five decoders in one heap: a little less.
    assert np.mean(found, axis=0)[0] + 0.05 < np.mean(found, axis=0)[1] < np.mean(borne_out)
    assert np.mean(found, axis=0)[1] == pytest.approx(np.mean(borne_out), abs=0.12)


def test_the_sentence_says_what_to_do() -> None:
    known = [exact(200, 1.5), exact(400, 1.5)]
    assert "go on" in sentence(outlook(known, 240, 120, 360), 0.001)
    assert "not worthwhile" in sentence(outlook(known, 480, 120, 120), 0.05)
    last = sentence(outlook(known, 600, 120, 0), 0.01)
    assert last.startswith("After 600 epochs expect a balanced accuracy of 7")
    assert "gains" not in last
