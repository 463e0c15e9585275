"""The chunks of an XDF file: which are whole, and which have come while it is written. What is in them pyxdf reads.

Format: https://github.com/sccn/xdf/wiki/Specifications. A chunk is the number of bytes of its length (1, 4 or 8), its
length, a tag of two bytes, and for most the number of its stream.
"""

import struct
import xml.etree.ElementTree as ElementTree
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Final

MAGIC = b"XDF:"
FILE_HEADER, STREAM_HEADER, SAMPLES, CLOCK_OFFSET, BOUNDARY, STREAM_FOOTER = range(1, 7)
_OF_A_STREAM = (STREAM_HEADER, SAMPLES, CLOCK_OFFSET, STREAM_FOOTER)
_UUID = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")
_WIDTH: Final = {1: "<B", 4: "<I", 8: "<Q"}
_VALUE_BYTES: Final = {"int8": 1, "int16": 2, "int32": 4, "int64": 8, "float32": 4, "double64": 8}


@dataclass(frozen=True)
class Chunk:
    """Where a chunk lies: ``data[start:stop]``, its content from `content` on; `stream` is 0 where it has none."""

    start: int
    content: int
    stop: int
    tag: int
    stream: int = 0


@dataclass(frozen=True)
class Damage:
    """Bytes `start` to `stop` that are no whole chunk."""

    start: int
    stop: int


@dataclass(frozen=True)
class Header:
    """What is needed of a stream's header to tell whether its samples are whole."""

    source_id: str
    name: str
    n_channels: int
    n_value_bytes: int | None
    """Of one value; None for strings."""


def header_at(data: bytes, at: int) -> Chunk | None:
    """The chunk that begins at `at`, whole or not; None where none can begin, or not all of its head is there."""
    if at >= len(data) or data[at] not in _WIDTH:
        return None
    n_bytes = data[at]
    if at + 1 + n_bytes + 2 > len(data):
        return None
    (length,) = struct.unpack_from(_WIDTH[n_bytes], data, at + 1)
    tag_at = at + 1 + n_bytes
    (tag,) = struct.unpack_from("<H", data, tag_at)
    stop = tag_at + length
    if tag not in _OF_A_STREAM:
        is_one = tag in (FILE_HEADER, BOUNDARY) and length >= 2
        return Chunk(at, tag_at + 2, stop, tag) if is_one else None
    if length < 6 or tag_at + 6 > len(data):
        return None
    (stream,) = struct.unpack_from("<I", data, tag_at + 2)
    return Chunk(at, tag_at + 6, stop, tag, stream)


class Chunks:
    """Walks through a file's bytes. What is damaged is left out, and nothing else.

    Parameters
    ----------
    data : the whole file.
    rotten : (start, stop) of bytes that are known to have changed: no chunk with one of them is whole.
    headers : chunks with headers of streams that are known from elsewhere.
    """

    def __init__(self, data: bytes, rotten: tuple[tuple[int, int], ...] = (), headers: tuple[bytes, ...] = ()) -> None:
        self._data = data
        self._rotten = sorted(rotten)
        self._rotten_starts = [start for start, _ in self._rotten]
        self.headers: dict[int, Header] = {}
        for known in headers:
            chunk = header_at(known, 0)
            header = _header(known[chunk.content : chunk.stop]) if chunk else None
            if chunk is not None and header is not None:
                self.headers[chunk.stream] = header

    def __iter__(self) -> Iterator[Chunk | Damage]:
        """Whole chunks in order, and what lies between them."""
        at = len(MAGIC)
        while at < len(self._data):
            chunk = self._whole(at)
            if chunk is not None:
                yield chunk
                at = chunk.stop
                continue
            found = self._next_whole(at)
            yield Damage(at, found)
            at = found

    def _next_whole(self, at: int) -> int:
        """Where the next whole chunk begins, or the file ends."""
        head = header_at(self._data, at)
        while head is not None and head.stop < len(self._data):  # perhaps only the contents are damaged
            if self._whole(head.stop) is not None:
                return head.stop
            head = header_at(self._data, head.stop)
        for start in range(at + 1, len(self._data)):
            # Samples may look like a chunk; but hardly ever is another head where it ends.
            chunk = self._whole(start) if self._data[start] in _WIDTH else None
            if chunk and (chunk.stop == len(self._data) or header_at(self._data, chunk.stop)):
                return start
        return len(self._data)

    def _is_rotten(self, chunk: Chunk) -> bool:
        before = bisect_left(self._rotten_starts, chunk.stop)
        return before > 0 and self._rotten[before - 1][1] > chunk.start

    def _whole(self, at: int) -> Chunk | None:
        chunk = header_at(self._data, at)
        if chunk is None or chunk.stop > len(self._data):
            return None
        if self._is_rotten(chunk):
            return None
        if chunk.tag in _OF_A_STREAM and chunk.tag != STREAM_HEADER and chunk.stream not in self.headers:
            return None
        content = memoryview(self._data)[chunk.content : chunk.stop]
        match chunk.tag:
            case tag if tag == BOUNDARY:
                is_whole = content == _UUID
            case tag if tag == CLOCK_OFFSET:
                is_whole = len(content) == 16
            case tag if tag == SAMPLES:
                is_whole = _are_samples(content, self.headers[chunk.stream])
            case tag if tag == STREAM_HEADER:
                header = _header(bytes(content))
                is_whole = header is not None
                if header is not None:
                    self.headers.setdefault(chunk.stream, header)
            case _:
                is_whole = _xml(bytes(content)) is not None
        return chunk if is_whole else None


def _xml(content: bytes) -> ElementTree.Element | None:
    try:
        return ElementTree.fromstring(content.decode("utf-8"))
    except (ElementTree.ParseError, UnicodeDecodeError):
        return None


def _header(content: bytes) -> Header | None:
    info = _xml(content)
    if info is None:
        return None
    values = {key: info.findtext(key, "") for key in ("name", "source_id", "channel_count", "channel_format")}
    if not values["channel_count"].isdigit() or values["channel_format"] not in (*_VALUE_BYTES, "string"):
        return None
    return Header(
        values["source_id"],
        values["name"],
        int(values["channel_count"]),
        _VALUE_BYTES.get(values["channel_format"]),
    )


def _number(content: memoryview, at: int) -> tuple[int, int] | None:
    """A number of variable width at `at`, and where it ends."""
    if at >= len(content) or content[at] not in _WIDTH:
        return None
    n_bytes = content[at]
    if at + 1 + n_bytes > len(content):
        return None
    return struct.unpack_from(_WIDTH[n_bytes], content, at + 1)[0], at + 1 + n_bytes


def _are_samples(content: memoryview, header: Header) -> bool:
    """Whether the content is, to the last byte, as many samples as it says."""
    counted = _number(content, 0)
    if counted is None:
        return False
    n_samples, at = counted
    if header.n_value_bytes is not None:
        row = 9 + header.n_channels * header.n_value_bytes
        if at + n_samples * row == len(content) and bytes(content[at::row]) == bytes([8]) * n_samples:
            return True
    for _ in range(n_samples):
        if at >= len(content) or content[at] not in (0, 8):
            return False
        end = _end_of_values(content, at + 1 + content[at], header)
        if end is None:
            return False
        at = end
    return at == len(content)


def _end_of_values(content: memoryview, at: int, header: Header) -> int | None:
    """Where the values of a sample end that begin at `at`; None where they can't be read."""
    if header.n_value_bytes is not None:
        return at + header.n_channels * header.n_value_bytes
    for _ in range(header.n_channels):
        length = _number(content, at)
        if length is None:
            return None
        at = length[0] + length[1]
    return at


@dataclass(frozen=True)
class Salvaged:
    """What is left of a damaged file.

    Attributes
    ----------
    file : the same file without what is damaged, to be read.
    damage : the bytes left out.
    """

    file: BytesIO
    damage: tuple[Damage, ...]


def salvage(data: bytes, rotten: tuple[tuple[int, int], ...] = (), headers: tuple[bytes, ...] = ()) -> Salvaged:
    """A file without its damaged chunks, and without samples whose stamps can't be known any more because of them.

    A stream's header that is damaged is taken from `headers`, where it is among them.
    """
    kept, damage, chunks = [MAGIC, *headers], [], Chunks(data, rotten, headers)
    known = {chunk.stream for header in headers if (chunk := header_at(header, 0))}
    unsure: set[int] = set()  # streams of which the sample before may be lost
    for item in chunks:
        if isinstance(item, Damage):
            damage.append(item)
            unsure |= set(chunks.headers)
        elif item.tag == SAMPLES and item.stream in unsure:
            n_unstamped, first = unstamped(data, item, chunks.headers[item.stream])
            if n_unstamped:
                damage.append(Damage(item.start, first))
            if first < item.stop:
                unsure.discard(item.stream)
                kept.append(_from_sample(data, item, n_unstamped, first))
        elif item.tag != STREAM_HEADER or item.stream not in known:
            kept.append(data[item.start : item.stop])
    return Salvaged(BytesIO(b"".join(kept) if damage else data), tuple(damage))


def unstamped(data: bytes, chunk: Chunk, header: Header) -> tuple[int, int]:
    """How many samples at the beginning of a chunk have no stamp of their own but one interval more than the sample
    before, and where the first begins that has one."""
    content = memoryview(data)[chunk.content : chunk.stop]
    counted = _number(content, 0)
    assert counted is not None
    n_samples, at = counted
    for number in range(n_samples):
        if content[at]:
            return number, chunk.content + at
        at = _end_of_values(content, at + 1, header) or len(content)
    return n_samples, chunk.stop


def _from_sample(data: bytes, chunk: Chunk, number: int, start: int) -> bytes:
    """The same chunk without its first ``number`` samples, which end where ``start`` is."""
    if not number:
        return data[chunk.start : chunk.stop]
    counted = _number(memoryview(data)[chunk.content : chunk.stop], 0)
    assert counted is not None
    body = struct.pack("<HIBI", SAMPLES, chunk.stream, 4, counted[0] - number) + data[start : chunk.stop]
    return struct.pack("<BI", 4, len(body)) + body


class Follower:
    """Looks at a file while it is written: which streams have come into it, and how much of each.

    Parameters
    ----------
    path : of the recording; needn't exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at = len(MAGIC)
        self.n_samples: Counter[str] = Counter()
        """Samples so far, by the source id of their stream."""
        self._source_ids: dict[int, str] = {}

    @property
    def n_bytes(self) -> int:
        """Bytes of the file that are complete chunks."""
        return self._at

    def look(self) -> None:
        """Take in the chunks that are complete by now."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._at)
                new = file.read()
        except FileNotFoundError:
            return
        at = 0
        while (chunk := header_at(new, at)) is not None and chunk.stop <= len(new):
            if chunk.tag == STREAM_HEADER:
                header = _header(new[chunk.content : chunk.stop])
                self._source_ids[chunk.stream] = header.source_id if header else ""
            elif chunk.tag == SAMPLES:
                counted = _number(memoryview(new)[chunk.content : chunk.stop], 0)
                self.n_samples[self._source_ids.get(chunk.stream, "")] += counted[0] if counted else 0
            at = chunk.stop
        self._at += at
