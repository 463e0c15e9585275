"""The whole linear chain as one matrix on each side of an epoch: what calibration, live and replay call.

Resampling, FIR and window means act on each channel alone and are linear, so pushing the identity through the readable
chain of `decoder.chain` gives a matrix; what acts across channels (`decoder.spatial`: repair of bad channels, ocular
correction, common average) is a matrix too. The two commute, and time first leaves little for the second:

    features = spatial @ (raw.T @ operator)

There is no filter state, so the result can't depend on how the samples were chunked.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

from decoder.chain import Chain, band_pass, centred, resample, window_means

Array = NDArray[np.float64]

_COLUMNS = 512  # of the identity at a time: bounds the memory at high rates
_MAX_PRODUCT = 200_000
"""Multiplications a matrix product. OpenBLAS spreads larger ones (from 262,144) over threads, and then the last bits
depend on how many threads there are."""
_MAX_VECTOR = 9_000
"""The same for a matrix times a vector: OpenBLAS keeps those below 9,216 on one thread."""

_STRETCHES = 16  # of an epoch at a time: few calls, and results that fit the processor's cache


def chain_operator(chain: Chain) -> Array:
    """The operator of a chain: float64, (n_raw, n_windows), C-contiguous."""
    rows = []
    for start in range(0, chain.n_raw, _COLUMNS):
        impulses = np.eye(chain.n_raw, min(_COLUMNS, chain.n_raw - start), -start)
        rows.append(window_means(band_pass(resample(centred(impulses), chain), chain), chain))
    return np.ascontiguousarray(np.concatenate(rows))


def features(epoch: NDArray[np.floating], operator: Array, spatial: Array) -> Array:
    """Features of one epoch.

    Parameters
    ----------
    epoch : (n_raw, n_channels), uV.
    operator : float64, (n_raw, n_windows), C-contiguous.
    spatial : float64, (n_outputs, n_channels), C-contiguous. A channel whose column is all zeros is unused: it leaves
        no trace even if it delivers NaN.

    Returns
    -------
    float64, (n_outputs * n_windows,), uV, output by output: feature ``c * n_windows + w`` is window `w` of output `c`.

    Notes
    -----
    Always one epoch at a time, in the same layout, so that the same samples give the same bits whoever asks.
    """
    with np.errstate(invalid="ignore"):  # an unused channel may deliver infinities, and those times zero are invalid
        means = _through_time(np.ascontiguousarray(epoch, dtype=np.float64), operator)
    means[:, ~spatial.any(axis=0)] = 0.0
    return _across_channels(means, spatial).reshape(-1)


def _through_time(data: Array, operator: Array) -> Array:
    """``operator.T @ data``, (n_windows, n_channels), as a sum over equally long stretches and what is left of them.

    This way round the product runs along the rows of the data, as they lie in memory; many stretches are one call.
    """
    (n_raw, n_windows), n_channels = operator.shape, data.shape[1]
    n_stretches = -(-n_raw // _rows(n_windows, n_channels))
    length = n_raw // n_stretches
    whole = n_stretches * length
    weights = operator[:whole].reshape(n_stretches, length, n_windows).transpose(0, 2, 1)
    stretches = data[:whole].reshape(n_stretches, length, n_channels)
    means: Array = operator[whole:].T @ data[whole:]
    for start in range(0, n_stretches, _STRETCHES):
        means += (weights[start : start + _STRETCHES] @ stretches[start : start + _STRETCHES]).sum(axis=0)
    return means


def _across_channels(means: Array, spatial: Array) -> Array:
    """``spatial @ means.T``, (n_outputs, n_windows), some outputs at a time."""
    rows = _rows(*means.shape)
    mixed = np.empty((len(spatial), len(means)))
    for start in range(0, len(spatial), rows):
        mixed[start : start + rows] = spatial[start : start + rows] @ means.T
    return mixed


def _rows(n: int, m: int) -> int:
    """How many rows a product may have whose two other sides are `n` and `m`."""
    return max(1, (_MAX_PRODUCT if min(n, m) > 1 else _MAX_VECTOR) // (n * m))


def digest(feature_vector: Array) -> str:
    """First 16 hex digits of the SHA-256 of the features as little-endian float64: a verdict's fingerprint."""
    return hashlib.sha256(feature_vector.astype("<f8").tobytes()).hexdigest()[:16]
