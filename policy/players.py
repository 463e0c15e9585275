"""From a name to somebody who plays: a policy of the library or a file, or a baseline."""

from dataclasses import replace
from pathlib import Path

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy import cards, checkpoint, teachers
from policy.baselines import BayesPlayer, OraclePlayer, PlannerPlayer, ReplanningPlayer, SearchPlayer
from policy.evaluation import NetworkPlayer, Player
from policy.simulator import pair_weights
from policy.verdicts import HeldOut, Verdicts

BASELINES = ("bayes", "replan", "planner", "sweep", "oracle")


def player_of(
    name: str, world: GridWorld, draw: Verdicts | HeldOut, folder: Path, accuracy: float = 0.5
) -> tuple[Player, Verdicts | HeldOut]:
    """A player, and the verdicts as it hears them.

    Parameters
    ----------
    name : one of `BASELINES`, or a policy's as `cards.named` knows it.
    draw : verdicts as the decoder gives them.
    accuracy : the decoder's, by which the name ``accuracy`` chooses.

    Raises SetupError when there is no such policy, it is of another map, or it can't hear such verdicts.
    """
    if name in BASELINES:
        return _baseline(name, world, folder), draw
    card = cards.named(name, world, accuracy, folder, f"one of {', '.join(BASELINES)}, ")
    cards.check_fits(card, world)
    assert card.path is not None
    network, _ = checkpoint.load(card.path)
    trained = Verdicts.parse(card.verdicts)
    if trained.kind in ("told", "none"):
        return NetworkPlayer(network, world), draw if trained.kind == "told" else trained
    if isinstance(draw, Verdicts) and draw.taken_for is None and (trained.kind, draw.kind) not in _UNHEARD:
        return NetworkPlayer(network, world), heard(trained, draw)
    raise SetupError(
        f"Policy '{card.name}' takes every verdict for one of {trained} and can't be told otherwise, nor take a "
        f"decoder's own scores for words or words for scores. Choose told, none or one of {', '.join(BASELINES)}."
    )


_UNHEARD = {("score", "binary"), ("score", "rates")}
"""A policy trained on scores that is given words."""


def heard(trained: Verdicts, verdicts: Verdicts) -> Verdicts:
    """Verdicts as a policy hears them: one trained on verdicts of one kind takes all for such, as `ear.Ear` does."""
    match trained.kind:
        case "none":
            return trained
        case "told":
            return verdicts
    if verdicts.kind == "none":
        return replace(trained, missing=1.0)  # it goes on expecting some
    return replace(verdicts.signs() if trained.kind != "score" else verdicts, taken_for=trained)


def _baseline(name: str, world: GridWorld, folder: Path) -> Player:
    match name:
        case "bayes":
            return BayesPlayer(world, pair_weights(world, "pairs"))
        case "sweep":
            return SearchPlayer(teachers.load(folder, world).paths)
        case "replan":
            return ReplanningPlayer(world, pair_weights(world, "pairs"), teachers.load(folder, world).paths)
        case "planner":
            return PlannerPlayer(teachers.load(folder, world).planner, pair_weights(world, "mixture"))
        case _:
            return OraclePlayer(world)
