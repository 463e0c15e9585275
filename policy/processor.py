"""The machine that trains: half-precision matrix products where it has instructions for them, and memory kept."""

import ctypes
import sys
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


_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3  # of glibc's mallopt(3)
_MIB = 1 << 20


def keep_memory() -> None:
    """Keep freed memory in this process instead of handing it back, where the C library is glibc.

    Each step of a training frees and asks for some megabytes; given back to the system, every page of them is a fault
    the next time. Training gains about an eighth.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 32 * _MIB)  # glibc's largest
        mallopt(_M_TRIM_THRESHOLD, 1024 * _MIB)
        mallopt(_M_TOP_PAD, 64 * _MIB)
