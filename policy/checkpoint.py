"""Policy files: weights sealed with the card of the policy."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from bci_app.errors import SetupError
from bci_app.whole import renew
from policy.cards import CARD, PolicyCard, card_in, contents_of, no_policy
from policy.network import HIDDEN, Actor, Network, PaperNetwork, ToldNetwork
from policy.sealed import Damaged, Tensors, opened, seal

LAYOUTS = (Network.layout, ToldNetwork.layout, PaperNetwork.layout)
Trained = TypeVar("Trained", bound=Actor)


def pack(network: Actor, card: PolicyCard) -> bytes:
    """The contents of a policy file; weights that are float16 numbers, as `rounded` makes them, take half the room."""
    fields = {key: value for key, value in asdict(card).items() if key != "path"}
    weights = {name: _smallest(tensor.contiguous()) for name, tensor in network.state_dict().items()}
    return seal(weights, CARD, json.dumps(fields, sort_keys=True))


def rounded(network: Trained) -> Trained:
    """The network with its weights rounded to float16, in place; it goes on computing in float32."""
    network.load_state_dict({name: tensor.half().float() for name, tensor in network.state_dict().items()})
    return network


def _smallest(tensor: Tensor) -> Tensor:
    half = tensor.half()
    return half if torch.equal(half.float(), tensor) else tensor


def write(path: Path, contents: bytes) -> None:
    """Write a file or put another in its place, whole or not at all, and the folders it lies in."""
    path.parent.mkdir(parents=True, exist_ok=True)
    renew(path, contents)


def load(path: Path) -> tuple[Actor, PolicyCard]:
    """Network and card of a policy file; errors as `unpack`'s, and SetupError when there is no such file."""
    return unpack(contents_of(path), str(path), path)


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


def _opened(contents: bytes, name: str, path: Path | None) -> tuple[Tensors, PolicyCard]:
    card = card_in(contents, name, path)
    try:
        return opened(contents, CARD)[0], card
    except Damaged as error:
        raise no_policy(name, error) from error
