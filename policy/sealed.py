"""Sealed files (`bci_app.sealed`) of torch's tensors."""

import torch
from safetensors import SafetensorError
from safetensors.torch import load as deserialize
from safetensors.torch import save as serialize

from bci_app import sealed
from bci_app.sealed import Damaged as Damaged

Tensors = dict[str, torch.Tensor]


def seal(tensors: Tensors, key: str, card: str) -> bytes:
    """The contents of a file with the card under a key."""
    return sealed.seal(lambda words: serialize(tensors, metadata=words), key, card)


def opened(contents: bytes, key: str) -> tuple[Tensors, str]:
    """Tensors and card. Raises Damaged unless every byte is as it was sealed."""
    card = sealed.card_of(contents, key)
    try:
        return deserialize(contents), card
    except (SafetensorError, KeyError, ValueError) as error:
        raise Damaged(str(error)) from error
