"""Files of tensors with a card in words and a checksum over both: safetensors, which can't run code."""

import hashlib
import json

import torch
from safetensors import SafetensorError
from safetensors.torch import load as deserialize
from safetensors.torch import save as serialize

Tensors = dict[str, torch.Tensor]
_SUM = "sha256"


class Damaged(Exception):
    """It isn't such a file, or not a whole one; says why."""


def seal(tensors: Tensors, key: str, card: str) -> bytes:
    """The contents of a file with the card under a key."""
    # The checksum stands in the header, which the data and the table of tensors don't depend on.
    unsealed = serialize(tensors, metadata={key: card})
    contents: bytes = serialize(tensors, metadata={key: card, _SUM: _checksum(unsealed, card)})
    return contents


def opened(contents: bytes, key: str) -> tuple[Tensors, str]:
    """Tensors and card. Raises Damaged unless every byte is as it was sealed."""
    try:
        tensors = deserialize(contents)
        texts = _header(contents)["__metadata__"]
        card, expected = texts[key], texts[_SUM]
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise Damaged(str(error)) from error
    if _checksum(contents, card) != expected:
        raise Damaged("its checksum is not that of its contents")
    return tensors, card


def _checksum(contents: bytes, card: str) -> str:
    table = {name: entry for name, entry in _header(contents).items() if name != "__metadata__"}
    data = contents[_data_start(contents) :]
    return hashlib.sha256(json.dumps([card, table], sort_keys=True).encode() + data).hexdigest()


def _header(contents: bytes) -> dict[str, dict[str, str]]:
    """A safetensors header: 8 bytes of length, then JSON."""
    header: dict[str, dict[str, str]] = json.loads(contents[8 : _data_start(contents)])
    return header


def _data_start(contents: bytes) -> int:
    return 8 + int.from_bytes(contents[:8], "little")
