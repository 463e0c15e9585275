"""LabStreamingLayer: the only module that touches pylsl.

Inlets deliver raw stamps: no clock synchronisation, no dejittering. Who needs times on another clock maps them
himself and says so, which is what makes a replay exact.
"""

import logging
import os
import platform
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeAlias
from uuid import uuid4

import numpy as np
import pylsl
from numpy.typing import NDArray

from bci_app.clock import Clock
from bci_app.config import EegConfig
from bci_app.eeg import EegDescription
from bci_app.errors import LinkLost, SetupError
from bci_app.protocol import PROTOCOL_VERSION, SESSION, AnyMessage, BadMessage, Message, StreamSpec, decode, encode

log = logging.getLogger(__name__)

USUAL_PLACES = (Path("lsl_api.cfg"), Path("~/lsl_api/lsl_api.cfg").expanduser(), Path("/etc/lsl_api/lsl_api.cfg"))
if "LSLAPICFG" not in os.environ and not any(path.exists() for path in USUAL_PLACES):
    # liblsl reads it at its first call; by the environment, so that LabRecorder and the other processes do so too.
    os.environ["LSLAPICFG"] = str(files("bci_app") / "lsl_api.cfg")

MOST_AT_ONCE = 1000
"""Messages of one pull, so that who is flooded still comes to do other things (decided: a whole run says some
thousands)."""
OPEN_TIMEOUT_S = 10.0
"""Real seconds a stream that was just resolved may take to open, and to describe itself."""


EegInfo: TypeAlias = pylsl.StreamInfo
"""A stream as it was found on the network."""


class Identity(NamedTuple):
    """What tells two streams of one source id apart, the older first."""

    opened: float
    """On its computer's clock, s; on the network it is told to some digits only."""
    uid: str


class NoStream(SetupError):
    """No EEG stream was found."""


def local_clock() -> float:
    """LSL's clock of this machine, in seconds."""
    return float(pylsl.local_clock())


class MessageOutlet:
    """Publishes protocol messages on one of our string streams; its header tells the session's clock, if given."""

    def __init__(self, spec: StreamSpec, session: str, clock: Clock | None = None) -> None:
        info = pylsl.StreamInfo(spec.name, spec.kind, 1, pylsl.IRREGULAR_RATE, "string", spec.source_id(session))
        _describe_ours(info, session)
        if clock is not None:
            info.desc().append_child_value("speed", repr(clock.speed))
            info.desc().append_child_value("origin", repr(clock.origin))
        info.desc().append_child_value("process", str(os.getpid()))
        self._outlet: pylsl.StreamOutlet | None = pylsl.StreamOutlet(info)
        self.identity: Identity = _identity(self._outlet.get_info())

    def push(self, message: Message, stamp: float) -> None:
        """Send a message with its session time; nobody hears it once it is closed."""
        if self._outlet is not None:
            self._outlet.push_sample([encode(message)], stamp)

    def close(self) -> None:
        """Take it off the network, whoever still holds it."""
        self._outlet = None


class MarkerOutlet:
    """Publishes int32 codes for tools that can't read strings."""

    def __init__(self, spec: StreamSpec, session: str) -> None:
        info = pylsl.StreamInfo(spec.name, spec.kind, 1, pylsl.IRREGULAR_RATE, "int32", spec.source_id(session))
        _describe_ours(info, session)
        info.desc().child("channels").first_child().append_child_value("label", "code")
        self._outlet = pylsl.StreamOutlet(info)

    def push(self, code: int, stamp: float) -> None:
        """Send a code with its session time."""
        self._outlet.push_sample([code], stamp)


class EegOutlet:
    """Publishes EEG in microvolts, as an amplifier does."""

    def __init__(self, description: EegDescription, session: str) -> None:
        info = pylsl.StreamInfo(
            description.name,
            "EEG",
            len(description.channels),
            description.sfreq,
            "float32",
            description.source_id,
        )
        info.set_channel_labels(list(description.channels))
        info.set_channel_units(list(description.units))
        info.set_channel_types(list(description.types))
        info.desc().append_child_value("session", session)
        self._outlet = pylsl.StreamOutlet(info)

    def push(self, samples: NDArray[np.float32], stamps: NDArray[np.float64]) -> None:
        """Send samples (n_times, n_channels), each with its own session time."""
        self._outlet.push_chunk(samples, stamps.tolist())


def _identity(info: pylsl.StreamInfo) -> Identity:
    return Identity(float(info.created_at()), str(info.uid()))


def _describe_ours(info: pylsl.StreamInfo, session: str) -> None:
    desc = info.desc()
    desc.append_child_value("manufacturer", "errp-bci")
    desc.append_child_value("session", session)
    desc.append_child_value("protocol", str(PROTOCOL_VERSION))
    desc.append_child("channels").append_child("channel")


@dataclass(frozen=True)
class Received:
    """A message with its stamp (sender's session time) and the real time at which it was pulled."""

    message: AnyMessage
    stamp: float
    arrived: float


@dataclass(frozen=True)
class Header:
    """Of one of our message streams: the session clock's speed and origin (1 and 0 where none are told), the process
    that sends (0 where none is told), and on which computer."""

    speed: float
    origin: float
    process: int
    hostname: str


class Watch:
    """Knows at any moment which of our streams are on the network; LSL asks for them in a thread of its own."""

    FORGET_S: ClassVar[float] = 3.0
    """Real seconds without an answer after which a stream is gone (decided: LSL asks about twice a second)."""

    def __init__(self) -> None:
        ours = f"starts-with(source_id,'{StreamSpec.PREFIX}/')"
        self._resolver = pylsl.ContinuousResolver(pred=ours, forget_after=self.FORGET_S)

    def found(self) -> dict[str, pylsl.StreamInfo]:
        """The streams by their source id."""
        return {info.source_id(): info for info in self._resolver.results()}

    def identities(self, source_id: str) -> set[Identity]:
        """Of all streams with this source id: there are several where one was started twice."""
        return {_identity(info) for info in self._resolver.results() if info.source_id() == source_id}


class LateInlet:
    """Listens to a stream that may never be there, or come later: whoever asks for its messages never waits.

    Finding and opening takes seconds where the sender has just died, so a thread does that.
    """

    def __init__(self, spec: StreamSpec, session: str) -> None:
        self._spec, self._session = spec, session
        self._inlet: MessageInlet | None = None
        self._ended = threading.Event()
        threading.Thread(target=self._find, name=f"find {spec.name}", daemon=True).start()

    @property
    def inlet(self) -> "MessageInlet | None":
        """The inlet, once it is open."""
        return self._inlet

    def pull(self) -> list[Received]:
        """What came, none of it waited for, as `MessageInlet.pull`. What is no message of this session is left out."""
        inlet = self._inlet
        if inlet is None:
            return []
        received = inlet.pull()
        inlet.refused.clear()
        return received

    def close(self) -> None:
        """Neither look for it nor listen to it any longer."""
        self._ended.set()
        self._inlet = None

    def _find(self) -> None:
        while not self._ended.is_set():
            try:
                self._inlet = MessageInlet.find(self._spec, self._session, timeout=0.5)
            except LinkLost:
                log.info("Stream '%s' was found but is gone again.", self._spec.name)
            if self._inlet is not None:
                return
            self._ended.wait(1.0)


class MessageInlet:
    """Listens to one of our string streams; survives a restart of its sender."""

    def __init__(self, info: pylsl.StreamInfo, spec: StreamSpec, session: str) -> None:
        # As bytes: text that isn't UTF-8 is refused like any other garbage.
        self._inlet = pylsl.StreamInlet(info, recover=True, as_numpy=True)
        self._spec = spec
        self._session = session
        self.name = spec.name
        self.hostname: str = info.hostname()
        self.refused: list[str] = []
        """Sentences about samples that were no message of this session; the owner takes and reports them."""
        _open(self._inlet, spec.name)

    @classmethod
    def find(cls, spec: StreamSpec, session: str, timeout: float) -> "MessageInlet | None":
        """Connect to the stream of this session, or None when it doesn't show up in `timeout` real seconds."""
        found = pylsl.resolve_bypred(f"source_id='{spec.source_id(session)}'", 1, timeout)
        return cls(found[0], spec, session) if found else None

    def pull(self, timeout: float = 0.0) -> list[Received]:
        """The waiting messages, `MOST_AT_ONCE` at most; waits up to `timeout` real seconds for the first."""
        received: list[Received] = []
        for number in range(MOST_AT_ONCE):
            sample, stamp = self._inlet.pull_sample(0.0 if number else timeout)
            if sample is None:
                break
            try:
                received.append(Received(decode(sample[0], self._session), stamp, local_clock()))
            except BadMessage as error:
                self.refused.append(f"{self._spec.name}: {error}")
        return received

    def clock_correction(self) -> float:
        """Seconds to add to the sender's stamps to put them on this machine's clock."""
        return _correction(self._inlet, self._spec.name)

    def header(self) -> Header:
        """What its header tells. Raises LinkLost when the sender doesn't answer."""
        try:
            desc = self._inlet.info(OPEN_TIMEOUT_S).desc()
        except (pylsl.util.TimeoutError, pylsl.util.LostError) as error:
            raise LinkLost(
                f"Stream '{self._spec.name}' was announced but doesn't answer. Restart its sender."
            ) from error
        speed, origin, process = (desc.child_value(name) for name in ("speed", "origin", "process"))
        return Header(float(speed or 1.0), float(origin or 0.0), int(process or 0), self.hostname)


class EegInlet:
    """Receives an amplifier's samples with their raw stamps; survives a restart of the amplifier's connector."""

    def __init__(self, info: pylsl.StreamInfo, buffer_s: float) -> None:
        self._inlet = pylsl.StreamInlet(info, max_buflen=round(buffer_s), recover=True)
        self.description = _describe(self._inlet, info.name())
        self.description.check()
        _open(self._inlet, self.description.name)

    def pull(self, timeout: float) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """All waiting samples of the EEG channels, (n_times, n_picks) in microvolts, and raw stamps (n_times,).

        Waits up to `timeout` real seconds for the first sample, never for more.
        """
        samples, stamps = self._inlet.pull_chunk(timeout=timeout, max_samples=4096, min_samples=1, as_numpy=True)
        return self.description.in_microvolts(samples), np.array(stamps)

    def look_again(self, timeout: float) -> float | None:
        """After an interruption LSL reconnects to whatever has the source id, and takes up to three seconds to measure
        its clock. This asks by another connection, in one: returns the clock correction, or None where it doesn't
        answer within `timeout` real seconds. Raises SetupError if it has changed."""
        same = f"name={_quoted(self.description.name)} and source_id={_quoted(self.description.source_id)}"
        found = pylsl.resolve_bypred(same, 1, timeout)
        if not found:
            return None
        inlet = pylsl.StreamInlet(found[0], recover=False)
        try:
            now, correction = _describe(inlet, self.description.name, timeout), None
            if now == self.description:
                correction = _correction(inlet, self.description.name, timeout)
        except LinkLost as error:
            log.info("%s", error)  # gone again: it is asked again
            return None
        if now != self.description:
            raise SetupError(
                f"Stream '{self.description.name}' came back changed: expected {self.description}, found {now}. "
                "Restore the amplifier's settings and start the run again; what was recorded is kept."
            )
        return correction

    def clock_correction(self) -> float:
        """Seconds to add to the amplifier's stamps to put them on this machine's clock."""
        return _correction(self._inlet, self.description.name)


def find_eeg(config: EegConfig, timeout: float) -> pylsl.StreamInfo:
    """The one EEG stream that fits the configuration.

    Raises SetupError when there is none within `timeout` real seconds, or more than one.
    """
    wanted = {"type": config.stream_type, "name": config.stream_name, "source_id": config.source_id}
    predicate = " and ".join(f"{key}={_quoted(value)}" for key, value in wanted.items() if value is not None)
    started = local_clock()
    found: list[Any] = []
    simulated: list[str] = []
    while not found and local_clock() - started < timeout:
        # Asking for two makes LSL listen on after the first, so that a second amplifier isn't missed.
        found = pylsl.resolve_bypred(predicate, 2, min(1.0, timeout))
        simulated = [info.source_id() for info in found if info.source_id().startswith(f"{StreamSpec.PREFIX}/")]
        if config.source_id is None:  # a simulated amplifier is nobody's but its own session's
            found = [info for info in found if info.source_id() not in simulated]
    if not found and simulated:
        raise NoStream(
            f"No EEG stream of an amplifier: expected one with {predicate}, found only simulated ones, which are their "
            f"own sessions'. Start the amplifier's LSL connector, or to take a simulated one set [eeg] source_id = "
            f"{' or '.join(repr(each) for each in sorted(simulated))}."
        )
    if not found:
        others = ", ".join(sorted({f"'{info.name()}' ({info.type()})" for info in pylsl.resolve_streams(1.0)}))
        raise NoStream(
            f"No EEG stream: expected one with {predicate}, found {others or 'no stream at all'}. "
            "Start the amplifier's LSL connector on this network, or name its stream in the configuration ([eeg])."
        )
    if len(found) > 1:
        listed = "; ".join(f"name '{i.name()}', source_id '{i.source_id()}', on {i.hostname()}" for i in found)
        raise SetupError(
            f"{len(found)} EEG streams fit {predicate}: {listed}. "
            "Name the one to use in the configuration ([eeg] stream_name or source_id)."
        )
    return found[0]


def describe(info: EegInfo, timeout: float = OPEN_TIMEOUT_S) -> EegDescription:
    """The full header of a resolved EEG stream. Raises LinkLost when it doesn't answer in `timeout` real seconds."""
    return _describe(pylsl.StreamInlet(info, recover=False), info.name(), timeout)


def finds_streams(timeout: float) -> bool:
    """Whether a stream of our own, opened for that, is found on this computer within `timeout` real seconds."""
    session = f"finding-{uuid4().hex[:8]}"
    outlet = MessageOutlet(SESSION, session)
    found = pylsl.resolve_bypred(f"source_id='{SESSION.source_id(session)}'", 1, timeout)
    del outlet  # only now
    return bool(found)


def running_session(beginnings: Sequence[str], timeout: float) -> str | None:
    """A session led on this computer whose id, with a slash after it, begins in one of these ways; None where none
    answers within `timeout` real seconds."""
    begins = (f"starts-with(source_id,{_quoted(f'{StreamSpec.PREFIX}/{each}')})" for each in beginnings)
    predicate = f"name='{SESSION.name}' and hostname={_quoted(platform.node())} and ({' or '.join(begins)})"
    found = pylsl.resolve_bypred(predicate, 1, timeout)
    return found[0].source_id().split("/")[1] if found else None


def all_streams(wait_s: float = 1.0) -> list[dict[str, str | int | float]]:
    """Every stream on the network, for `doctor`: name, type, source_id, hostname, channels, rate."""
    return [
        {
            "name": info.name(),
            "type": info.type(),
            "source_id": info.source_id(),
            "hostname": info.hostname(),
            "channels": info.channel_count(),
            "sfreq": info.nominal_srate(),
        }
        for info in pylsl.resolve_streams(wait_s)
    ]


def _describe(inlet: pylsl.StreamInlet, name: str, timeout: float = OPEN_TIMEOUT_S) -> EegDescription:
    try:
        info = inlet.info(timeout)
    except (pylsl.util.TimeoutError, pylsl.util.LostError) as error:
        raise LinkLost(f"Stream '{name}' was announced but doesn't answer. Restart its sender.") from error
    n_channels = info.channel_count()
    return EegDescription(
        name=info.name(),
        source_id=info.source_id(),
        hostname=info.hostname(),
        channels=_filled(info.get_channel_labels(), n_channels),
        units=_filled(info.get_channel_units(), n_channels),
        types=_filled(info.get_channel_types(), n_channels),
        sfreq=info.nominal_srate(),
    )


def _quoted(value: str) -> str:
    """A string in LSL's query language (XPath 1.0), which has no escapes."""
    return f'"{value}"' if "'" in value else f"'{value}'"


def _filled(values: Sequence[str | None] | None, n_channels: int) -> tuple[str, ...]:
    given = [value or "" for value in values or []]
    return tuple(given + [""] * (n_channels - len(given)))


def _open(inlet: pylsl.StreamInlet, name: str) -> None:
    try:
        inlet.open_stream(OPEN_TIMEOUT_S)
    except (pylsl.util.TimeoutError, pylsl.util.LostError) as error:
        raise LinkLost(f"Stream '{name}' was announced but can't be opened. Restart its sender.") from error


def _correction(inlet: pylsl.StreamInlet, name: str, timeout: float = OPEN_TIMEOUT_S) -> float:
    try:
        return float(inlet.time_correction(timeout))
    except (pylsl.util.TimeoutError, pylsl.util.LostError) as error:
        raise LinkLost(f"The clock of stream '{name}' can't be measured: it doesn't answer.") from error


def session_clock(speed: float = 1.0, origin: float | None = None) -> Clock:
    """The session clock over LSL's clock; `origin` comes from the process that started the session."""
    return Clock(local_clock, speed, local_clock() if origin is None else origin)
