"""The real LabRecorder on streams of this test."""

from pathlib import Path

import pylsl
import pytest
import pyxdf
from lsl_peers import until

from bci_app.errors import LinkLost, SetupError
from bci_app.recorder import Recorder
from bci_app.vigil import GROW_TIMEOUT_S, Vigil

N_STREAMS = 8


@pytest.fixture(scope="module")
def outlets() -> list[pylsl.StreamOutlet]:
    names = [f"recorder-test-{number}" for number in range(N_STREAMS)]
    return [pylsl.StreamOutlet(pylsl.StreamInfo(name, "Notes", 1, 0, "string", name)) for name in names]


def queries(outlets: list[pylsl.StreamOutlet]) -> list[dict[str, str]]:
    return [{"source_id": outlet.get_info().source_id()} for outlet in outlets]


def test_it_is_started_once_all_streams_are_open_though_they_announce_themselves_at_once(
    outlets: list[pylsl.StreamOutlet], tmp_path: Path
) -> None:
    recorder = Recorder(tmp_path / "new" / "all.xdf", queries(outlets))
    recorder.start()
    assert recorder.alive
    recorder.stop()
    assert not recorder.alive
    streams, _ = pyxdf.load_xdf(recorder.path)
    assert {stream["info"]["source_id"][0] for stream in streams} == {query["source_id"] for query in queries(outlets)}


@pytest.mark.trouble("neurobooth-os #820: a required stream is not recorded and nobody is told")
def test_a_stream_that_is_not_there_is_named(outlets: list[pylsl.StreamOutlet], tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "some.xdf", [*queries(outlets[:1]), {"source_id": "nobody"}])
    with pytest.raises(LinkLost, match=r"(?s)of 2 streams and stopped.*source_id='nobody'"):
        recorder.start()
    assert not recorder.alive
    assert not recorder.path.exists()


def test_a_recorder_that_writes_no_more_is_told_and_ended(outlets: list[pylsl.StreamOutlet], tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "hangs.xdf", queries(outlets[:1]))
    recorder.start()
    vigil = Vigil(recorder, began=0.0)
    assert vigil.lost(1000, GROW_TIMEOUT_S, may_stand=False) is None
    assert vigil.lost(1000, 2 * GROW_TIMEOUT_S, may_stand=False) is None
    assert vigil.lost(1000, 9 * GROW_TIMEOUT_S, may_stand=True) is None
    text = vigil.lost(1000, 11.1 * GROW_TIMEOUT_S, may_stand=False)
    assert text is not None
    assert "has stopped growing at 1000 bytes" in text
    until(lambda: not recorder.alive, 30, "its end")
    text = vigil.lost(2000, 12 * GROW_TIMEOUT_S, may_stand=False)
    assert text is not None
    assert "LabRecorder died" in text


def test_a_recording_is_never_overwritten(outlets: list[pylsl.StreamOutlet], tmp_path: Path) -> None:
    path = tmp_path / "there.xdf"
    path.write_bytes(b"old")
    with pytest.raises(SetupError, match="not overwritten"):
        Recorder(path, queries(outlets)).start()
    assert path.read_bytes() == b"old"
