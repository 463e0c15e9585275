"""Read a recorded run: raw stamps, the EEG as it went over the wire, and every message in order."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyxdf
from numpy.typing import NDArray

from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.protocol import (
    MARKERS,
    STREAMS,
    BadMessage,
    Continued,
    Message,
    Recall,
    SessionEnd,
    SessionStart,
    Verdict,
    decode,
)
from bci_app.runs import check_untouched, eeg_type, known_of, read_sidecar
from bci_app.said import without_void
from bci_app.xdf import MAGIC, salvage

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)


class NoRun(SetupError):
    """A recording in which there is no run to look at: it never began, or is of something else."""


class NotOurs(NoRun):
    """A whole recording of something else."""


@dataclass(frozen=True)
class Stamped:
    """A recorded message and its session time."""

    stamp: float
    message: Message


@dataclass(frozen=True)
class SenderClock:
    """The clock that stamped a stream.

    Attributes
    ----------
    hostname : of its computer, as LSL wrote it into the stream's header.
    times, offsets : when LabRecorder measured it, in its own seconds, and what to add to be on the recorder's, in s.
    """

    hostname: str
    times: tuple[float, ...] = ()
    offsets: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded run.

    Attributes
    ----------
    path : the XDF.
    eeg : header of the EEG stream.
    samples : (n_times, n_channels), as on the wire; ``eeg.in_microvolts`` gives the EEG.
    times : float64, (n_times,), raw stamps in seconds.
    messages : of all our streams that count (`said.without_void`), ordered by stamp.
    damage : sentences about what is missing or unreadable; empty for a whole file.
    markers : (stamp, code) of the int32 stream, each once, in the order they were recorded.
    clocks : of the EEG's stream and ours, by the stream's name.
    """

    path: Path
    eeg: EegDescription
    samples: NDArray[Any]
    times: NDArray[np.float64]
    messages: tuple[Stamped, ...]
    damage: tuple[str, ...]
    markers: tuple[tuple[float, int], ...] = ()
    clocks: Mapping[str, SenderClock] = field(default_factory=dict)

    def of(self, kind: type[M]) -> list[tuple[float, M]]:
        """All messages of one type with their stamps, in order."""
        return [(item.stamp, item.message) for item in self.messages if isinstance(item.message, kind)]

    @property
    def verdicts(self) -> dict[tuple[int, int], Verdict]:
        """The verdict on each move, by (episode, step)."""
        return {(verdict.episode, verdict.step): verdict for _, verdict in self.of(Verdict)}

    @property
    def is_cut(self) -> bool:
        """Whether the run's end isn't in it: it was broken off, or its recorder was."""
        return not self.of(SessionEnd)


def read(path: Path, allow_damage: bool = False, eeg_type: str = "EEG") -> Recording:
    """Read a recording of ours; `eeg_type` is the LSL type of its EEG stream.

    Raises SetupError when it is no XDF, empty, holds no EEG or no messages of ours, or (unless `allow_damage`) is
    truncated or damaged. Reading never changes the file.
    """
    streams, damage = _load(path)
    damage += _missing(streams)
    stream = _eeg_stream(streams, path, eeg_type)
    messages = _messages(streams)
    if not messages:
        names = ", ".join(spec.name for spec in STREAMS if spec.string)
        also = f" It is damaged as well: {' '.join(damage)}" if damage else ""
        raise NotOurs(f"{path} holds no messages of ours (streams {names}): it isn't our experiment's run.{also}")
    if damage and not allow_damage:
        raise SetupError(f"{path} is damaged: {' '.join(damage)} What is left can be read with --allow-damage.")
    samples = np.asarray(stream["time_series"])
    times = np.asarray(stream["time_stamps"], dtype=np.float64)
    eeg, clocks = describe(stream["info"]), _clocks([*streams, stream])
    return Recording(path, eeg, samples, times, messages, tuple(damage), _markers(streams), clocks)


def read_run(path: Path, allow_damage: bool) -> tuple[Recording, SessionStart, dict[str, Any]]:
    """A recorded run as it was closed, how it began, and its sidecar.

    Raises SetupError as `read` does, for a file that isn't the one that was closed, unless `allow_damage`, and for one
    without a beginning.
    """
    sidecar = read_sidecar(path)
    recording = read(path, allow_damage, eeg_type(sidecar))
    if not allow_damage:
        check_untouched(path, sidecar)
    opening = recording.of(SessionStart)
    if not opening:
        raise never_began(path)
    return recording, opening[0][1], sidecar


def never_began(path: Path) -> NoRun:
    """Why a recording without a beginning can't be used."""
    return NoRun(f"{path} holds no SessionStart message: it isn't a whole run of this experiment.")


def _load(path: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """All streams, as far as they are whole, and what isn't, in sentences."""
    try:
        data = path.read_bytes()
        known = known_of(path, data)
    except OSError as error:
        raise SetupError(f"Can't read the recording {path}: {error.strerror}.") from error
    if not data:
        raise SetupError(f"{path} is empty; expected an XDF recording.")
    if not data.startswith(MAGIC):
        raise SetupError(f"{path} is not an XDF recording: it starts with {data[:4]!r}, expected {MAGIC!r}.")
    salvaged = salvage(data, known.changed, known.headers)
    try:
        streams, _ = pyxdf.load_xdf(salvaged.file, synchronize_clocks=False, dejitter_timestamps=False)
    except Exception as error:  # pyxdf raises whatever its parser met; the reason is in the message
        raise SetupError(f"{path} can't be read as XDF ({type(error).__name__}: {error}).") from error
    places = ", ".join(f"{gone.start} to {gone.stop}" for gone in salvaged.damage[:5])
    more = f" and at {len(salvaged.damage) - 5} more places" if len(salvaged.damage) > 5 else ""
    damage = [f"Bytes {places}{more} of {len(data)} are damaged and left out."] if salvaged.damage else []
    return list(streams), damage


def _missing(streams: list[dict[str, Any]]) -> list[str]:
    """LabRecorder writes a footer with the sample count for each stream when it closes a file in order."""
    found, cut = [], []
    for stream in streams:
        name = stream["info"]["name"][0]
        try:
            count = int(stream["footer"]["info"]["sample_count"][0])
        except (KeyError, TypeError, IndexError):
            cut.append(f"'{name}'")
            continue
        if count > len(stream["time_stamps"]):
            found.append(f"Stream '{name}' should have {count} samples, found {len(stream['time_stamps'])}.")
    if cut:
        which = "no stream" if len(cut) == len(streams) else f"not {', '.join(cut)}"
        found.append(f"The file was cut off before it was closed: {which} has a footer.")
    return found


def _eeg_stream(streams: list[dict[str, Any]], path: Path, eeg_type: str) -> dict[str, Any]:
    candidates = [s for s in streams if s["info"]["type"][0] == eeg_type and len(s["time_stamps"])]
    if len(candidates) != 1:
        listed = ", ".join(f"'{s['info']['name'][0]}' ({s['info']['type'][0]})" for s in streams) or "no stream"
        kind = SetupError if candidates else NoRun
        raise kind(f"{path} must hold exactly one EEG stream with samples, found {len(candidates)} in: {listed}.")
    return candidates[0]


def _clocks(streams: list[dict[str, Any]]) -> dict[str, SenderClock]:
    """By the stream's name; of two with the same name the last one's."""
    return {
        stream["info"]["name"][0]: SenderClock(
            _text(stream["info"], "hostname"), tuple(stream["clock_times"]), tuple(stream["clock_values"])
        )
        for stream in streams
    }


def describe(info: dict[str, Any]) -> EegDescription:
    """The EEG stream's header as pyxdf gives it."""
    try:
        channels = info["desc"][0]["channels"][0]["channel"]
    except (KeyError, TypeError, IndexError):
        channels = []
    count = int(info["channel_count"][0])
    labels, units, types = (
        [_text(channel, key) for channel in channels] or [""] * count for key in ("label", "unit", "type")
    )
    return EegDescription(
        name=info["name"][0],
        source_id=_text(info, "source_id"),
        hostname=_text(info, "hostname"),
        channels=tuple(labels),
        units=tuple(units),
        types=tuple(types),
        sfreq=float(info["nominal_srate"][0]),
    )


def _text(node: dict[str, Any], key: str) -> str:
    return str((node.get(key) or [""])[0] or "")


def _messages(streams: list[dict[str, Any]]) -> tuple[Stamped, ...]:
    names = {spec.name for spec in STREAMS if spec.string}
    found = []
    for stream in streams:
        if stream["info"]["name"][0] not in names:
            continue
        for stamp, sample in zip(stream["time_stamps"], stream["time_series"], strict=True):
            try:
                found.append(Stamped(float(stamp), decode(sample[0])))
            except BadMessage as error:
                log.warning("A sample of stream %s at %.3f is no message: %s", stream["info"]["name"][0], stamp, error)
    found += _retold(found)
    # What is void was said before; what a stimulus says as it goes on, on another stream, can have the same stamp.
    found.sort(key=lambda item: (item.stamp, not isinstance(item.message, Continued)))
    return tuple(without_void(found, lambda item: item.message))


def _retold(found: list[Stamped]) -> list[Stamped]:
    """What only bci-app's `Recall` kept: the last words of a process that was killed can be lost on their way to the
    recorder, and have reached the others."""
    known = {(type(item.message), item.stamp) for item in found}
    retold: dict[tuple[type[Message], float], Stamped] = {}
    for item in found:
        for said in item.message.said if isinstance(item.message, Recall) else ():
            key = type(said.message), said.stamp
            if key not in known:
                retold[key] = Stamped(said.stamp, said.message)
    return list(retold.values())


def _markers(streams: list[dict[str, Any]]) -> tuple[tuple[float, int], ...]:
    found = (
        (float(stamp), int(sample[0]))
        for stream in streams
        if stream["info"]["name"][0] == MARKERS.name
        for stamp, sample in zip(stream["time_stamps"], stream["time_series"], strict=True)
    )
    return tuple(dict.fromkeys(found))  # a stimulus that was started again says the last one once more
