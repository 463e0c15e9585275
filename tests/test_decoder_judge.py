"""Verdicts: what a judge says of an epoch, and what the verdict is worth."""

from dataclasses import replace

import numpy as np
import pytest

from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.protocol import decode, encode
from decoder.calibration import calibrate
from decoder.chain import design
from decoder.epochs import Epoch, Rejection
from decoder.evidence import EVIDENCE_LIMIT, Evidence
from decoder.judge import Judge, judge_with, judge_without
from decoder.model import make_model

CHANNELS = ("Fz", "FCz", "Cz", "Pz")
EEG = EegDescription("LiveAmp", "", "", CHANNELS, ("uV",) * 4, ("EEG",) * 4, 500.0)


@pytest.fixture(scope="module")
def judge() -> Judge:
    rng = np.random.default_rng(0)
    error = rng.permutation(np.arange(100) < 30)
    settings = Config().classifier
    fitted = calibrate(rng.normal(error[:, None], 5, (100, 60)), error, settings)
    details = {"participant": "P003", "channels": CHANNELS, "n_rejected": 0}
    return judge_with(make_model(fitted, error, design(Config().chain, 500.0), settings, **details), Config(), EEG, "s")


def epochs(judge: Judge, n: int = 20) -> list[Epoch]:
    rng = np.random.default_rng(1)
    return [Epoch(rng.normal(0, 20, (judge.shape.n_raw, 4)), 0.0, 1.0) for _ in range(n)]


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
