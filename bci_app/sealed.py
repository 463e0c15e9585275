"""Files of numbers with a card in words and a checksum over both: safetensors, which can't run code.

Format: https://huggingface.co/docs/safetensors. The checksum stands in the header, which neither the data nor the
table of tensors depends on.
"""

import hashlib
import json
from collections.abc import Callable

_SUM = "sha256"


class Damaged(Exception):
    """It isn't such a file, or not a whole one; says why."""


def seal(serialize: Callable[[dict[str, str]], bytes], key: str, card: str) -> bytes:
    """The contents of a file with the card under a key; ``serialize`` makes them from the words in its header."""
    return serialize({key: card, _SUM: _checksum(serialize({key: card}), card)})


def card_of(contents: bytes, key: str) -> str:
    """The card of a file. Raises Damaged unless every byte is as it was sealed."""
    try:
        words = _header(contents)["__metadata__"]
        card, expected = words[key], words[_SUM]
        found = _checksum(contents, card)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise Damaged(f"{type(error).__name__}: {error}") from error
    if found != expected:
        raise Damaged("its checksum is not that of its contents")
    return card


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
