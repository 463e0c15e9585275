"""Channel names and places of the extended 10/20 (10-10) system."""

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError

_ROWS_64 = """
FC5 FC3 FC1 FCz FC2 FC4 FC6 C5 C3 C1 Cz C2 C4 C6 CP5 CP3 CP1 CPz CP2 CP4 CP6 Fp1 Fpz Fp2 AF7 AF3 AFz AF4 AF8
F7 F5 F3 F1 Fz F2 F4 F6 F8 FT7 FT8 T7 T8 T9 T10 TP7 TP8 P7 P5 P3 P1 Pz P2 P4 P6 P8 PO7 PO3 POz PO4 PO8 O1 Oz O2 Iz
"""
MONTAGE_64 = tuple(_ROWS_64.split())
"""The 64 electrodes of the 10-10 system as BCI2000 uses them (Schalk 2004, doi:10.1109/TBME.2004.827072). The paper's
LiveAmp has 64 of the same system; its reference FCz is a channel here."""

_OLD_NAMES = {"t3": "t7", "t4": "t8", "t5": "p7", "t6": "p8"}
_DRESSING = re.compile(r"^(eeg[\s_-]+)|[\s.]+$|[\s_-]+(ref|avg|le)$")


def canonical(name: str) -> str:
    """What two spellings of one electrode share: ``Fcz.``, ``EEG FCz``, ``FCZ-REF`` and ``fcz`` all give ``fcz``."""
    bare, dressed = name.strip().lower(), ""
    while bare != dressed:
        dressed, bare = bare, _DRESSING.sub("", bare)
    return _OLD_NAMES.get(bare, bare)


def match_channels(wanted: Sequence[str], found: Sequence[str]) -> tuple[list[int], list[str]]:
    """Where each wanted channel is among those found, by name.

    Returns
    -------
    (indices into `found`, in the order of `wanted`; names of `wanted` that are missing).

    Raises SetupError when two of the found channels are the same electrode.
    """
    places: dict[str, int] = {}
    for index, name in enumerate(found):
        if places.setdefault(canonical(name), index) != index:
            twin = found[places[canonical(name)]]
            raise SetupError(f"Channels '{twin}' and '{name}' are the same electrode. Rename one in the amplifier.")
    missing = [name for name in wanted if canonical(name) not in places]
    return [places[canonical(name)] for name in wanted if canonical(name) in places], missing


@lru_cache(maxsize=1)
def template() -> Any:
    """MNE's montage of the 10-05 system on the Colin27 head."""
    # Only the simulated participant and repaired channels need places, and MNE is slow to import.
    import mne

    try:
        return mne.channels.make_standard_montage("colin27_1005")
    except ValueError:  # the template's name before MNE 1.13
        return mne.channels.make_standard_montage("standard_1005")


def directions(names: Sequence[str]) -> NDArray[np.float64]:
    """Where electrodes sit: (n_channels, 3) unit vectors (right, front, up) from the head's middle; NaN if unknown.

    From `template`.
    """
    known = {canonical(name): place for name, place in template().get_positions()["ch_pos"].items()}
    nowhere = np.full(3, np.nan)
    # The template's origin is a point of the brain's atlas; the sphere through the scalp is centred 15 mm behind it.
    places = np.array([known.get(canonical(name), nowhere) for name in names]) - (0.0, -0.015, 0.01)
    unit: NDArray[np.float64] = places / np.linalg.norm(places, axis=1, keepdims=True)
    return unit
