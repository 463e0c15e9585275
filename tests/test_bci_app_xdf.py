"""XDF files: whatever is damaged is left out and reported, and all that is whole is kept."""

import struct
from pathlib import Path

import numpy as np
import pytest
import pyxdf
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bci_app.xdf import SAMPLES, Chunk, Chunks, Damage, Follower, salvage

UUID = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")


def chunk(tag: int, content: bytes, stream: int | None = None) -> bytes:
    body = struct.pack("<H", tag) + (b"" if stream is None else struct.pack("<I", stream)) + content
    width, code = (1, "<B") if len(body) < 256 else (4, "<I")
    return bytes([width]) + struct.pack(code, len(body)) + body


def described(name: str, n_channels: int, kind: str) -> bytes:
    return (
        f"<?xml version='1.0'?><info><name>{name}</name><type>X</type><channel_count>{n_channels}</channel_count>"
        f"<nominal_srate>0</nominal_srate><channel_format>{kind}</channel_format><source_id>{name}-1</source_id></info>"
    ).encode()


def eeg(first: int, n: int, deduced: bool = False) -> bytes:
    content = struct.pack("<BB", 1, n)
    for number in range(first, first + n):
        content += b"\0" if deduced and number > first else b"\x08" + struct.pack("<d", 100 + number / 250)
        content += struct.pack("<3f", number, -number, 0.5)
    return content


def words(stamp: float, *texts: str) -> bytes:
    content = struct.pack("<BB", 1, len(texts))
    for text in texts:
        content += b"\x08" + struct.pack("<d", stamp)
        content += b"\x04" + struct.pack("<I", len(text.encode())) + text.encode()
    return content


def pieces() -> list[bytes]:
    """The chunks of a small recording."""
    made = [
        chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>"),
        chunk(2, described("amp", 3, "float32"), 1),
        chunk(2, described("talk", 1, "string"), 2),
    ]
    for number in range(12):
        made.append(chunk(3, eeg(20 * number, 20, deduced=number % 4 == 3), 1))
        if number % 2:
            made.append(chunk(3, words(100 + number, f"message {number}", "µ" * number), 2))
        if number % 5 == 4:
            made += [chunk(5, UUID), chunk(4, struct.pack("<dd", 100.0 + number, 0.001), 1)]
    made += [chunk(6, b"<?xml version='1.0'?><info><sample_count>240</sample_count></info>", 1)]
    return made


PIECES = pieces()
WHOLE = b"XDF:" + b"".join(PIECES)
ENDS = (4 + np.cumsum([len(piece) for piece in PIECES])).tolist()
STARTS = [4, *ENDS[:-1]]
TAGS = [piece[piece[0] + 1] for piece in PIECES]
OF_STREAM = {
    index: int.from_bytes(piece[piece[0] + 3 :][:4], "little")
    for index, piece in enumerate(PIECES)
    if TAGS[index] in (2, 3, 4, 6)
}
"""Stream of each chunk that has one, by its place among the pieces."""


def spans(data: bytes, rotten: tuple[tuple[int, int], ...] = ()) -> tuple[set[tuple[int, int]], list[Damage]]:
    items = list(Chunks(data, rotten))
    whole = {(item.start, item.stop) for item in items if isinstance(item, Chunk)}
    damage = [item for item in items if isinstance(item, Damage)]
    edges = sorted([*whole, *((item.start, item.stop) for item in damage)])
    assert [start for start, _ in edges] == [4, *(stop for _, stop in edges[:-1])]  # all of it is one or the other
    assert not edges or edges[-1][1] == len(data)
    return whole, damage


def test_a_whole_file_is_whole() -> None:
    whole, damage = spans(WHOLE)
    assert whole == set(zip(STARTS, ENDS, strict=True))
    assert not damage
    salvaged = salvage(WHOLE)
    assert salvaged.file.getvalue() == WHOLE
    streams, _ = pyxdf.load_xdf(salvaged.file, synchronize_clocks=False, dejitter_timestamps=False)
    assert streams[0]["time_series"].shape == (240, 3)
    assert len(streams[1]["time_series"]) == 12


@settings(max_examples=300, deadline=None)
@given(at=st.integers(5, len(WHOLE) - 1))
def test_of_a_cut_file_all_before_the_cut_is_kept(at: int) -> None:
    whole, damage = spans(WHOLE[:at])
    assert whole == {(start, stop) for start, stop in zip(STARTS, ENDS, strict=True) if stop <= at}
    assert damage == ([] if at in ENDS else [Damage(max(start for start in STARTS if start < at), at)])


@settings(max_examples=300, deadline=None)
@given(at=st.integers(4, len(WHOLE) - 64), new=st.binary(min_size=64, max_size=64))
@example(at=STARTS[3], new=bytes(64))
@example(at=STARTS[5] - 1, new=b"\xff" * 64)
@example(at=STARTS[7] + 1, new=PIECES[4][:64])
@example(at=STARTS[1], new=bytes(64))
def test_of_an_overwritten_file_all_chunks_that_were_not_hit_are_kept(at: int, new: bytes) -> None:
    data = WHOLE[:at] + new + WHOLE[at + 64 :]
    if data == WHOLE:
        return
    hit = {index for index, (start, stop) in enumerate(zip(STARTS, ENDS, strict=True)) if start < at + 64 and at < stop}
    nameless = {OF_STREAM[index] for index in hit if TAGS[index] == 2}  # without its header a stream can't be read
    lost = hit | {index for index, stream in OF_STREAM.items() if stream in nameless and index > 2}
    whole, damage = spans(data, rotten=((at, at + 64),))
    assert whole == {(STARTS[index], ENDS[index]) for index in range(len(PIECES)) if index not in lost}
    assert damage
    streams, _ = pyxdf.load_xdf(
        salvage(data, ((at, at + 64),)).file, synchronize_clocks=False, dejitter_timestamps=False
    )
    found = {stream["info"]["name"][0]: len(stream["time_stamps"]) for stream in streams}
    for stream, (name, n_samples) in enumerate((("amp", 20), ("talk", 2)), start=1):
        if stream not in nameless:
            kept = [
                index
                for index, of in OF_STREAM.items()
                if of == stream and index not in lost and TAGS[index] == SAMPLES
            ]
            assert found[name] == n_samples * len(kept)


def test_without_checksums_only_what_contradicts_itself_is_found() -> None:
    """A value is a value: that is what the checksums beside a recording are for."""
    place = ENDS[3] - 6
    changed = WHOLE[:place] + b"\x55" + WHOLE[place + 1 :]
    assert spans(changed)[1] == []
    assert spans(changed, rotten=((place, place + 1),))[1] == [Damage(STARTS[3], ENDS[3])]


@settings(max_examples=50, deadline=None)
@given(cuts=st.lists(st.integers(0, len(WHOLE)), max_size=8))
def test_a_growing_file_is_followed(tmp_path_factory: pytest.TempPathFactory, cuts: list[int]) -> None:
    path = tmp_path_factory.mktemp("growing") / "x.xdf"
    follower = Follower(path)
    follower.look()
    for cut in [*sorted(cuts), len(WHOLE)]:
        path.write_bytes(WHOLE[:cut])
        follower.look()
    assert follower.n_samples == {"amp-1": 240, "talk-1": 12}


def test_real_recordings_are_whole(data: Path) -> None:
    for path in sorted((data / "xdf").glob("*.xdf")):
        assert not [item for item in Chunks(path.read_bytes()) if isinstance(item, Damage)], path.name


def test_samples_whose_stamps_hang_on_a_lost_chunk_are_left_out_and_no_other() -> None:
    """LabRecorder writes no stamp where it is exactly one interval after the one before."""
    late = b"".join(
        (b"\0" if number < 22 else b"\x08" + struct.pack("<d", 100 + number / 250)) + struct.pack("<3f", number, 0, 0)
        for number in range(20, 40)
    )
    made = [PIECES[0], chunk(2, described("amp", 3, "float32"), 1)]
    made += [chunk(3, eeg(0, 20), 1), chunk(3, struct.pack("<BB", 1, 20) + late, 1), chunk(3, eeg(40, 20), 1)]
    data = b"XDF:" + b"".join(made)
    lost = 4 + len(made[0]) + len(made[1]) + 30
    salvaged = salvage(data, ((lost, lost + 1),))
    (stream,), _ = pyxdf.load_xdf(salvaged.file, synchronize_clocks=False, dejitter_timestamps=False)
    assert stream["time_series"][:, 0].tolist() == list(range(22, 60))
    assert stream["time_stamps"].tolist() == [100 + number / 250 for number in range(22, 60)]
    assert len(salvaged.damage) == 2
