"""Policy files: weights sealed with the card of the policy."""

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor

from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld
from policy.network import HIDDEN, Actor, Network, PaperNetwork, ToldNetwork
from policy.sealed import Damaged, Tensors, opened, seal
from policy.verdicts import Verdicts

PRETRAINED = Path(__file__).parent / "pretrained"
SUFFIX = ".safetensors"
LAYOUTS = (Network.layout, ToldNetwork.layout, PaperNetwork.layout)
_CARD = "card"
Recipe = Literal["ours", "paper"]
Trained = TypeVar("Trained", bound=Actor)


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


def pack(network: Actor, card: PolicyCard) -> bytes:
    """The contents of a policy file; weights that are float16 numbers, as `rounded` makes them, take half the room."""
    fields = {key: value for key, value in asdict(card).items() if key != "path"}
    weights = {name: _smallest(tensor.contiguous()) for name, tensor in network.state_dict().items()}
    return seal(weights, _CARD, json.dumps(fields, sort_keys=True))


def rounded(network: Trained) -> Trained:
    """The network with its weights rounded to float16, in place; it goes on computing in float32."""
    network.load_state_dict({name: tensor.half().float() for name, tensor in network.state_dict().items()})
    return network


def _smallest(tensor: Tensor) -> Tensor:
    half = tensor.half()
    return half if torch.equal(half.float(), tensor) else tensor


def write(path: Path, contents: bytes) -> None:
    """Write a file whole or not at all: one that is there is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(contents)
    partial.replace(path)


def read_card(path: Path) -> PolicyCard:
    """The card of a policy file; SetupError when it is no policy file."""
    return _opened(_contents(path), str(path), path)[1]


def load(path: Path) -> tuple[Actor, PolicyCard]:
    """Network and card of a policy file; errors as `unpack`'s, and SetupError when there is no such file."""
    return unpack(_contents(path), str(path), path)


def unpack(contents: bytes, name: str, path: Path | None = None) -> tuple[Actor, PolicyCard]:
    """Network and card from the contents of a policy file; ``name`` stands in errors.

    Raises SetupError when it is no policy file, is damaged, or has inputs this program doesn't know.
    """
    tensors, card = _opened(contents, name, path)
    try:
        if card.layout == Network.layout:
            network: Actor = Network(card.n_cells, card.n_hidden)
        elif card.layout == ToldNetwork.layout:
            # The card tells the larger of its two memories.
            network = ToldNetwork(card.n_cells, tensors["listening.recurrent.weight"].shape[1])
        elif card.layout == PaperNetwork.layout and card.n_hidden == HIDDEN:
            network = PaperNetwork(card.n_cells)
        else:
            raise SetupError(
                f"Policy '{name}' must read the inputs {' or '.join(map(repr, LAYOUTS))}, but was trained on "
                f"'{card.layout}'. Use the program version it was trained with, or train it again."
            )
        network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
        if not all(tensor.isfinite().all() for tensor in tensors.values()):
            raise ValueError("some are not finite")
    except (RuntimeError, TypeError, ValueError, LookupError) as error:
        raise SetupError(f"Policy '{name}' has weights of another network ({error}). Train it again.") from error
    return network.eval(), card


def _contents(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SetupError(f"Can't read the policy '{path}' ({error}). Give the path of a policy file.") from error


def _opened(contents: bytes, name: str, path: Path | None) -> tuple[Tensors, PolicyCard]:
    try:
        tensors, text = opened(contents, _CARD)
        card = PolicyCard(**json.loads(text), path=path)
        Verdicts.parse(card.verdicts)
    except (Damaged, AttributeError, TypeError, ValueError, SetupError) as error:
        raise SetupError(
            f"'{name}' must be a policy written by `bci-app train`, but can't be read as one ({error}). Choose another "
            "file or train the policy again."
        ) from error
    return tensors, card


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
