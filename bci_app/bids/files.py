"""Writes signals and events as BrainVision or EEGLAB, and reads them back to see that nothing has changed."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.bids import tables
from bci_app.bids.columns import COLUMNS
from bci_app.bids.signals import MICROVOLT, Signals, pieces
from bci_app.errors import SetupError
from decoder.montage import canonical, template

Row = dict[str, Any]
EEGLAB_MOST_BYTES = 2**31 - 1
"""Of one variable in a .set file (MATLAB's format 5)."""
_COMMENT = "Comment"
_NOT_KEPT = "It isn't kept. Export once more, on another disk; the recording itself is untouched."


def events_text(rows: Sequence[Row], with_hed: bool = True) -> str:
    """The content of ``events.tsv``; columns that are empty all along are kept, so that all runs have the same."""
    return tables.text([*COLUMNS, *(["HED"] if with_hed else [])], rows)


def write_brainvision(folder: Path, name: str, signals: Signals, rows: Sequence[Row]) -> Path:
    """Write ``name.vhdr``, ``.eeg`` and ``.vmrk`` into a folder; the header's path.

    Samples are 32-bit floats in microvolts at a resolution of 1, so that microvolts that came as such stay the same to
    the bit. (At pybv's own resolution of 0.1, which mne-bids takes, they wouldn't.)
    """
    import pybv

    with warnings.catch_warnings():
        # MISC channels may have other units than microvolts; MNE reads them as they are.
        warnings.filterwarnings("ignore", "Encountered unsupported (non-)?voltage units")
        pybv.write_brainvision(
            data=_volts(signals).T,
            sfreq=signals.sfreq,
            ch_names=list(signals.names),
            fname_base=name,
            folder_out=folder,
            events=[
                {"onset": row["sample"], "duration": 1, "description": row["trial_type"], "type": _COMMENT}
                for row in rows
            ],
            resolution=1.0,
            unit=list(signals.units),
            fmt="binary_float32",
        )
    return folder / f"{name}.vhdr"


def write_eeglab(folder: Path, name: str, signals: Signals, rows: Sequence[Row]) -> Path:
    """Write ``name.set`` into a folder; its path. Raises SetupError where it would be too large for the format."""
    from eeglabio.raw import export_set

    n_bytes = signals.values.size * 4
    if n_bytes > EEGLAB_MOST_BYTES:
        raise SetupError(
            f"The EEG takes {n_bytes / 1e9:.1f} GB and a .set file can hold 2.1 GB. Export it as BrainVision, which "
            "EEGLAB reads as well."
        )
    types = np.array([row["trial_type"] for row in rows], dtype=object)
    onsets = np.array([row["sample"] / signals.sfreq for row in rows])
    # EEGLAB keeps how much is missing as the length of a boundary.
    durations = np.array([max(0, row.get("n_lost", 0)) / signals.sfreq or float(row["duration"]) for row in rows])
    path = folder / f"{name}.set"
    export_set(
        str(path),
        _volts(signals, all_in_volts=True).T,
        signals.sfreq,
        list(signals.names),
        ch_locs=_eeglab_places(signals.names),
        annotations=[types, onsets, durations] if rows else None,
        ch_types=list(signals.kinds),
    )
    return path


def _eeglab_places(names: Sequence[str]) -> NDArray[np.float64] | None:
    """(n_channels, 3), m, along EEGLAB's axes: front, left, up. None unless all channels have a place."""
    montage = places(names)
    known = montage.get_positions()["ch_pos"] if montage else {}
    if set(known) != set(names):
        return None
    right, front, up = np.array([known[name] for name in names]).T
    return np.column_stack((front, -right, up))


def _volts(signals: Signals, all_in_volts: bool = False) -> NDArray[np.float64]:
    """(n_times, n_channels) as the writers want them: volts; MISC as they are, or so that times 1e6 they are.

    A float32 divided and multiplied in float64 is off by so little that it is rounded back to itself.
    """
    factors = [1e-6 if all_in_volts or unit == MICROVOLT else _factor(unit) for unit in signals.units]
    return np.asarray(signals.values * np.array(factors), dtype=np.float64)


def _factor(unit: str) -> float:
    """To volts, of a unit that pybv takes for a voltage; of any other 1."""
    from pybv.io import SUPPORTED_VOLTAGE_SCALINGS

    return 1 / float(SUPPORTED_VOLTAGE_SCALINGS.get(unit, 1))


def read_back(path: Path) -> Any:
    """The raw object of a written file, not loaded."""
    import mne

    if path.suffix == ".set":
        return mne.io.read_raw_eeglab(path, preload=False, verbose="ERROR")
    return mne.io.read_raw_brainvision(path, preload=False, verbose="ERROR")


def check_same(raw: Any, signals: Signals) -> None:
    """Raise SetupError unless a raw object holds the very samples, as 32-bit floats in the signals' units."""
    name = Path(raw.filenames[0]).name
    if tuple(raw.ch_names) != signals.names or raw.n_times != len(signals.values):
        raise SetupError(
            f"{name} should read back as {len(signals.values)} samples of {', '.join(signals.names)}, found "
            f"{raw.n_times} of {', '.join(raw.ch_names)}. {_NOT_KEPT}"
        )
    at = 0
    for piece in pieces(signals.values):
        back = _in_units(raw.get_data(start=at, stop=at + len(piece)).T, raw, signals)
        same = (back == piece) | (np.isnan(back) & np.isnan(piece))
        if not same.all():
            row, channel = np.argwhere(~same)[0]
            raise SetupError(
                f"Sample {at + row} of {signals.names[channel]} in {name} should read back as {piece[row, channel]}, "
                f"found {back[row, channel]}. {_NOT_KEPT}"
            )
        at += len(piece)


def _in_units(volts: NDArray[np.float64], raw: Any, signals: Signals) -> NDArray[np.float32]:
    # MNE brings some units of MISC to their base unit (uS), and tells by how much.
    told = [1 / (channel["cal"] * channel["range"]) for channel in raw.info["chs"]]
    factors = [1e6 if unit == MICROVOLT else factor for unit, factor in zip(signals.units, told, strict=True)]
    return np.asarray((volts * factors).astype(np.float32))


def places(names: Sequence[str]) -> Any:
    """The montage of channels whose names the 10-05 template knows, as MNE keeps it; None where it knows none."""
    import mne

    positions = template().get_positions()
    known = {canonical(name): place for name, place in positions["ch_pos"].items()}
    found = dict(_known(names, known))
    if not found:
        return None
    return mne.channels.make_dig_montage(
        found,
        nasion=positions["nasion"],
        lpa=positions["lpa"],
        rpa=positions["rpa"],
        coord_frame=positions["coord_frame"],
    )


def _known(names: Sequence[str], known: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name in names:
        if canonical(name) in known:
            yield name, known[canonical(name)]
