"""Recordings written without LSL: whatever a test needs to be in them is."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from bci_app.protocol import STREAMS, Message, encode

Said = tuple[float, Message]
_FORMATS = {"float32": "float32", "float64": "double64", "int16": "int16", "int32": "int32"}


def write_xdf(
    path: Path,
    samples: NDArray[np.generic],
    times: NDArray[np.float64],
    channels: Sequence[tuple[str, str, str]],
    sfreq: float,
    said: Mapping[str, Sequence[Said]],
    footers: bool = True,
    hosts: Mapping[str, str] | None = None,
    clocks: Mapping[str, Sequence[tuple[float, float]]] | None = None,
) -> Path:
    """A recording as LabRecorder writes it: EEG (n_times, n_channels) with (label, type, unit) of each channel, and
    what was said on each of our streams, by its name; by that too (the EEG's is Amp) the streams' computers, `h` where
    none is given, and when how far their clocks were from the recorder's."""
    kinds = {spec.name: spec.kind for spec in STREAMS}
    parts = [b"XDF:", _chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")]
    described = "".join(
        f"<channel><label>{escape(label)}</label><type>{kind}</type><unit>{unit}</unit></channel>"
        for label, kind, unit in channels
    )
    host = {"Amp": "h"} | dict.fromkeys(said, "h") | dict(hosts or {})
    form = _FORMATS[samples.dtype.name]
    parts.append(_header(1, "Amp", "EEG", len(channels), sfreq, form, described, host["Amp"]))
    counts = {1: len(samples)}
    for number, (name, items) in enumerate(said.items(), 2):
        parts.append(_header(number, name, kinds[name], 1, 0, "string", "", host[name]))
        parts += [_words(number, stamp, encode(message)) for stamp, message in items]
        counts[number] = len(items)
    numbers = {name: number for number, name in enumerate(["Amp", *said], 1)}
    for name, measured in (clocks or {}).items():
        parts += [_chunk(4, struct.pack("<dd", *each), numbers[name]) for each in measured]
    for start in range(0, len(samples), 100):
        parts.append(_samples(1, samples[start : start + 100], times[start : start + 100]))
    if footers:
        for number, count in counts.items():
            footer = f"<?xml version='1.0'?><info><sample_count>{count}</sample_count></info>"
            parts.append(_chunk(6, footer.encode(), number))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(parts))
    return path


def _chunk(tag: int, content: bytes, stream: int | None = None) -> bytes:
    body = struct.pack("<H", tag) + (b"" if stream is None else struct.pack("<I", stream)) + content
    return struct.pack("<BI", 4, len(body)) + body


def _header(
    number: int, name: str, kind: str, n_channels: int, sfreq: float, form: str, channels: str, host: str
) -> bytes:
    text = (
        f"<?xml version='1.0'?><info><name>{name}</name><type>{kind}</type><channel_count>{n_channels}</channel_count>"
        f"<nominal_srate>{sfreq}</nominal_srate><channel_format>{form}</channel_format><source_id>{name}-1</source_id>"
        f"<hostname>{host}</hostname><desc><channels>{channels}</channels></desc></info>"
    )
    return _chunk(2, text.encode(), number)


def _samples(number: int, samples: NDArray[np.generic], times: NDArray[np.float64]) -> bytes:
    rows = [b"\x08" + struct.pack("<d", time) + row.tobytes() for row, time in zip(samples, times, strict=True)]
    return _chunk(3, struct.pack("<BB", 1, len(rows)) + b"".join(rows), number)


def _words(number: int, stamp: float, text: str) -> bytes:
    raw = text.encode()
    return _chunk(3, b"\x01\x01\x08" + struct.pack("<d", stamp) + b"\x04" + struct.pack("<I", len(raw)) + raw, number)
