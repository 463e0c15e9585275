"""The machine that trains: its accelerator, half-precision matrix products, memory kept."""

import ctypes
import sys
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any, TypeVar

import torch
from torch import Tensor

Tensors = TypeVar("Tensors", bound=tuple[Tensor, ...] | Tensor)


@cache
def device() -> torch.device:
    """Where networks are trained: on CUDA when present. The simulator and all randomness stay on the processor."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def moved(tensors: Tensors) -> Tensors:
    """A tensor, or a named tuple of some, on the device that trains; what is there already isn't copied."""
    there: Any = tensors.to(device()) if isinstance(tensors, Tensor) else type(tensors)(*map(moved, tensors))
    return there  # type: ignore[no-any-return]


@cache
def has_bfloat16() -> bool:
    """Whether products of bfloat16 numbers are computed as such; elsewhere they are slower than of float32."""
    return bool(torch.cpu._is_avx512_bf16_supported())


def mixed_precision() -> AbstractContextManager[Any]:
    """Matrix products in bfloat16 within it, where that is faster: training gains a factor of two to three.

    Only training and the planner use it. A policy that is evaluated or runs live computes in float32.
    """
    return torch.autocast(device().type, torch.bfloat16) if arithmetic() == "bfloat16" else nullcontext()


def arithmetic() -> str:
    """What matrix products are trained in here. The same seed gives the same weights only in the same arithmetic, and
    on CUDA only nearly the same, for it adds in any order."""
    fast = torch.cuda.is_bf16_supported(including_emulation=False) if device().type == "cuda" else has_bfloat16()
    return "bfloat16" if fast else "float32"


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
