"""From an epoch to a verdict. The live decoder and the replay call this and nothing else."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.protocol import Verdict
from decoder.chain import design
from decoder.classifier import LinearClassifier
from decoder.epochs import Epoch, Rejection, Shape
from decoder.evidence import Evidence
from decoder.model import DecoderModel, fit_stream
from decoder.operator import chain_operator, digest, features
from decoder.spatial import common_average, compose

MoveKey = tuple[int, int]
"""(episode, step)."""


@dataclass(frozen=True, eq=False)
class Judge:
    """Everything fixed about how verdicts are made on one stream.

    Attributes
    ----------
    session : goes into every verdict.
    shape : what an epoch must look like.
    operator : (n_raw, n_windows).
    spatial : (n_channels, n_stream), from the stream's EEG channels to the decoder's; the same for a whole block.
    classifier, evidence : None in a calibration, when epochs are only checked.
    """

    session: str
    shape: Shape
    operator: NDArray[np.float64]
    spatial: NDArray[np.float64]
    classifier: LinearClassifier | None
    evidence: Evidence | None

    def features(self, epoch: Epoch) -> NDArray[np.float64]:
        """The epoch's features, (n_channels * n_windows,), uV."""
        return features(epoch.data, self.operator, self.spatial)

    def verdict(self, key: MoveKey, result: Epoch | Rejection, clock_offset: float) -> Verdict:
        """The verdict on a move's epoch, or why there is none."""
        if isinstance(result, Rejection):
            return Verdict(
                session=self.session,
                episode=key[0],
                step=key[1],
                outcome="rejected",
                reason=result.reason,
                by_time=result.by_time,
                clock_offset=clock_offset,
            )
        vector = self.features(result)
        log_odds = self.classifier.log_odds(vector) if self.classifier else None
        return Verdict(
            session=self.session,
            episode=key[0],
            step=key[1],
            outcome="unjudged" if log_odds is None else "error" if log_odds > 0 else "correct",
            log_odds=log_odds,
            evidence=self.evidence.of(log_odds) if self.evidence and log_odds is not None else None,
            clock_offset=clock_offset,
            first_time=result.first_time,
            n_samples=result.n_samples,
            digest=digest(vector),
        )


def judge_with(model: DecoderModel, config: Config, eeg: EegDescription, session: str) -> Judge:
    """A judge with a fitted decoder. Raises SetupError when the stream doesn't fit it."""
    info = model.info
    spatial = compose(len(eeg.picks), fit_stream(model, eeg.name, eeg.picked, eeg.sfreq))
    shape = Shape(eeg.sfreq, info.n_before, info.n_after, config.eeg.max_uv)
    return Judge(session, shape, model.operator, spatial, model.classifier, info.evidence)


def judge_without(config: Config, eeg: EegDescription, session: str) -> Judge:
    """A judge for a calibration: all EEG channels, features but no verdict."""
    chain = design(config.chain, eeg.sfreq)
    shape = Shape(eeg.sfreq, chain.n_before, chain.n_after, config.eeg.max_uv)
    return Judge(session, shape, chain_operator(chain), common_average(len(eeg.picks)), None, None)
