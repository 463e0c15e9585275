"""Simulated decoders: how often they are right, and that what they say is worth what they claim."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.special import expit
from scipy.stats import norm

from bci_app.errors import SetupError
from policy.verdicts import (
    LIMIT,
    Decoders,
    Resampled,
    Verdicts,
    anybody,
    binary_evidence,
    binary_information,
    score_information,
    separation,
    telling,
)

N = 40_000
TRUTH = np.repeat([True, False], N)


def drawn(decoders_or_words, seed=0, missing=0.0):
    """Evidence on N errors and on N correct moves."""
    rng = np.random.default_rng(seed)
    decoders = decoders_or_words
    if isinstance(decoders, str):
        decoders = Verdicts.parse(decoders, missing)(2 * N, rng)
    evidence = decoders.evidence(TRUTH, rng)
    assert evidence.dtype == np.float32
    return evidence[TRUTH], evidence[~TRUTH]


@given(st.floats(0.02, 0.98), st.floats(0.02, 0.98), st.floats(0, 0.9), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_words_come_at_the_stated_rates_and_are_worth_their_likelihood_ratio(hit, correct_rejection, missing, seed):
    assume(abs(hit + correct_rejection - 1) > 0.01)  # at chance both words say nothing, as a missing one
    errors, corrects = drawn(Decoders.binary(2 * N, hit, correct_rejection, missing=missing), seed)
    if_error, if_correct = binary_evidence(hit, correct_rejection)
    assert np.mean(errors == if_error) == pytest.approx((1 - missing) * hit, abs=0.02)
    assert np.mean(corrects == if_correct) == pytest.approx((1 - missing) * correct_rejection, abs=0.02)
    assert np.mean(errors == 0) == pytest.approx(missing, abs=0.02)
    assert if_error == pytest.approx(np.log(hit / (1 - correct_rejection)), abs=1e-4)
    assert if_correct == pytest.approx(np.log((1 - hit) / correct_rejection), abs=1e-4)


def test_the_evidence_of_a_symmetric_decoder_is_its_log_odds():
    errors, corrects = drawn("binary:0.8")
    assert set(np.unique(np.abs(np.concatenate([errors, corrects])))) == {np.float32(np.log(4))}
    assert np.mean(errors > 0) == pytest.approx(0.8, abs=0.01)
    assert np.mean(corrects < 0) == pytest.approx(0.8, abs=0.01)


def test_a_certain_verdict_is_bounded_and_one_that_never_comes_says_nothing():
    assert [float(value) for value in binary_evidence(1.0, 1.0)] == [LIMIT, -LIMIT]
    assert [float(value) for value in binary_evidence(0.0, 1.0)] == [0.0, 0.0]
    errors, corrects = drawn("score:1")
    assert (errors == LIMIT).mean() > 0.99
    assert (corrects == -LIMIT).mean() > 0.99


@pytest.mark.parametrize("words", ["score:0.6", "score:0.75", "score:0.9", "binary:0.7", "rates:0.65:0.86"])
def test_evidence_is_calibrated(words):
    """Where errors and correct moves are equally frequent, P(error | evidence) = sigmoid(evidence)."""
    evidence = np.concatenate(drawn(words))
    edges = np.unique(np.quantile(evidence, np.linspace(0, 1, 11)))
    for low, high in itertools.pairwise(edges):
        here = (evidence >= low) & (evidence <= high)
        assert TRUTH[here].mean() == pytest.approx(expit(evidence[here]).mean(), abs=0.02)


@pytest.mark.parametrize("accuracy", [0.55, 0.7, 0.85, 0.95])
def test_the_sign_of_a_score_is_right_with_its_accuracy(accuracy):
    errors, corrects = drawn(f"score:{accuracy}")
    assert np.mean(np.concatenate([errors > 0, corrects < 0])) == pytest.approx(accuracy, abs=0.01)
    assert norm.cdf(separation(accuracy) / 2) == pytest.approx(accuracy)


def test_some_verdicts_are_missing_of_either_kind_and_all_without_verdicts():
    for words in ("binary:0.7", "score:0.7"):
        assert np.mean(np.concatenate(drawn(words, missing=0.2)) == 0) == pytest.approx(0.2, abs=0.01)
    assert not np.concatenate(drawn("none")).any()


def test_information_against_known_values():
    assert binary_information(0.5, 0.5) == pytest.approx(0, abs=1e-9)
    assert binary_information(0.3, 0.7) == pytest.approx(0, abs=1e-9)  # calls three in ten an error, whatever it is
    assert binary_information(1.0, 1.0) == pytest.approx(1)
    # A binary symmetric channel (Cover & Thomas, 7.1.4): 1 - H(0.89), about one half.
    assert binary_information(0.89, 0.89) == pytest.approx(0.5001, abs=1e-3)
    assert score_information(0.5) == pytest.approx(0, abs=1e-6)
    assert score_information(1.0) == pytest.approx(1, abs=1e-4)


@given(st.floats(0.51, 0.98), st.floats(0.005, 0.02))
def test_a_score_says_more_than_its_sign_and_more_of_a_better_decoder(accuracy, more):
    assert binary_information(accuracy, accuracy) < score_information(accuracy) < score_information(accuracy + more)


def test_information_is_the_mean_of_what_verdicts_turn_out_to_say():
    """Monte Carlo: one bit less the entropy of the truth that a verdict leaves."""
    for words, told in (("score:0.75", score_information(0.75)), ("rates:0.6:0.9", binary_information(0.6, 0.9))):
        errors, corrects = drawn(words)
        left = np.log1p(np.exp(np.concatenate([-errors, corrects]).astype(float))).mean() / np.log(2)
        assert 1 - left == pytest.approx(told, abs=0.01)


def test_a_decoder_taken_for_another_keeps_its_rates_but_not_its_worth():
    kind = Verdicts("binary", (0.7,), taken_for=Verdicts("binary", (0.9,)))
    decoders = kind(2 * N, np.random.default_rng(0))
    errors, _ = drawn(decoders)
    assert np.mean(errors > 0) == pytest.approx(0.7, abs=0.01)
    assert errors.max() == pytest.approx(np.log(9), rel=1e-5)
    assert decoders.information[0] == pytest.approx(binary_information(0.9, 0.9))
    believed = Verdicts("score", (0.7,), taken_for=Verdicts("score", (0.9,)))
    ratio = drawn(believed(2 * N, np.random.default_rng(0)))[0].std() / drawn("score:0.7")[0].std()
    assert ratio == pytest.approx(separation(0.9) / separation(0.7), rel=0.01)


def test_the_word_of_a_score_is_binary():
    assert Verdicts.parse("score:0.7", 0.1).signs() == Verdicts.parse("binary:0.7", 0.1)
    assert Verdicts.parse("rates:0.6:0.9").signs() == Verdicts.parse("rates:0.6:0.9")


@pytest.mark.parametrize("words", ["none", "told", "binary:0.75", "rates:0.01:1", "score:1", "binary:1"])
def test_verdicts_in_words_make_the_round_trip(words):
    assert str(Verdicts.parse(words)) == words


@pytest.mark.parametrize(
    "words",
    ["", "binary", "binary:x", "binary:0.7:0.7", "rates:0.7", "rates:1.2:0.5", "score:nan", "none:0.5", "coin:0.7"],
)
def test_other_words_are_refused(words):
    with pytest.raises(SetupError, match=r"Verdicts must be none, binary:P.*found"):
        Verdicts.parse(words)


@pytest.mark.parametrize("words", ["binary:0.5", "score:0.5", "binary:0.3", "score:0"])
def test_an_accuracy_must_be_better_than_chance(words):
    with pytest.raises(SetupError, match=r"above 0\.5 and at most 1, found 0"):
        Verdicts.parse(words)


def test_training_for_anybody_meets_all_kinds_and_none_worse_than_chance():
    decoders = anybody(20_000, np.random.default_rng(0))
    signs = ~decoders.is_score
    assert 0.35 < decoders.is_score.mean() < 0.45
    assert (decoders.hit[signs] + decoders.correct_rejection[signs] >= 1 - 1e-6).all()
    assert (decoders.if_error >= 0).all()
    assert (decoders.if_correct <= 0).all()
    unequal = np.abs(decoders.hit - decoders.correct_rejection)[signs] > 0.1
    assert 0.2 < unequal.mean() < 0.4
    assert 0.25 < (decoders.missing > 0).mean() < 0.35
    assert decoders.missing.max() <= 0.3
    assert 0 <= decoders.information.min() < 0.01
    assert 0.9 < decoders.information.max() <= 1


def told_accuracies(decoders):
    """True and told ones of the binary decoders with one rate for both."""
    alike = ~decoders.is_score & (decoders.hit == decoders.correct_rejection)
    return decoders.hit[alike], expit(decoders.if_error[alike].astype(float))


def test_half_of_the_decoders_may_be_misjudged_by_so_many_points_and_no_more():
    true, told = told_accuracies(anybody(20_000, np.random.default_rng(0)))
    np.testing.assert_allclose(told, true, atol=1e-4)
    true, told = told_accuracies(anybody(20_000, np.random.default_rng(0), misjudged=0.1))
    off = np.abs(told - true)
    assert 0.4 < (off > 1e-4).mean() < 0.55  # half, but for those that stay certain
    assert 0.09 < off.max() < 0.1 + 1e-4
    assert told.min() > 0.5 - 1e-6
    scores = anybody(20_000, np.random.default_rng(0), misjudged=0.1)
    wrong = scores.is_score & (np.abs(scores.scale - scores.distance) > 1e-4)
    assert 0.4 < wrong.sum() / scores.is_score.sum() < 0.5


def test_decoders_that_tell_something_tell_more_than_asked():
    information = telling(0.045)(5000, np.random.default_rng(0)).information
    assert len(information) == 5000
    assert 0.045 < information.min() < 0.05


def test_resampled_evidence_is_what_was_held_out():
    errors, corrects = np.array([0.5, 2.0, -1.0], np.float32), np.array([-3.0, 0.25], np.float32)
    own = Resampled(errors, corrects, np.full(2 * N, 0.2, np.float32))
    for given_ones, of in zip(drawn(own), (errors, corrects), strict=True):
        values, counts = np.unique(given_ones, return_counts=True)
        assert values.tolist() == sorted(of.tolist())
        np.testing.assert_allclose(counts / N, 1 / len(of), atol=0.01)
    assert len(own.take(np.arange(2 * N) < 7).information) == 7


def test_decoders_are_put_and_taken_by_episode():
    decoders = Decoders.binary(4, 0.6, 0.6)
    which = np.array([False, True, False, True])
    decoders.put(which, Decoders.score(2, np.array([0.8, 0.9])))
    assert decoders.is_score.tolist() == which.tolist()
    np.testing.assert_allclose(decoders.take(which).distance, separation(np.array([0.8, 0.9])), rtol=1e-6)
    np.testing.assert_allclose(decoders.take(~which).hit, 0.6, rtol=1e-6)
