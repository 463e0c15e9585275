"""The policies of one map in a folder, by what they were trained with; those that are missing are noted, not missed."""

from pathlib import Path
from typing import Literal

from bci_app.gridworld import GridWorld
from policy import cards, checkpoint, teachers
from policy.baselines import SearchPlayer
from policy.cards import PolicyCard, policy_name
from policy.evaluation import NetworkPlayer, Player
from policy.network import Actor
from policy.verdicts import Verdicts

Series = Literal["ours", "told", "paper"]
"""Our policy of an accuracy, ours that is told the accuracy, and the paper recipe's of an accuracy."""


class Shelf:
    """The policies of one map in a folder.

    Attributes
    ----------
    absent : names of policies and of a teacher that were asked for and aren't there.
    without_curve : names of policies that are there but tell no learning curve.
    """

    def __init__(self, folder: Path, world: GridWorld) -> None:
        self.folder, self.world = folder, world
        self.absent: list[str] = []
        self.without_curve: list[str] = []

    def policy(self, series: Series, accuracy: float | None) -> tuple[Actor, PolicyCard] | None:
        """A policy, or None where it is absent. SetupError when it can't be read or is of another map."""
        kind = Verdicts("told") if series == "told" else verdicts_of(accuracy)
        name = policy_name(self.world.name, kind, "paper" if series == "paper" else "ours")
        path = self.folder / f"{name}{cards.SUFFIX}"
        if not path.is_file():
            self._note(self.absent, name)
            return None
        network, card = checkpoint.load(path)
        cards.check_fits(card, self.world)
        return network, card

    def player(self, series: Series, trained: float | None) -> tuple[Player, Verdicts] | None:
        """Who plays, and the verdicts it was trained with."""
        found = self.policy(series, trained)
        return found and (NetworkPlayer(found[0], self.world), Verdicts.parse(found[1].verdicts))

    def curve(self, series: Series, accuracy: float | None) -> list[list[float]]:
        """Moves and mean steps in training; empty where its card doesn't tell."""
        found = self.policy(series, accuracy)
        if not found:
            return []
        curve: list[list[float]] = found[1].story.get("curve", [])
        if not curve:
            self._note(self.without_curve, found[1].name)
        return curve

    def search(self) -> Player | None:
        """The search without verdicts, or None where the map's teacher is absent."""
        path = teachers.path_of(self.folder, self.world)
        if not path.is_file():
            self._note(self.absent, path.name.removesuffix(cards.SUFFIX))
            return None
        return SearchPlayer(teachers.load(self.folder, self.world).paths)

    def _note(self, names: list[str], name: str) -> None:
        if name not in names:
            names.append(name)


def verdicts_of(accuracy: float | None) -> Verdicts:
    """Binary verdicts of an accuracy, or none."""
    return Verdicts("none") if accuracy is None else Verdicts("binary", (accuracy,))
