"""The decoder's linear chain, readable: resample, band-pass, common average, window means (paper V.A.3-4).

One stretch of raw EEG goes in, one row of features a channel comes out. `decoder.operator` turns the very same chain
into one matrix; this module is its documentation and the oracle of its tests.
"""

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from bci_app.config import ChainConfig
from bci_app.errors import SetupError

Array = NDArray[np.float64]

RESAMPLER_REACH = 10
"""Half length of scipy's (and so MNE's) polyphase low-pass, in periods of the slower of the two rates."""
PAD = "line"
"""Beyond its ends the stretch goes on along the line through its first and last sample, so that neither an electrode's
offset of millivolts nor a drift makes an edge. Same word, same result as MNE's `resample(method="polyphase", pad=)`."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A chain designed for one sampling rate.

    Attributes
    ----------
    config : the settings.
    sfreq : float, rate of the raw EEG, Hz.
    up, down : int, the resampling ratio as a fraction in lowest terms.
    taps : float64, (n_taps,), the band-pass at ``config.sfreq``.
    n_before : int, raw samples needed before the onset's sample.
    n_after : int, raw samples needed from the onset's sample on (it counts as the first).
    windows : one ``slice`` a window, into the grid of ``config.sfreq`` that starts at the stretch's first raw sample.
    """

    config: ChainConfig
    sfreq: float
    up: int
    down: int
    taps: Array
    n_before: int
    n_after: int
    windows: tuple[slice, ...]

    @property
    def n_raw(self) -> int:
        """Raw samples in a stretch."""
        return self.n_before + self.n_after

    @property
    def delay(self) -> int:
        """Samples of ``config.sfreq`` by which the filter's output is moved back: 0 for minimum phase."""
        return (len(self.taps) - 1) // 2 if self.config.phase == "linear" else 0


def design(config: ChainConfig, sfreq: float) -> Chain:
    """Design the chain for EEG sampled at `sfreq` Hz. Raises SetupError when that is too slow for the band-pass."""
    if not config.low_hz < config.high_hz < min(config.sfreq, sfreq) / 2:
        raise SetupError(
            f"The band-pass {config.low_hz:g}-{config.high_hz:g} Hz must lie below half of the chain's rate "
            f"({config.sfreq:g} Hz) and of the EEG's ({sfreq:g} Hz). Change chain.low_hz, chain.high_hz or "
            "the amplifier's rate."
        )
    ratio = _exact(config.sfreq) / _exact(sfreq)
    taps = band_pass_taps(config)
    n_before, n_after = stretch(config, sfreq, len(taps))
    windows = _windows(config, Fraction(n_before) / _exact(sfreq))
    return Chain(config, sfreq, ratio.numerator, ratio.denominator, taps, n_before, n_after, windows)


def band_pass_taps(config: ChainConfig) -> Array:
    """MNE's default FIR: Hamming-windowed, transition bands of 1 and 12.5 Hz for 1-50 Hz; 845 taps at 256 Hz."""
    # MNE is slow to import, and a decoder that loads a model file never designs a filter.
    from mne.filter import create_filter

    taps = create_filter(None, config.sfreq, config.low_hz, config.high_hz, phase=config.phase, verbose="error")
    return np.asarray(taps, dtype=np.float64)


def look_back_s(config: ChainConfig, sfreq: float) -> float:
    """Seconds of EEG before the onset's sample that the features depend on, without designing the chain.

    The FIR's length is MNE's rule: 3.3 periods of the narrower transition band, which is a quarter of the edge's
    frequency, but 2 Hz at least and no wider than there is room.
    """
    low = min(max(config.low_hz / 4, 2.0), config.low_hz)
    high = min(max(config.high_hz / 4, 2.0), config.sfreq / 2 - config.high_hz)
    n_taps = ceil(round(3.3 / min(low, high), 10) * config.sfreq)
    return stretch(config, sfreq, n_taps + 1 - n_taps % 2)[0] / sfreq


def stretch(config: ChainConfig, sfreq: float, n_taps: int) -> tuple[int, int]:
    """``(n_before, n_after)``: the raw samples around the onset's sample that the features depend on.

    The stretch begins early enough for the filter's full support behind the first window plus the resampler's reach.
    It ends with the last window for minimum phase, so that the verdict is ready then: the resampler's reach past
    that end (39 ms at 500 Hz) is padded. Linear phase waits for half the filter and for the resampler.
    """
    rate, grid = _exact(sfreq), _exact(config.sfreq)
    first, last = _exact(config.start_ms) / 1000, _end_ms(config) / 1000
    reach = 0 if rate == grid else RESAMPLER_REACH / min(rate, grid)
    look_ahead = Fraction((n_taps - 1) // 2) / grid + reach if config.phase == "linear" else Fraction(0)
    look_back = Fraction(n_taps if config.phase == "minimum" else (n_taps + 1) // 2) / grid + reach
    n_before, n_after = max(0, ceil((look_back - first) * rate)), max(1, ceil((last + look_ahead) * rate))
    return n_before + _fill(n_before + n_after, (grid / rate).denominator, sfreq), n_after


def _fill(n_raw: int, down: int, sfreq: float) -> int:
    """Samples to add before the stretch so that the grid's end falls on a raw sample's.

    MNE resamples by the rounded ratio of lengths, so only then does it give the grid asked for. Odd rates such as
    499.7 Hz, where that takes more than a second, do without.
    """
    return -n_raw % down if down <= sfreq else 0


def reference_features(raw: Array, chain: Chain) -> Array:
    """Features of one stretch: (n_raw, n_channels) in uV -> (n_channels, n_windows) in uV."""
    grid = resample(centred(np.asarray(raw, dtype=np.float64)), chain)
    return window_means(common_average(band_pass(grid, chain)), chain)


def centred(raw: Array) -> Array:
    """A stretch less its mean, (n_times, n_channels): of an electrode's offset, a thousand times larger than EEG and
    changing within the hour, polyphase filtering would leave a ripple of up to 0.07 %, locked to the onset."""
    less: Array = raw - raw.mean(axis=0)
    return less


def resample(raw: Array, chain: Chain) -> Array:
    """To the chain's rate by polyphase filtering; the grid's first sample is the stretch's first raw sample."""
    resampled: Array = signal.resample_poly(raw, chain.up, chain.down, axis=0, padtype=PAD)
    return resampled


def band_pass(grid: Array, chain: Chain) -> Array:
    """FIR band-pass, its linear-phase delay taken back; samples whose support leaves the stretch see zeros there."""
    filtered: Array = signal.convolve(grid, chain.taps[:, None], mode="full")
    return filtered[chain.delay : chain.delay + len(grid)]


def common_average(samples: Array) -> Array:
    """Subtract the mean over channels from every sample; (n_times, n_channels)."""
    centred: Array = samples - samples.mean(axis=1, keepdims=True)
    return centred


def window_means(grid: Array, chain: Chain) -> Array:
    """Mean of each window: (n_grid, n_channels) -> (n_channels, n_windows)."""
    return np.stack([grid[window].mean(axis=0) for window in chain.windows], axis=1)


def _windows(config: ChainConfig, onset: Fraction) -> tuple[slice, ...]:
    """Half-open windows [t, t + window_ms) after `onset` (s from the grid's start), in exact arithmetic."""
    start, width, grid = _exact(config.start_ms) / 1000, _exact(config.window_ms) / 1000, _exact(config.sfreq)
    edges = [ceil((onset + start + i * width) * grid) for i in range(config.n_windows + 1)]
    if any(a == b for a, b in pairwise(edges)):
        raise SetupError(
            f"Windows of {config.window_ms:g} ms hold no sample at {config.sfreq:g} Hz. Raise chain.window_ms."
        )
    return tuple(slice(a, b) for a, b in pairwise(edges))


def _end_ms(config: ChainConfig) -> Fraction:
    return _exact(config.start_ms) + config.n_windows * _exact(config.window_ms)


def _exact(number: float) -> Fraction:
    """The fraction a person means by a decimal: 0.1 is 1/10. Denominators up to 1000 keep the ratio of rates small."""
    return Fraction(str(number)).limit_denominator(1000)
