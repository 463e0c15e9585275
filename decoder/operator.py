"""The whole linear chain as one matrix an epoch: `features(epoch, operator)` is what calibration, live and replay call.

Resampling, FIR and window means act on each channel alone and are linear, so pushing the identity through the readable
chain of `decoder.chain` gives a matrix; the common average acts across channels only, so the two commute:

    features = raw.T @ operator, minus its mean over channels

There is no filter state, so the result can't depend on how the samples were chunked.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

from decoder.chain import Chain, band_pass, common_average, resample, window_means

Array = NDArray[np.float64]

_COLUMNS = 512  # of the identity at a time: bounds the memory at high rates
_MAX_PRODUCT = 200_000
"""Multiplications a matrix product. OpenBLAS spreads larger ones (from 262,144) over threads, and then the last bits
depend on how many threads there are."""


def chain_operator(chain: Chain) -> Array:
    """The operator of a chain: float64, (n_raw, n_windows), C-contiguous."""
    rows = []
    for start in range(0, chain.n_raw, _COLUMNS):
        impulses = np.eye(chain.n_raw, min(_COLUMNS, chain.n_raw - start), -start)
        rows.append(window_means(band_pass(resample(impulses, chain), chain), chain))
    return np.ascontiguousarray(np.concatenate(rows))


def features(epoch: NDArray[np.floating], operator: Array) -> Array:
    """Features of one epoch.

    Parameters
    ----------
    epoch : (n_raw, n_channels), uV.
    operator : float64, (n_raw, n_windows).

    Returns
    -------
    float64, (n_channels * n_windows,), uV, channel by channel: feature ``c * n_windows + w`` is window `w` of
    channel `c`.

    Notes
    -----
    Always one epoch at a time, in the same layout, so that the same samples give the same bits whoever asks.
    """
    data = np.ascontiguousarray(epoch, dtype=np.float64)
    rows = max(1, _MAX_PRODUCT // (data.shape[1] * operator.shape[1]))
    means = np.zeros((data.shape[1], operator.shape[1]))
    for start in range(0, len(data), rows):
        means += data[start : start + rows].T @ operator[start : start + rows]
    return np.ascontiguousarray(common_average(means.T).T).reshape(-1)


def digest(feature_vector: Array) -> str:
    """First 16 hex digits of the SHA-256 of the features as little-endian float64: a verdict's fingerprint."""
    return hashlib.sha256(feature_vector.astype("<f8").tobytes()).hexdigest()[:16]
