"""What an EEG stream says about itself, live or in a recording, and whether we can use it."""

from collections import Counter
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError

MICROVOLTS_PER = {
    "microvolts": 1.0,
    "microvolt": 1.0,
    "uv": 1.0,
    "µv": 1.0,  # U+00B5 micro sign
    "μv": 1.0,  # U+03BC Greek mu
    "millivolts": 1e3,
    "millivolt": 1e3,
    "mv": 1e3,
    "volts": 1e6,
    "volt": 1e6,
    "v": 1e6,
}
"""Factor to microvolts of each unit spelling, compared in lower case (XDF meta-data convention: `microvolts`)."""


@dataclass(frozen=True)
class EegDescription:
    """An EEG stream as its header describes it.

    Attributes
    ----------
    name, source_id, hostname : as announced on LSL.
    channels : labels in stream order.
    units, types : one a channel; empty strings where none are given.
    sfreq : nominal sampling rate in Hz.
    """

    name: str
    source_id: str
    hostname: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    types: tuple[str, ...]
    sfreq: float

    @property
    def fingerprint(self) -> str:
        """First 16 hex digits of the SHA-256 of what mustn't change within a run: all but where it comes from."""
        told = (self.name, self.source_id, self.channels, self.units, self.types, self.sfreq)
        return sha256(repr(told).encode()).hexdigest()[:16]

    @property
    def picks(self) -> NDArray[np.int64]:
        """Indices of the channels that are EEG or EOG: of that type, or of none given (triggers, accelerometers are
        not)."""
        return np.flatnonzero([kind in ("eeg", "eog", "") for kind in self._kinds])

    @property
    def picked(self) -> list[str]:
        """Labels of these channels; an EOG channel's says so, whatever the amplifier calls it."""
        names, kinds = self.channels, self._kinds
        return [
            f"EOG {names[index]}" if kinds[index] == "eog" and "eog" not in names[index].lower() else names[index]
            for index in self.picks
        ]

    @property
    def _kinds(self) -> list[str]:
        return [kind.strip().lower() for kind in self.types]

    def check(self) -> None:
        """Raise SetupError unless the stream is usable: a fixed rate, unique labels, known units."""
        if self.sfreq <= 0:
            raise SetupError(
                f"Stream '{self.name}' has no fixed sampling rate; EEG needs a nominal rate in Hz. "
                "Set it in the amplifier's LSL connector."
            )
        if not any(kind in ("eeg", "") for kind in self._kinds):
            raise SetupError(
                f"Stream '{self.name}' has no channel of type EEG, only {', '.join(sorted(set(self._kinds)))}. Choose "
                "another stream, or set the channels' types in the amplifier's LSL connector."
            )
        if not any(self.channels[index] for index in self.picks):
            raise SetupError(
                f"Stream '{self.name}' has {len(self.picks)} EEG channels but no labels; channels are matched by name. "
                "Switch on channel labels in the amplifier's LSL connector."
            )
        doubled = [label for label, count in Counter(self.picked).items() if count > 1]
        if doubled:
            raise SetupError(
                f"Stream '{self.name}' has channel labels that are not unique: {', '.join(map(repr, doubled))}. "
                "Give every channel its own label in the amplifier's LSL connector."
            )
        self.microvolts()

    def microvolts(self) -> NDArray[np.float64]:
        """Factors to microvolts, (n_picks,) as `picks`. Raises SetupError for a missing or unknown unit."""
        units = [self.units[index] for index in self.picks]
        unknown = sorted({unit for unit in units if unit.strip().lower() not in MICROVOLTS_PER})
        if unknown:
            found = "no unit" if not any(unknown) else f"unit {', '.join(map(repr, unknown))}"
            raise SetupError(
                f"Stream '{self.name}' gives {found} for its channels; expected one of microvolts, uV, mV, V. "
                "Set the unit in the amplifier's LSL connector: a factor of a million can't be guessed."
            )
        return np.array([MICROVOLTS_PER[unit.strip().lower()] for unit in units])

    def in_microvolts(self, samples: NDArray[Any]) -> NDArray[Any]:
        """Samples as on the wire, (n_times, n_channels), to EEG in uV, (n_times, n_picks): live and replay alike.

        What is EEG in microvolts already is passed through as it is: half an hour is half a gigabyte.
        """
        factors = self.microvolts()
        if len(self.picks) == len(self.channels) and (factors == 1).all():
            return samples
        return np.asarray(samples[:, self.picks].astype(np.float64) * factors)
