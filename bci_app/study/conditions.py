"""From a participant's decoder to what a condition plays with: which policy, what it is told, and why."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bci_app.config import ClassifierConfig, Config, PolicyConfig, changed
from bci_app.gridworld import GridWorld
from bci_app.study.plan import Condition
from decoder import model
from decoder.calibration import Calibration, contiguous_folds, held_out_log_odds
from decoder.classifier import LinearClassifier, fit
from policy import cards

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Choice:
    """What a condition plays with.

    Attributes
    ----------
    policy : its file.
    name : of the policy.
    listens : whether it hears verdicts at all.
    reason : why this one, in words.
    """

    policy: Path
    name: str
    listens: bool
    reason: str


def choose(
    condition: Condition, info: "model.ModelInfo", settings: PolicyConfig, papers_gate: float, world: GridWorld
) -> Choice:
    """The policy of a condition, by the cross-validated statistics of the decoder it plays with.

    The paper's rule goes by the plain accuracy in stratified tenfold cross-validation, as the paper does; ours by the
    balanced accuracy over contiguous folds.

    Raises SetupError where the map has no such policy.
    """
    accuracy, balanced = float(info.tenfold["accuracy"]["value"]), float(info.blocked["balanced_accuracy"]["value"])
    if condition == "none":
        return _choice(cards.choose_without(world), "no ErrP")
    if condition == "paper":
        if accuracy < papers_gate:
            return _choice(cards.choose_without(world), f"{accuracy:.1%} is below the paper's gate")
        return _choice(cards.choose_by_accuracy(accuracy, world), f"trained nearest to {accuracy:.1%}")
    if balanced < settings.gate_accuracy:
        return _choice(cards.choose_without(world), f"{balanced:.1%} is below our gate")
    return _choice(cards.choose_told(world), f"told {info.evidence.information:.2f} bits a verdict")


def _choice(card: cards.PolicyCard, reason: str) -> Choice:
    assert card.path is not None
    return Choice(card.path, card.name, card.verdicts != "none", reason)


def papers(config: Config) -> Config:
    """With the paper's classifier: the condition that follows its rule decodes as the paper did."""
    return changed(config, {"classifier": {"covariance": "ledoit-wolf", "estimator": None}})


def coin(
    fitted: model.DecoderModel,
    calibration: Calibration,
    features: "NDArray[np.float64]",
    error: "NDArray[np.bool_]",
    config: ClassifierConfig,
    seed: int,
) -> model.DecoderModel:
    """The same decoder, but for a classifier that learnt from shuffled truths: its verdicts are tosses of a coin.

    Its log odds are as large as those of the true one and called errors as often, and whoever is told of it is told
    what the true one is worth: all that is missing is that they have to do with the moves.
    """
    n_windows, tosses = fitted.info.chain.n_windows, np.random.default_rng(seed).permutation(error)
    shuffled = fit(features, tosses, config, n_windows)
    # As large on moves that neither of the two has seen.
    tossed = held_out_log_odds(features, tosses, config, contiguous_folds(tosses, config), n_windows)
    said = calibration.blocked_log_odds
    scale = float(said.std() / tossed.std())
    bias = float(said.mean() - scale * (tossed.mean() - shuffled.bias))
    classifier = LinearClassifier(shuffled.weights * scale, bias)
    return model.DecoderModel(
        fitted.info, fitted.operator, classifier, fitted.eyes, fitted.held_out_log_odds, fitted.held_out_error
    )
