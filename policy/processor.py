"""What the processor can do: half-precision matrix products where it has instructions for them."""

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any

import torch


@cache
def has_bfloat16() -> bool:
    """Whether products of bfloat16 numbers are computed as such; elsewhere they are slower than of float32."""
    return bool(torch.cpu._is_avx512_bf16_supported())


def mixed_precision() -> AbstractContextManager[Any]:
    """Matrix products in bfloat16 within it, where that is faster: training gains a factor of two to three.

    Only training and the planner use it. A policy that is evaluated or runs live computes in float32.
    """
    return torch.autocast("cpu", torch.bfloat16) if has_bfloat16() else nullcontext()
