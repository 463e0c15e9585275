"""What an EEG stream delivered, as a table of signals with names, types and units."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.eeg import EegDescription
from bci_app.errors import SetupError

MICROVOLT = "µV"
"""As BIDS and BrainVision spell it, with the micro sign U+00B5."""
_PIECE = 100_000  # rows that are looked at together: memory


@dataclass(frozen=True, eq=False)
class Signals:
    """All channels of a recording.

    Attributes
    ----------
    names : unique labels, in stream order.
    kinds : BIDS's channel types: EEG, EOG, or MISC for all others.
    units : `MICROVOLT` for EEG and EOG, the stream's own or ``n/a`` for MISC.
    values : float32, (n_times, n_channels), in these units: just what is written.
    sfreq : nominal rate, Hz.
    exact : whether float32, in which the formats keep samples, holds every value that came to the bit.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    values: NDArray[np.float32]
    sfreq: float
    exact: bool

    @property
    def precision(self) -> str:
        """The same in words."""
        return "to the bit" if self.exact else "rounded to 32-bit floats"


def signals(eeg: EegDescription, samples: NDArray[Any]) -> Signals:
    """The signals of samples as on the wire, (n_times, n_channels).

    They are rounded to float32 here, not by the writers: a value near the middle between two floats would go to the
    other one by what a writer multiplies it with, and a float itself never does.

    Raises SetupError for units that can't be told, and for values that are infinite, in float32 at least: BrainVision
    can't hold them.
    """
    picked = set(eeg.picks.tolist())
    kinds = [_kind(eeg.types[i]) if i in picked else "MISC" for i in range(len(eeg.channels))]
    units = [MICROVOLT if kind != "MISC" else eeg.units[i].strip() or "n/a" for i, kind in enumerate(kinds)]
    microvolts = eeg.in_microvolts(samples)
    if len(picked) == len(kinds):
        values = microvolts
    else:
        values = samples.astype(np.float64)
        values[:, eeg.picks] = microvolts
    names = _names(eeg.channels, kinds)
    with np.errstate(over="ignore"):  # what is too large becomes infinite, and that is told
        rounded = values.astype(np.float32, copy=False)
    infinite = [name for name, bad in zip(names, _any(rounded, np.isinf), strict=True) if bad]
    if infinite:
        raise SetupError(
            f"Stream '{eeg.name}' has values in {', '.join(infinite)} that are infinite or too large for the 32-bit "
            "floats of BrainVision and EEGLAB. The recording itself keeps them: read it as XDF."
        )
    exact = rounded is values or not any(_any(values, _is_rounded))
    return Signals(tuple(names), tuple(kinds), tuple(units), rounded, eeg.sfreq, bool(exact))


def _kind(kind: str) -> str:
    return "EOG" if kind.strip().lower() == "eog" else "EEG"


def _names(channels: Sequence[str], kinds: Sequence[str]) -> list[str]:
    """Unique names: EEG keeps its labels, which `EegDescription.check` has found unique; others may have none."""
    pairs = list(zip(channels, kinds, strict=True))
    plain = [name.replace("\t", " ").strip() or f"{kind}{i + 1}" for i, (name, kind) in enumerate(pairs)]
    counts = Counter(plain)
    return [
        name if kind != "MISC" or counts[name] == 1 else f"{name}-{i + 1}"
        for i, (name, kind) in enumerate(zip(plain, kinds, strict=True))
    ]


def _any(values: NDArray[Any], test: Any) -> NDArray[np.bool_]:
    """Whether a test holds for any value of each channel."""
    found = np.zeros(values.shape[1], dtype=bool)
    for piece in pieces(values):
        found |= test(piece).any(axis=0)
    return found


def _is_rounded(values: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((values.astype(np.float32) != values) & ~np.isnan(values))


def pieces(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """The rows of a long table, some at a time."""
    for start in range(0, len(values), _PIECE):
        yield values[start : start + _PIECE]
