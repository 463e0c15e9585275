"""Cards of policies: what each is for, which there are, and which suits a decoder. Reads no weights, needs no torch."""

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from bci_app.sealed import Damaged, card_of
from policy.verdicts import Verdicts

PRETRAINED = Path(__file__).parent / "pretrained"
SUFFIX = ".safetensors"
CARD = "card"
"""Key of the card in the file's header."""
Recipe = Literal["ours", "paper"]


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is for and how it came about.

    Attributes
    ----------
    map, map_digest : name and SHA-256 of the map it was trained on.
    verdicts : what it was trained with, as `Verdicts` in words: none, binary:P, or told for any decoder.
    recipe : ours or the paper's.
    layout : name of its inputs, and so its network.
    n_cells, n_hidden : sizes of the network.
    story : settings, versions and figures; free-form, for people.
    path : the file it was read from; not stored.
    """

    map: str
    map_digest: str
    verdicts: str
    recipe: Recipe
    layout: str
    n_cells: int
    n_hidden: int
    story: dict[str, Any]
    path: Path | None = None

    @property
    def name(self) -> str:
        """Name of its file without the ending."""
        return policy_name(self.map, Verdicts.parse(self.verdicts), self.recipe)

    @property
    def accuracy(self) -> float | None:
        """Accuracy of the binary verdicts it was trained with, if it was."""
        verdicts = Verdicts.parse(self.verdicts)
        return verdicts.numbers[0] if verdicts.kind == "binary" else None


def policy_name(map_name: str, verdicts: Verdicts, recipe: Recipe = "ours") -> str:
    """The map; then ``none``, ``told``, the accuracy of binary verdicts in percent or the kind with its numbers."""
    percent = "-".join(f"{number * 100:.4f}".rstrip("0").rstrip(".").zfill(3) for number in verdicts.numbers)
    kind = percent if verdicts.kind == "binary" else verdicts.kind + percent
    return f"{map_name}_{kind}" + ("_paper" if recipe == "paper" else "")


def contents_of(path: Path) -> bytes:
    """What a file holds. Raises SetupError where it can't be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise SetupError(f"Can't read the policy '{path}' ({error}). Give the path of a policy file.") from error


def read_card(path: Path) -> PolicyCard:
    """The card of a policy file; SetupError when it is no policy file, or not as it was written."""
    return card_in(contents_of(path), str(path), path)


def card_in(contents: bytes, name: str, path: Path | None = None) -> PolicyCard:
    """The card in the contents of a policy file; ``name`` stands in errors. Raises as `read_card`."""
    try:
        card = PolicyCard(**json.loads(card_of(contents, CARD)), path=path)
        Verdicts.parse(card.verdicts)
    except (Damaged, AttributeError, TypeError, ValueError, SetupError) as error:
        raise no_policy(name, error) from error
    return card


def no_policy(name: str, error: Exception) -> SetupError:
    """What is said of a file that is no policy."""
    return SetupError(
        f"'{name}' must be a policy written by `bci-app train`, but can't be read as one ({error}). Choose another "
        "file or train the policy again."
    )


def check_fits(card: PolicyCard, world: GridWorld) -> None:
    """Raise SetupError unless the policy was trained on this very map."""
    if card.map_digest != world.digest:
        raise SetupError(
            f"Policy '{card.name}' was trained on map '{card.map}' (digest {card.map_digest[:12]}), but the session's "
            f"map is '{world.name}' (digest {world.digest[:12]}). Choose a policy of this map or train one: "
            f"bci-app train --map {world.name}"
        )


def library(folder: Path = PRETRAINED) -> list[PolicyCard]:
    """Cards of all policies in a folder, by default the shipped ones, ordered by file name."""
    return [read_card(path) for path in sorted(folder.glob(f"*{SUFFIX}")) if not path.stem.endswith("_teacher")]


def named(name: str, world: GridWorld, accuracy: float, folder: Path = PRETRAINED, others: str = "") -> PolicyCard:
    """The policy that is called so.

    Parameters
    ----------
    name : a policy file; ``told``; ``none``; ``accuracy``, the one trained nearest to the decoder's; a number, the one
        trained nearest to that; or the name of a file in `folder`, with or without the map before it.
    accuracy : the decoder's.
    others : what else a name may be, for the message.

    Raises SetupError when there is none. That it is of this map must still be looked at (`check_fits`).
    """
    if Path(name).is_file():
        return read_card(Path(name))
    match name:
        case "none":
            return choose_without(world, folder)
        case "told":
            return choose_told(world, folder)
        case "accuracy":
            return choose_by_accuracy(accuracy, world, folder)
    for stem in (name, f"{world.name}_{name}"):
        path = folder / f"{stem}{SUFFIX}"
        if path.is_file():
            return read_card(path)
    with suppress(ValueError):
        if 0.5 < float(name) <= 1:
            return choose_by_accuracy(float(name), world, folder)
    known = ", ".join(sorted(card.name for card in library(folder)))
    raise SetupError(
        f"No policy '{name}': expected a policy file, told, accuracy, none, the accuracy one was trained at (above 0.5 "
        f"and at most 1, as 0.75), {others}or of {folder}: {known or 'none there'}."
    )


def choose_told(world: GridWorld, folder: Path = PRETRAINED) -> PolicyCard:
    """The policy of this map that is told its decoder's statistics. Raises SetupError when there is none."""
    return _of_kind("told", world, folder)


def choose_without(world: GridWorld, folder: Path = PRETRAINED) -> PolicyCard:
    """The policy of this map without verdicts. Raises SetupError when there is none."""
    return _of_kind("none", world, folder)


def choose_by_accuracy(accuracy: float, world: GridWorld, folder: Path = PRETRAINED) -> PolicyCard:
    """The policy of this map trained at the accuracy nearest to the decoder's (paper V.B.2: 78 % -> 0.80).

    Of two equally near the lower one: it trusts the verdicts less. Raises SetupError when there is none.
    """
    trained = [(card.accuracy, card) for card in _fitting(world, folder) if card.accuracy is not None]
    # Rounded, for 0.75 - 0.725 and 0.725 - 0.70 differ in binary.
    trained.sort(key=lambda item: (round(abs(item[0] - accuracy), 9), item[0]))
    return _first([card for _, card in trained], world, "binary:0.75", folder)


def _of_kind(verdicts: str, world: GridWorld, folder: Path) -> PolicyCard:
    """The file that is named so, if it is of this map; else any other. One that is damaged beside it does no harm."""
    path = folder / f"{policy_name(world.name, Verdicts.parse(verdicts))}{SUFFIX}"
    if path.exists():
        card = read_card(path)
        if card.map_digest == world.digest:
            return card
    return _first([card for card in _fitting(world, folder) if card.verdicts == verdicts], world, verdicts, folder)


def _fitting(world: GridWorld, folder: Path) -> list[PolicyCard]:
    return [card for card in library(folder) if card.map_digest == world.digest and card.recipe == "ours"]


def _first(cards: list[PolicyCard], world: GridWorld, verdicts: str, folder: Path) -> PolicyCard:
    if cards:
        return cards[0]
    raise SetupError(
        f"No policy of the kind '{verdicts}' for map '{world.name}' in {folder}. Train one: bci-app train --map "
        f"{world.name} --verdicts {verdicts} --out {folder}"
    )
