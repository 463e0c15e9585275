"""Verdicts: what a judge says of an epoch, and what the verdict is worth."""

from dataclasses import replace

import numpy as np
import pytest

from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.protocol import Verdict, decode, encode
from decoder.calibration import calibrate
from decoder.chain import design
from decoder.epochs import Epoch, Rejection
from decoder.evidence import EVIDENCE_LIMIT, Evidence
from decoder.judge import Judge, judge_with, judge_without
from decoder.model import make_model
from decoder.montage import MONTAGE_64
from decoder.spatial import interpolation

CHANNELS = MONTAGE_64[::4]
N = len(CHANNELS)
EEG = EegDescription("LiveAmp", "", "", CHANNELS, ("uV",) * N, ("EEG",) * N, 500.0)


@pytest.fixture(scope="module")
def judge() -> Judge:
    rng = np.random.default_rng(0)
    error = rng.permutation(np.arange(100) < 30)
    settings = Config().classifier
    fitted = calibrate(rng.normal(error[:, None] - 0.5, 5, (100, 15 * N)), error, settings)
    details = {"participant": "P003", "channels": CHANNELS, "n_rejected": 0}
    return judge_with(make_model(fitted, error, design(Config().chain, 500.0), settings, **details), Config(), EEG, "s")


def epochs(judge: Judge, n: int = 20) -> list[Epoch]:
    rng = np.random.default_rng(1)
    return [Epoch(rng.normal(0, 20, (judge.shape.n_raw, N)), 0.0, 1.0) for _ in range(n)]


def test_evidence_is_the_calibrated_log_odds(judge: Judge) -> None:
    assert judge.evidence is not None
    verdicts = [judge.verdict((0, 1), epoch, 0.0) for epoch in epochs(judge)]
    assert {verdict.outcome for verdict in verdicts} == {"error", "correct"}
    for verdict in verdicts:
        assert verdict.log_odds is not None
        line = judge.evidence.slope * verdict.log_odds + judge.evidence.intercept
        assert verdict.evidence == min(EVIDENCE_LIMIT, max(-EVIDENCE_LIMIT, line))
        assert decode(encode(verdict)) == verdict


def test_the_same_epoch_gives_the_same_bits(judge: Judge) -> None:
    epoch = epochs(judge, 1)[0]
    assert judge.verdict((0, 1), epoch, 0.0) == judge.verdict((0, 1), replace(epoch, data=epoch.data.copy()), 0.0)


def test_a_decoder_at_chance_still_judges_but_its_verdicts_say_nothing(judge: Judge) -> None:
    chance = replace(judge, evidence=Evidence(0.0, 0.0, 0.5, 0.5, 0.0))
    for epoch in epochs(judge):
        verdict = chance.verdict((0, 1), epoch, 0.0)
        assert verdict.outcome == judge.verdict((0, 1), epoch, 0.0).outcome
        assert verdict.evidence == 0


def test_no_verdict_no_evidence(judge: Judge) -> None:
    rejected = judge.verdict((0, 1), Rejection("the EEG is silent", by_time=True), 0.0)
    unjudged = judge_without(Config(), EEG, "s").verdict((0, 1), epochs(judge, 1)[0], 0.0)
    assert (rejected.outcome, rejected.log_odds, rejected.evidence) == ("rejected", None, None)
    assert (unjudged.outcome, unjudged.log_odds, unjudged.evidence) == ("unjudged", None, None)


def reason(said: Verdict) -> str:
    assert said.outcome == "rejected"
    assert said.reason is not None
    return said.reason


def test_what_no_eeg_is_is_rejected_with_the_channel(judge: Judge) -> None:
    def verdict(value: float, samples: slice) -> Verdict:
        epoch = epochs(judge, 1)[0]
        epoch.data[samples, 2] = value
        return judge.verdict((0, 1), epoch, 0.0)

    assert "finite" in reason(verdict(np.inf, slice(100, 101)))
    assert "finite" in reason(verdict(np.nan, slice(100, 101)))
    assert "6000000 uV is beyond 5000000 uV" in reason(verdict(-6e6, slice(100, 101)))
    assert f"in the decoder's band at {CHANNELS[2]} is beyond 500 uV" in reason(verdict(9000, slice(-200, -100)))
    assert verdict(9000, slice(None)).outcome in {"error", "correct"}  # an electrode's offset is nobody's artefact


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e12])
def test_a_bad_channel_leaves_no_trace(judge: Judge, value: float) -> None:
    """Whatever it delivers; and the verdict is that of an epoch in which its neighbours' mixture stands instead."""
    bad = judge.with_bad([CHANNELS[2].upper()])
    for epoch in epochs(judge):
        spoilt, repaired = epoch.data.copy(), epoch.data.copy()
        spoilt[:, 2] = value
        repaired[:, 2] = epoch.data @ interpolation(CHANNELS, [CHANNELS[2]])[2]
        verdict = bad.verdict((0, 1), replace(epoch, data=spoilt), 0.0)
        assert verdict == bad.verdict((0, 1), epoch, 0.0)
        expected = judge.verdict((0, 1), replace(epoch, data=repaired), 0.0)
        assert verdict.log_odds == pytest.approx(expected.log_odds, abs=1e-9)


def test_too_many_bad_channels_reject_and_good_ones_bring_verdicts_back(judge: Judge) -> None:
    epoch = epochs(judge, 1)[0]
    worse = judge.with_bad(CHANNELS[: N // 2])
    assert "bad" in reason(worse.verdict((0, 1), epoch, 0.0))
    assert worse.with_bad([]).verdict((0, 1), epoch, 0.0) == judge.verdict((0, 1), epoch, 0.0)


@pytest.mark.parametrize("n", [4, 8, 64])
def test_channels_without_a_place_are_left_out_when_they_are_bad(n: int) -> None:
    """An amplifier that calls its electrodes A1, A2 ... still gives verdicts with one dead."""
    eeg = EegDescription("BioSemi", "", "", tuple(f"X{i}" for i in range(n)), ("uV",) * n, ("EEG",) * n, 500.0)
    whole = judge_without(Config(), eeg, "s")
    mended = whole.with_bad(["X1"])
    data = np.random.default_rng(3).normal(0, 20, (whole.shape.n_raw, n))
    data[:, 1] = np.nan
    row = mended.features(Epoch(data, 0.0, 1.0))
    assert not isinstance(row, Rejection)
    data[:, 1] = 0.0
    np.testing.assert_allclose(row, whole.features(Epoch(data, 0.0, 1.0)), atol=1e-12)
