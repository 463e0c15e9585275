"""EEG without events, to be answered in by the simulated participant: made up, or a recording in a loop."""

from collections import OrderedDict
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from bci_app.errors import SetupError
from decoder.montage import MONTAGE_64, directions

Array = NDArray[np.float64]

BLOCK_S = 8.0
"""Seconds of synthetic EEG made at a time."""
ONE_OVER_F_UV = 5.0
"""Root mean square of the 1/f part between 1 and 50 Hz, uV; awake scalp EEG has 5-15 (decided)."""
ALPHA_UV = 5.0
"""Root mean square of alpha at its strongest electrode, uV (decided)."""
BLINK_UV = 100.0
"""Mean height of a blink at Fpz, uV; 50-200 are usual (Hagemann & Naumann 2001, doi:10.1016/S1388-2457(01)00513-3)."""
BLINKS_A_MINUTE = 10.0
"""Blinks a minute while looking at a screen (decided; 10-20 are usual at rest)."""
LINE_UV = 2.0
"""Mean amplitude of 50 Hz line noise, uV (decided)."""
OFFSET_UV = 5000.0
"""Standard deviation of electrode offsets, uV; millivolts are usual for DC-coupled amplifiers."""
DRIFT_UV = 60.0
"""Mean amplitude of each slow electrode drift, uV (decided)."""
CROSS_FADE_S = 1.0
"""Seconds over which the end of a looped recording fades into its beginning."""


class Background(Protocol):
    """EEG that can be asked for at any place: the same samples give the same values, in any chunks."""

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""

    @property
    def sfreq(self) -> float:
        """Rate, Hz."""

    def samples(self, start: int, n_times: int) -> Array:
        """Samples from number `start` >= 0 on: float64, (n_times, n_channels), uV."""


def moment(seed: int, run: int) -> int:
    """Seed of what differs from run to run of one person; the person's own seed in run 0."""
    return int(np.random.default_rng([seed, 9, run]).integers(2**31)) if run else seed


class SyntheticBackground:
    """1/f noise that neighbours share, waxing alpha, blinks, line noise, drifts and offsets, at `MONTAGE_64`.

    Parameters
    ----------
    seed : the same seed gives the same EEG.
    sfreq : rate, Hz.
    run : another number gives other noise of the same person.

    Notes
    -----
    Made in blocks, each from its own generator. Pieces two blocks long are made in the frequency domain,
    windowed by a half sine and overlapped by half, so that the variance is the same everywhere and no state is
    carried. There is nothing below 1 / (2 * BLOCK_S) Hz but the drifts.
    """

    def __init__(self, seed: int, sfreq: float = 500.0, run: int = 0) -> None:
        self.names = MONTAGE_64
        self.sfreq = sfreq
        self._moment = moment(seed, run)
        self._n_block = fft.next_fast_len(round(BLOCK_S * sfreq), real=True)
        self._where = directions(self.names)
        rng = np.random.default_rng([seed, 0])
        n = len(self.names)
        self._offset = rng.normal(0, OFFSET_UV, n)
        self._line = rng.gamma(4, LINE_UV / 4, n)
        self._drift = rng.gamma(4, DRIFT_UV / 4, (2, n))
        self._drift_hz = 1 / rng.uniform(40, 200, (2, n))
        self._drift_phase = rng.uniform(0, 2 * np.pi, (2, n))
        self._spectra, self._mixing = _sources(self._where, self._n_block, sfreq)
        self._window = np.sin(np.pi * (np.arange(2 * self._n_block) + 0.5) / (2 * self._n_block))[:, None]
        self._blocks: OrderedDict[int, Array] = OrderedDict()
        self._pieces: OrderedDict[int, Array] = OrderedDict()

    def samples(self, start: int, n_times: int) -> Array:
        """Samples from number `start` >= 0 on: float64, (n_times, n_channels), uV."""
        return from_blocks(self._block, self._n_block, start, (n_times, len(self.names)))

    def _block(self, number: int) -> Array:
        if number not in self._blocks:
            remember(self._blocks, number, self._make_block(number))
        return self._blocks[number]

    def _make_block(self, number: int) -> Array:
        sources = self._piece(number)[self._n_block :] + self._piece(number + 1)[: self._n_block]
        block: Array = sources @ self._mixing + self._offset
        seconds = (number * self._n_block + np.arange(self._n_block)[:, None]) / self.sfreq
        block += self._line * np.sin(2 * np.pi * 50 * seconds)
        for size, hz, phase in zip(self._drift, self._drift_hz, self._drift_phase, strict=True):
            block += size * np.sin(2 * np.pi * hz * seconds + phase)
        self._add_blinks(block, number)
        return block

    def _piece(self, number: int) -> Array:
        if number not in self._pieces:
            rng = np.random.default_rng([self._moment, 1, number])
            spectra = rng.standard_normal((2, *self._spectra.shape))
            noise = fft.irfft((spectra[0] + 1j * spectra[1]) * self._spectra, n=2 * self._n_block, axis=0)
            remember(self._pieces, number, noise * self._window)
        return self._pieces[number]

    def _add_blinks(self, block: Array, number: int) -> None:
        rng = np.random.default_rng([self._moment, 2, number])
        shape = signal.windows.hann(round(0.3 * self.sfreq))[:, None] ** 1.5
        frontal = bump(self._where, (0.0, 1.0, -0.3), 0.6)
        for _ in range(rng.poisson(BLINKS_A_MINUTE / 60 * len(block) / self.sfreq)):
            first = rng.integers(len(block) - len(shape))
            block[first : first + len(shape)] += rng.gamma(9, BLINK_UV / 9) * shape * frontal


class RecordedBackground:
    """A recording, resampled and looped for ever; its end is cross-faded into its beginning.

    Parameters
    ----------
    data : (n_times, n_channels), uV; longer than two cross-fades.
    names : its channels.
    recorded_sfreq : its rate, Hz.
    sfreq : the rate wanted, Hz.
    run : another number begins elsewhere in the loop.
    """

    def __init__(
        self,
        data: NDArray[np.floating],
        names: tuple[str, ...],
        recorded_sfreq: float,
        sfreq: float = 500.0,
        run: int = 0,
    ) -> None:
        self.names = names
        self.sfreq = sfreq
        ratio = Fraction(str(sfreq)).limit_denominator(1000) / Fraction(str(recorded_sfreq)).limit_denominator(1000)
        resampled = signal.resample_poly(data, ratio.numerator, ratio.denominator, axis=0, padtype="line")
        n_fade = round(CROSS_FADE_S * sfreq)
        if len(resampled) < 2 * n_fade:
            raise SetupError(
                f"A background must be longer than {2 * CROSS_FADE_S:g} s to be looped; this recording has "
                f"{len(resampled) / sfreq:.1f} s. Choose a longer one."
            )
        angle = np.pi / 2 * (np.arange(n_fade)[:, None] + 0.5) / n_fade
        self._loop: Array = resampled[:-n_fade].astype(np.float64)
        # Squares of sine and cosine add up to one: the power stays the same through the fade, offsets are kept apart.
        offset = self._loop.mean(axis=0)
        fading_out, fading_in = resampled[-n_fade:] - offset, self._loop[:n_fade] - offset
        self._loop[:n_fade] = np.cos(angle) * fading_out + np.sin(angle) * fading_in + offset
        self._begin = moment(0, run) % len(self._loop)

    def samples(self, start: int, n_times: int) -> Array:
        """Samples from number `start` >= 0 on: float64, (n_times, n_channels), uV."""
        looped: Array = self._loop[(self._begin + np.arange(start, start + n_times)) % len(self._loop)]
        return looped


def read_background(path: Path, sfreq: float = 500.0, run: int = 0) -> RecordedBackground:
    """A recording's EEG channels as a background at `sfreq` Hz; any format that `mne.io.read_raw` reads.

    Raises SetupError when it can't be read or holds no EEG.
    """
    import mne  # slow to import, and only needed here

    try:
        raw = mne.io.read_raw(path, preload=True, verbose="error")
        volts = raw.get_data(picks="eeg")
    except (OSError, ValueError, RuntimeError) as error:
        raise SetupError(f"Can't read EEG from {path}: {error}. Give a file that MNE reads, such as EDF.") from error
    names = tuple(raw.copy().pick("eeg").ch_names)
    return RecordedBackground(volts.T * 1e6, names, float(raw.info["sfreq"]), sfreq, run)


def _sources(where: Array, n_block: int, sfreq: float) -> tuple[Array, Array]:
    """Spectra (n_frequencies, n_sources) of unit sources, and their mixing (n_sources, n_channels) in uV."""
    hz = fft.rfftfreq(2 * n_block, 1 / sfreq)
    pink = 1 / np.maximum(hz, 1.0)  # power falls with 1 / f**2 above 1 Hz, as EEG's does
    pink[0] = 0
    alpha = np.exp(-((hz - 10) ** 2) / (2 * 0.8**2))  # a band 2 Hz wide waxes and wanes within half a second
    in_band = (hz >= 1) & (hz <= 50)
    # irfft of independent normals of unit variance: the variance is 4 * sum(power) / n ** 2.
    scale = 2 * n_block / 2
    pink *= scale / np.sqrt((pink[in_band] ** 2).sum())
    alpha *= scale / np.sqrt((alpha**2).sum())
    angle = np.arccos(np.clip(where @ where.T, -1, 1))
    # Volume conduction: neighbours share nearly everything. About ten components carry all of it, as in real EEG.
    shared = np.exp(-(angle**2) / (2 * 1.4**2))
    values, vectors = np.linalg.eigh(shared)
    noise = ONE_OVER_F_UV * (vectors * np.sqrt(np.maximum(values, 0))).T
    rhythm = ALPHA_UV * np.stack([bump(where, (x, -1.0, 0.3), 0.5) for x in (-0.5, 0.0, 0.5)])
    spectra = np.concatenate([np.tile(pink[:, None], len(noise)), np.tile(alpha[:, None], len(rhythm))], axis=1)
    return spectra, np.concatenate([noise, rhythm])


def bump(where: Array, centre: tuple[float, float, float], width: float) -> Array:
    """A topography: 1 above `centre` (right, front, up), falling off over `width` radians; 0 at unknown places."""
    direction = np.array(centre) / np.linalg.norm(centre)
    angle = np.arccos(np.clip(where @ direction, -1, 1))
    topography: Array = np.nan_to_num(np.exp(-(angle**2) / (2 * width**2)))
    return topography


def from_blocks(block: Callable[[int], Array], n_block: int, start: int, shape: tuple[int, int]) -> Array:
    """Samples from number `start` >= 0 on, (n_times, n_channels), of EEG made in numbered blocks of `n_block`."""
    out, done = np.empty(shape), 0
    while done < len(out):
        number, place = divmod(start + done, n_block)
        part = block(number)[place : place + len(out) - done]
        out[done : done + len(part)] = part
        done += len(part)
    return out


def remember(cache: OrderedDict[int, Array], number: int, value: Array, n_kept: int = 3) -> None:
    """Put a value into a cache that keeps the `n_kept` newest."""
    cache[number] = value
    while len(cache) > n_kept:
        cache.popitem(last=False)
