"""Sealed files: what was put in comes out, or nothing does."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save

from policy.sealed import Damaged, opened, seal

TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor([1.5, -2.0]).half(), "c": torch.arange(3)}
CARD = '{"map": "ring", "größe": 1}'
CONTENTS = seal(TENSORS, "card", CARD)


def assert_as_sealed(contents):
    tensors, card = opened(contents, "card")
    assert card == CARD
    assert tensors.keys() == TENSORS.keys()
    for name, tensor in TENSORS.items():
        assert (tensors[name].dtype, tensors[name].shape) == (tensor.dtype, tensor.shape)
        assert torch.equal(tensors[name], tensor)


def test_what_was_put_in_comes_out():
    """The file itself isn't the same each time: safetensors orders its header as it likes."""
    for _ in range(10):
        assert_as_sealed(seal(TENSORS, "card", CARD))


@given(st.integers(0, len(CONTENTS) - 1), st.integers(1, 255))
@settings(max_examples=400, deadline=None)
def test_no_damaged_byte_goes_unseen(position, change):
    damaged = bytearray(CONTENTS)
    damaged[position] ^= change
    try:
        assert_as_sealed(bytes(damaged))  # a blank in the header may be another blank
    except Damaged:
        return
    assert position < CONTENTS.index(b"}}") + 10


@given(st.integers(0, len(CONTENTS) - 1))
@settings(max_examples=50, deadline=None)
def test_a_truncated_file_is_damaged(length):
    with pytest.raises(Damaged):
        opened(CONTENTS[:length], "card")


def test_other_files_say_what_they_lack():
    with pytest.raises(Damaged, match="checksum"):
        opened(save(TENSORS, metadata={"card": CARD, "sha256": "0" * 64}), "card")
    with pytest.raises(Damaged, match="card"):
        opened(save(TENSORS, metadata={"sha256": "0"}), "card")
    with pytest.raises(Damaged, match="metadata"):
        opened(save(TENSORS), "card")
    with pytest.raises(Damaged, match="sha256"):
        opened(save(TENSORS, metadata={"card": CARD}), "card")
