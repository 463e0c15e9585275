"""From an epoch to a verdict. The live decoder and the replay call this and nothing else."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config, EegConfig
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.protocol import Verdict
from decoder.chain import design
from decoder.classifier import LinearClassifier
from decoder.epochs import Epoch, Rejection, Shape
from decoder.evidence import Evidence
from decoder.eyes import Eyes, eeg_outputs
from decoder.model import DecoderModel, fit_stream
from decoder.operator import chain_operator, digest, features
from decoder.spatial import Montage, ocular

MoveKey = tuple[int, int]
"""(episode, step)."""


@dataclass(frozen=True, eq=False)
class Judge:
    """Everything fixed about how verdicts are made on one stream, while the same electrodes are bad.

    Attributes
    ----------
    session : goes into every verdict.
    shape : what an epoch must look like.
    limits : what its values may be.
    operator : (n_raw, n_windows).
    montage : the decoder's channels on the stream.
    spatial : (n_outputs, n_stream), what acts across channels; `with_bad` replaces it.
    unusable : why no epoch can be judged with these electrodes, or None.
    classifier, evidence : None in a calibration, when epochs are only checked.
    """

    session: str
    shape: Shape
    limits: EegConfig
    operator: NDArray[np.float64]
    montage: Montage
    spatial: NDArray[np.float64]
    unusable: str | None
    classifier: LinearClassifier | None
    evidence: Evidence | None

    def with_bad(self, bad: Collection[str]) -> "Judge":
        """The same with these channels repaired from the others; one that rejects every epoch where they can't be."""
        try:
            return replace(self, spatial=self.montage.matrix(bad), unusable=None)
        except SetupError as error:
            return replace(self, unusable=str(error))

    def features(self, result: Epoch | Rejection) -> NDArray[np.float64] | Rejection:
        """The epoch's features, (n_outputs * n_windows,), uV, or why it can't be judged.

        Channels that are bad, or not the decoder's, may deliver anything.
        """
        if isinstance(result, Rejection):
            return result
        if self.unusable is not None:
            return Rejection(self.unusable)
        used = self.spatial.any(axis=0)
        largest = np.maximum(result.data.max(axis=0), -result.data.min(axis=0))[used]  # NaN if any is
        if not np.isfinite(largest).all():
            return Rejection("samples that are not finite numbers")
        if largest.max() > self.limits.max_uv:
            return Rejection(f"{largest.max():.0f} uV is beyond {self.limits.max_uv:.0f} uV")
        vector = features(result.data, self.operator, self.spatial)
        place = int(np.abs(vector).argmax())
        size, most = abs(vector[place]), self.limits.max_band_uv
        if size > most:
            name = self.montage.channels[self.montage.outputs[place // self.operator.shape[1]]]
            return Rejection(f"{size:.0f} uV in the decoder's band at {name} is beyond {most:.0f} uV")
        return vector

    def verdict(self, key: MoveKey, result: Epoch | Rejection, clock_offset: float) -> Verdict:
        """The verdict on a move's epoch, or why there is none."""
        vector = self.features(result)
        if isinstance(vector, Rejection):
            return Verdict(
                session=self.session,
                episode=key[0],
                step=key[1],
                outcome="rejected",
                reason=vector.reason,
                by_time=vector.by_time,
                clock_offset=clock_offset,
            )
        assert isinstance(result, Epoch)
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
    order = fit_stream(model, eeg.name, eeg.picked, eeg.sfreq)
    montage = _montage(len(eeg.picks), info.channels, order, model.eyes)
    shape = Shape(eeg.sfreq, info.n_before, info.n_after)
    return Judge(
        session,
        shape,
        config.eeg,
        model.operator,
        montage,
        montage.matrix(),
        None,
        model.classifier,
        info.evidence,
    )


def judge_without(config: Config, eeg: EegDescription, session: str, eyes: Eyes | None = None) -> Judge:
    """A judge for a calibration: all EEG channels, features but no verdict; ``eyes`` are regressed out."""
    chain = design(config.chain, eeg.sfreq)
    channels = tuple(eeg.picked)
    montage = _montage(len(channels), channels, np.arange(len(channels)), eyes)
    shape = Shape(eeg.sfreq, chain.n_before, chain.n_after)
    return Judge(session, shape, config.eeg, chain_operator(chain), montage, montage.matrix(), None, None, None)


def _montage(n_stream: int, channels: tuple[str, ...], order: NDArray[np.int64], eyes: Eyes | None) -> Montage:
    correction = ocular(eyes.weights, eyes.sources) if eyes else None
    return Montage(n_stream, channels, order, eeg_outputs(channels), correction)
