"""Export: what is in the files is what was recorded, to the bit and to the sample, and nothing is ever overwritten."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner
from xdf_files import write_xdf

from bci_app.bids import files, tables
from bci_app.bids.about import About, read_about
from bci_app.bids.columns import COLUMNS, TRIAL_TYPES
from bci_app.bids.dataset import export_bids
from bci_app.bids.events import events
from bci_app.bids.grid import Gap, gaps
from bci_app.bids.plain import export
from bci_app.bids.signals import signals
from bci_app.bids.source import read_source
from bci_app.cli import app
from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.moves import cut_moves
from bci_app.protocol import (
    Action,
    BlockStart,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Note,
    RunSeed,
    SessionEnd,
    SessionStart,
    Truth,
    Verdict,
)
from bci_app.recording import Recording
from decoder.chain import design
from decoder.epochs import Epoch, Shape

SFREQ = 250.0
CHANNELS = [
    *((name, "EEG", "microvolts") for name in ("Fz", "FCz", "Cz", "Pz", "Oz", "C3")),
    ("VEOG", "EOG", "microvolts"),
    ("Trigger", "TRIG", ""),
]
N_MOVES = 8
LOST = 40
"""Samples that are missing in the middle of the fifth move."""
SHAPE = Shape(SFREQ, *(lambda chain: (chain.n_before, chain.n_after))(design(Config().chain, SFREQ)))


def quiet(_what: str, _done: int, _total: int) -> None:
    pass


def said(task: str, participant: str) -> dict[str, list[tuple[float, Message]]]:
    """A run of eight moves, every third an error, on a clock that is 0.25 s behind the EEG's."""
    of: dict[str, Any] = {"session": "s"}
    start = SessionStart(task=task, participant=participant, map="open", layout=["." * 11] * 11, **of)
    sensed = (False,) * 5
    stimulus: list[tuple[float, Message]] = [(105.0, start), (105.1, BlockStart(block=0, n_moves=N_MOVES, **of))]
    stimulus.append((105.2, EpisodeStart(episode=0, position=(0, 0), sensed=sensed, max_steps=60, **of)))
    truth: list[tuple[float, Message]] = [(105.0, RunSeed(seed=4, **of))]
    truth.append((105.2, EpisodeGoal(episode=0, goal=(9, 9), distance=18, **of)))
    verdicts: list[tuple[float, Message]] = [(105.3, Electrodes(episode=0, bad={"C3": ["flat"]}, n_samples=10, **of))]
    actions: list[tuple[float, Message]] = []
    for step in range(1, N_MOVES + 1):
        onset, key = 106.0 + 3 * step + 0.0013 * step, {"episode": 0, "step": step, **of}
        stimulus.append((onset, MoveOnset(action="south", position=(step, 0), sensed=sensed, **key)))
        truth.append((onset, Truth(error=step % 3 == 0, distance=9, **key)))
        chosen = {"action": "south", "probabilities": (0.1, 0.7, 0.1, 0.1), "verdict": "correct"}
        actions.append((onset - 2, Action(**chosen, **key)))
        outcome: dict[str, Any] = {"outcome": "correct", "log_odds": -1.5, "evidence": -1.0}
        if step == 5:
            outcome = {"outcome": "rejected", "reason": f"gap: +{LOST}.0 samples +0.100 s from the onset"}
        verdicts.append((onset + 0.7, Verdict(clock_offset=0.25, latency_ms=1.0, **outcome, **key)))
    stimulus += [(134.0, EpisodeEnd(episode=0, steps=N_MOVES, reason="aborted", **of))]
    stimulus += [(134.5, Note(role="stimulus", level="info", text="a\ttab, and µ", **of))]
    stimulus += [(135.0, SessionEnd(reason="complete", **of))]
    return {"bci-stimulus": stimulus, "bci-truth": truth, "bci-verdicts": verdicts, "bci-actions": actions}


def eeg(seed: int, lose: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """(n_times, n_channels) float32 and raw stamps; samples are missing 0.1 s after the fifth onset."""
    rng = np.random.default_rng(seed)
    n = round(37 * SFREQ)
    samples = (rng.normal(0, 30, (n, len(CHANNELS))) * 10.0 ** rng.integers(-3, 3, (n, 1))).astype(np.float32)
    samples[1000, 2] = np.nan
    samples[:, -1] = rng.integers(0, 255, n)
    times = 100.0 + np.arange(n) / SFREQ
    if lose:
        at = round((106.0 + 15 + 0.25 + 0.1 - 100.0) * SFREQ)
        samples, times = np.delete(samples, slice(at, at + LOST), axis=0), np.delete(times, slice(at, at + LOST))
    return samples, times


def recorded(folder: Path, participant: str, task: str = "online", run: int = 1, seed: int = 1, **more: Any) -> Path:
    """A short run, as files."""
    name = f"sub-{participant}_ses-S001_task-{task}_run-{run:03d}_eeg.xdf"
    samples, times = eeg(seed)
    path = folder / f"sub-{participant}" / "ses-S001" / "eeg" / name
    channels, words = more.pop("channels", CHANNELS), more.pop("words", said(task, participant))
    config = more.pop("config", Config())
    write_xdf(path, samples, times, channels, SFREQ, words, **more)
    sidecar = {
        "continues": [str(path)] if run > 1 else [],
        "config": config.model_dump(mode="json"),
        "simulated": participant == "P002",
        "versions": {"mne": "1"},
    }
    path.with_suffix(".json").write_text(json.dumps(sidecar))
    return path


@dataclass(frozen=True)
class Study:
    """Two participants, the first with two runs, exported one after the other."""

    recordings: Path
    out: Path
    told: list[dict[str, Any]]

    def eeg(self, participant: str = "P001") -> Path:
        return self.out / f"sub-{participant}" / "ses-S001" / "eeg"


OURS = "What the lab wrote into its own README stays. " * 5
ABOUT = About.model_validate(
    {
        "dataset": {"Name": "Study", "Authors": ["A", "B"], "License": "CC0"},
        "eeg": {"EEGReference": "FCz", "PowerLineFrequency": 50},
        "participants": {"P001": {"age": 31, "sex": "F", "gaming": "daily"}},
        "columns": {"gaming": "How often games are played"},
    }
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    folder = tmp_path_factory.mktemp("study")
    recordings, out = folder / "recordings", folder / "bids"
    first = [recorded(recordings, "P001", "calibration"), recorded(recordings, "P001", seed=2)]
    told = [export_bids(first, out, ABOUT, False, quiet)]
    (out / "README.md").write_text(OURS)
    recorded(recordings, "P002", seed=3)
    recorded(recordings, "P002", seed=4, run=2)
    told.append(export_bids([recordings], out, ABOUT, False, quiet))
    return Study(recordings, out, told)


def rows_of(path: Path) -> list[dict[str, str]]:
    return tables.read(path)[1]


def test_the_dataset_is_valid_bids(study: Study) -> None:
    validator = shutil.which(
        "bids-validator-deno", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )
    if validator is None:
        pytest.skip("bids-validator-deno isn't installed")
    words = [validator, "--max-rows", "-1", "--format", "json", str(study.out)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)["issues"]["issues"]
    assert [issue for issue in found if issue["severity"] == "error"] == []
    # What is recommended beside what a lab may tell; docs/bids.md explains each.
    assert {issue["code"] for issue in found} <= {"JSON_KEY_RECOMMENDED", "SIDECAR_KEY_RECOMMENDED"}


def test_every_sample_reads_back_to_the_bit(study: Study) -> None:
    from mne_bids import BIDSPath, read_raw_bids

    for participant, task, seed in (("P001", "calibration", 1), ("P001", "online", 2), ("P002", "online", 3)):
        place = BIDSPath(
            root=study.out, subject=participant, session="S001", task=task, run="001", datatype="eeg", suffix="eeg"
        )
        raw = read_raw_bids(place, verbose="ERROR")
        expected = eeg(seed)[0]
        back = (raw.get_data().T * ([1e6] * 7 + [1])).astype(np.float32)
        np.testing.assert_array_equal(back, expected)
        assert raw.get_channel_types() == ["eeg"] * 6 + ["eog", "misc"]
        assert raw.info["bads"] == ["C3"]
        assert raw.info["line_freq"] == 50
        moves = [note for note in raw.annotations if note["description"].startswith("move/")]
        events = rows_of(place.copy().update(suffix="events", extension=".tsv").fpath)
        wanted = [int(row["sample"]) for row in events if row["trial_type"].startswith("move/")]
        assert raw.time_as_index([note["onset"] for note in moves], use_rounding=True).tolist() == wanted
        assert sum(note["description"] == "move/error" for note in moves) == 2


def test_an_onset_is_at_the_sample_that_the_decoder_takes(study: Study) -> None:
    """Before the gap and after it; where the epoch is spoilt by the gap its onset still has its sample."""
    source = read_source(next(study.recordings.glob("*/*/*/*P001*online*.xdf")), False)
    moves = [row for row in source.events.rows if "action" in row]
    assert len(moves) == N_MOVES
    for row, (_, result) in zip(moves, cut_moves(source.recording, SHAPE), strict=True):
        assert isinstance(result, Epoch) == (row["step"] not in (5, 6))  # an epoch begins 3.4 s before its onset
        if isinstance(result, Epoch):
            assert source.recording.times[row["sample"] - SHAPE.n_before] == result.first_time
        assert abs(source.recording.times[row["sample"]] - (row["stamp"] + 0.25)) <= 0.5 / SFREQ + 1e-9
        assert row["onset"] * SFREQ == row["sample"]


def test_what_is_known_of_a_move_is_in_its_row(study: Study) -> None:
    table = study.eeg() / "sub-P001_ses-S001_task-online_run-001_events.tsv"
    columns, rows = tables.read(table)
    assert columns == [*COLUMNS, "HED"]
    moves = [row for row in rows if row["trial_type"].startswith("move/")]
    third = moves[2]
    expected = {"trial_type": "move/error", "truth": "error", "verdict": "correct", "log_odds": "-1.5", "block": "0"}
    expected |= {"marker": "2", "action": "south", "row": "3", "goal_row": "9", "p_south": "0.7", "distance": "9"}
    expected |= {"policy_took": "correct", "bad_channels": "C3: flat", "clock_offset": "0.25", "verdict_latency": "1.0"}
    assert expected.items() <= third.items()
    assert moves[4]["rejected"].startswith("gap")
    assert moves[4]["log_odds"] == "n/a"
    assert {row["trial_type"] for row in rows} <= set(TRIAL_TYPES)
    assert [row["text"] for row in rows if row["trial_type"] == "note"] == ["info from stimulus: a tab, and µ"]


def test_missing_samples_are_marked_for_mne_and_for_eeglab(study: Study) -> None:
    rows = rows_of(study.eeg() / "sub-P001_ses-S001_task-online_run-001_events.tsv")
    marks = [(row["trial_type"], int(row["sample"]), row["text"]) for row in rows if row["text"].startswith(str(LOST))]
    row = round((106.0 + 15 + 0.25 + 0.1 - 100.0) * SFREQ)
    what = f"{LOST} samples are missing"
    assert marks == [("BAD_gap", row - 1, what), ("boundary", row, what)]
    scans = rows_of(study.eeg().parent / "sub-P001_ses-S001_scans.tsv")
    assert [scan["lost_samples"] for scan in scans] == [str(LOST)] * 2


def test_a_dataset_goes_on_and_what_is_in_it_stays(study: Study) -> None:
    assert [run["state"] for run in study.told[0]["runs"]] == ["written"] * 2
    assert [run["state"] for run in study.told[1]["runs"]] == ["there already"] * 2 + ["written"] * 2
    assert (study.out / "README.md").read_text() == OURS
    people = rows_of(study.out / "participants.tsv")
    assert [(row["participant_id"], row["simulated"], row["age"], row["gaming"]) for row in people] == [
        ("sub-P001", "no", "31", "daily"),
        ("sub-P002", "yes", "n/a", "n/a"),
    ]
    scans = rows_of(study.eeg("P002").parent / "sub-P002_ses-S001_scans.tsv")
    assert [(scan["ended"], scan["simulated"], scan["map"]) for scan in scans] == [("complete", "yes", "open")] * 2
    assert scans[1]["continues"] == "sub-P002_ses-S001_task-online_run-002_eeg.xdf"
    assert json.loads((study.out / "participants.json").read_text())["gaming"]["Description"].startswith("How often")
    for path in study.recordings.rglob("*_eeg.*"):
        kept = study.out / "sourcedata" / path.relative_to(study.recordings)
        assert kept.read_bytes() == path.read_bytes()
    assert not list(study.out.glob(".bci-app-*"))


def test_a_simulated_run_says_so_and_a_run_its_configuration(study: Study) -> None:
    told = json.loads((study.eeg("P002") / "sub-P002_ses-S001_task-online_run-001_eeg.json").read_text())
    assert told["TaskDescription"].startswith("SIMULATED")
    assert told["ErrpBci"]["Configuration"]["chain"]["sfreq"] == 256
    assert "recordings" not in told["ErrpBci"]["Configuration"]
    assert told["ErrpBci"]["Versions"] == {"mne": "1"}
    assert told["EEGReference"] == "FCz"
    real = json.loads((study.eeg() / "sub-P001_ses-S001_task-online_run-001_eeg.json").read_text())
    assert "SIMULATED" not in real["TaskDescription"]


def test_what_the_photodiode_added_to_the_stamps_is_told(tmp_path: Path) -> None:
    stimulus = Config().stimulus.model_copy(update={"photon_delay_ms": 12.5, "set_up": "/lab/set-up.json"})
    path = recorded(tmp_path, "P001", config=Config().model_copy(update={"stimulus": stimulus}))
    told = read_source(path, False).told()
    assert told["PhotonDelayMs"] == 12.5
    assert "set_up" not in told["Configuration"]["stimulus"]
    assert "ErrpBci.PhotonDelayMs" in COLUMNS["stamp"]["Description"]
    path.with_suffix(".json").unlink()
    assert read_source(path, False).told()["PhotonDelayMs"] is None


@pytest.mark.parametrize(
    ("hosts", "clocks", "ahead"),
    [
        ({}, {}, 0.0),
        ({"bci-verdicts": "third"}, {"Amp": [(100.0, -0.25)], "bci-verdicts": [(1e3, -1000.0)]}, 1000.0),
        # It drifts: half-way between two measurements is between their offsets.
        ({"bci-verdicts": "third"}, {"Amp": [(100, -0.25)], "bci-verdicts": [(1100, -998), (1140, -1002)]}, 1000.0),
        ({"bci-verdicts": "amplifier's", "Amp": "amplifier's"}, {}, 0.25),
    ],
)
def test_what_the_decoder_said_is_placed_by_its_own_clock(
    tmp_path: Path, hosts: dict[str, str], clocks: dict[str, list[tuple[float, float]]], ahead: float
) -> None:
    """On a computer whose clock is `ahead` of the stimulus's."""
    words, of = said("online", "P001"), {"session": "s"}
    newest = float(eeg(1)[1][1500])
    looked = Electrodes(episode=0, step=2, n_samples=10, last_time=newest, **of)
    note = Note(role="decoder", level="warning", text="slow", **of)
    mine = [*words["bci-verdicts"], (109.0, looked), (119.999, note)]
    words["bci-verdicts"] = [(stamp + ahead, message) for stamp, message in mine]
    here = read_source(recorded(tmp_path / "one", "P001"), False).events.rows
    path = recorded(tmp_path / "several", "P001", words=words, hosts=hosts, clocks=clocks)
    found = read_source(path, False).events.rows

    moves, expected = ([dict(row) for row in rows if "action" in row] for rows in (found, here))
    after = [row.pop("verdict_after") for row in moves]
    assert [row.pop("verdict_after") for row in expected] == pytest.approx([0.7] * N_MOVES)
    assert after == [None] * N_MOVES if hosts else after == pytest.approx([0.7] * N_MOVES)
    for one, other in zip(moves, expected, strict=True):
        assert one.items() >= (other | {"bad_channels": one["bad_channels"]}).items()
    (slow,) = (row for row in found if row.get("text") == "warning from decoder: slow")
    assert slow["clock_offset"] == pytest.approx(0.25 - ahead, abs=2e-4)
    assert slow["sample"] == int(np.argmin(np.abs(eeg(1)[1] - 120.249)))
    assert slow["block"] == 0
    looks = {row["step"]: row["sample"] for row in found if row["trial_type"] == "electrodes"}
    assert looks[2] == 1500
    if len(clocks.get("bci-verdicts", [])) < 2:
        assert looks[0] == round((105.3 + 0.25 - 100) * SFREQ)


def test_another_recording_of_the_same_name_is_refused(study: Study, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in study.out.rglob("*") if path.is_file()}
    other = recorded(tmp_path, "P001", seed=9)
    told = export_bids([other], study.out, ABOUT, False, quiet)
    assert not told["fit"]
    assert "another recording than the one of the same name" in told["left_out"][0]
    assert {path: path.read_bytes() for path in study.out.rglob("*") if path.is_file()} == before


def test_a_run_that_was_half_written_is_not_overwritten(study: Study, tmp_path: Path) -> None:
    """The recording comes last: without it the run is put together again, and must come out the same."""
    out = tmp_path / "bids"
    shutil.copytree(study.out, out)
    kept = next(out.glob("sourcedata/*/*/*/*P002*run-001*.xdf"))
    kept.unlink()
    (out / ".bci-app-old").mkdir()
    assert export_bids([study.recordings], out, ABOUT, False, quiet)["fit"]
    assert not (out / ".bci-app-old").exists()
    kept.unlink()
    table = next(out.glob("sub-P002/*/*/*run-001_events.tsv"))
    table.write_text("mine")
    told = export_bids([study.recordings], out, ABOUT, False, quiet)
    assert "differs from what sub-P002" in told["left_out"][0]
    assert table.read_text() == "mine"
    assert not kept.exists()


def test_damage_is_refused_unless_it_is_allowed(tmp_path: Path) -> None:
    path = recorded(tmp_path / "in", "P001", footers=False)
    told = export_bids([path], tmp_path / "bids", About(), False, quiet)
    assert "is damaged" in told["left_out"][0]
    assert export_bids([path], tmp_path / "bids", About(), True, quiet)["fit"]
    described = json.loads(next((tmp_path / "bids").glob("sub-*/*/*/*_eeg.json")).read_text())
    assert "cut off before it was closed" in described["ErrpBci"]["Damage"][0]


@pytest.mark.parametrize("kind", ["brainvision", "eeglab"])
def test_one_run_alone(study: Study, tmp_path: Path, kind: Any) -> None:
    import mne

    path = next(study.recordings.glob("*/*/*/*P001*online*.xdf"))
    told = export(path, tmp_path, kind, False, quiet)
    read = mne.io.read_raw_eeglab if kind == "eeglab" else mne.io.read_raw_brainvision
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # MNE warns of boundaries, as it should
        raw = read(told["file"], verbose="ERROR")
    back = (raw.get_data().T * ([1e6] * 7 + [1e6 if kind == "eeglab" else 1])).astype(np.float32)
    np.testing.assert_array_equal(back, eeg(2)[0])
    names = [note["description"].removeprefix("Comment/") for note in raw.annotations]
    assert names.count("move/correct") == 6
    assert names.count("boundary") == 1
    if kind == "eeglab":
        assert raw.annotations.duration[names.index("boundary")] == pytest.approx(LOST / SFREQ)
    events = rows_of(Path(told["table"]))
    wanted = [int(row["sample"]) for row in events if row["trial_type"].startswith("move/")]
    onsets = [n["onset"] for n, name in zip(raw.annotations, names, strict=True) if name.startswith("move/")]
    assert raw.time_as_index(onsets, use_rounding=True).tolist() == wanted
    with pytest.raises(SetupError, match="is there already"):
        export(path, tmp_path, kind, False, quiet)


def described(*channels: tuple[str, str, str]) -> EegDescription:
    names, kinds, units = zip(*channels, strict=True)
    return EegDescription("Amp", "a", "h", names, units, kinds, SFREQ)


def test_signals_keep_what_is_neither_eeg_nor_eog_as_it_came() -> None:
    eeg = described(("Fz", "EEG", "mV"), ("", "AUX", "g"), ("", "AUX", ""), ("E", "EOG", "V"), ("X", "AUX", ""))
    made = signals(eeg, np.array([[1, 2, 3, 4, 5]], dtype=np.int16))
    assert made.names == ("Fz", "MISC2", "MISC3", "E", "X")
    assert made.kinds == ("EEG", "MISC", "MISC", "EOG", "MISC")
    assert made.units == ("µV", "g", "n/a", "µV", "n/a")
    assert made.values.tolist() == [[1000, 2, 3, 4_000_000, 5]]
    assert made.exact


def test_rounding_is_told_and_the_infinite_refused() -> None:
    eeg = described(("Fz", "EEG", "uV"))
    assert not signals(eeg, np.array([[0.1]])).exact
    assert signals(eeg, np.array([[0.1]], dtype=np.float32)).exact
    with pytest.raises(SetupError, match="values in Fz that are infinite"):
        signals(eeg, np.array([[np.inf]]))
    with pytest.raises(SetupError, match="too large for the 32-bit"):
        signals(eeg, np.array([[1e39]]))


UNITS = ("uV", "microvolts", "mV", "V")


@given(
    seed=st.integers(0, 2**32 - 1),
    units=st.tuples(*[st.sampled_from(UNITS)] * 3),
    other=st.sampled_from(["mV", "V", "nV", "uS", "g", ""]),
    dtype=st.sampled_from([np.float32, np.float64, np.int16]),
    extreme=st.lists(st.floats(-(2.0**60), 2.0**60, width=32), max_size=4),
    kind=st.sampled_from(["brainvision", "eeglab"]),
)
@settings(max_examples=40, deadline=None)
def test_what_is_written_is_what_is_compared_in_any_unit(
    seed: int, units: tuple[str, ...], other: str, dtype: Any, extreme: list[float], kind: str
) -> None:
    """Through the real writers and readers: thousands of values, of which some lie between two 32-bit floats."""
    rng = np.random.default_rng(seed)
    samples = (rng.normal(0, 1, (4000, 4)) * 10.0 ** rng.integers(-5, 4, (4000, 1))).astype(dtype)
    if dtype != np.int16:
        samples[: len(extreme)] = np.array(extreme, dtype=dtype)[:, None]
        samples[len(extreme)] = np.nan
    eeg = described(*((f"C{i}", "EEG", unit) for i, unit in enumerate(units)), ("X", "AUX", other))
    made = signals(eeg, samples)
    np.testing.assert_array_equal(made.values[:, :3], eeg.in_microvolts(samples).astype(np.float32))
    with tempfile.TemporaryDirectory() as folder:
        write = files.write_eeglab if kind == "eeglab" else files.write_brainvision
        files.check_same(files.read_back(write(Path(folder), "x", made, [])), made)


@pytest.mark.parametrize(("unit", "factor"), [("mV", 1e3), ("V", 1e6)])
def test_a_recording_in_other_units_is_exported_and_told_to_be_rounded(
    tmp_path: Path, unit: str, factor: float
) -> None:
    from mne_bids import BIDSPath, read_raw_bids

    channels = [(name, kind, unit if given else given) for name, kind, given in CHANNELS]
    path = recorded(tmp_path, "P001", channels=channels)
    told = export_bids([path], tmp_path / "bids", About(), False, quiet)
    assert told["fit"]
    assert told["runs"][0]["samples_are"] == "rounded to 32-bit floats"
    place = BIDSPath(
        root=tmp_path / "bids", subject="P001", session="S001", task="online", run="001", datatype="eeg", suffix="eeg"
    )
    back = read_raw_bids(place, verbose="ERROR").get_data(picks=["eeg", "eog"]).T * 1e6
    expected = (eeg(1)[0][:, :7].astype(np.float64) * factor).astype(np.float32)
    np.testing.assert_array_equal(back.astype(np.float32), expected)
    described = json.loads(place.copy().update(extension=".json").fpath.read_text())
    assert described["ErrpBci"]["SamplesExact"] is False
    for kind in ("brainvision", "eeglab"):
        assert export(path, tmp_path / kind, kind, False, quiet)["samples"] == len(expected)


def test_a_sample_that_reads_back_otherwise_is_an_error_with_its_place(tmp_path: Path) -> None:
    made = signals(described(("Fz", "EEG", "uV"), ("Cz", "EEG", "uV")), np.ones((50, 2), dtype=np.float32))
    path = files.write_brainvision(tmp_path, "x", made, [])
    data = np.fromfile(path.with_suffix(".eeg"), dtype="<f4")
    data[2 * 7 + 1] = 3
    data.tofile(path.with_suffix(".eeg"))
    with pytest.raises(SetupError, match=r"Sample 7 of Cz in x.eeg should read back as 1.0, found 3.0"):
        files.check_same(files.read_back(path), made)
    with pytest.raises(SetupError, match="should read back as 50 samples of Fz, Pz, found 50 of Fz, Cz"):
        files.check_same(files.read_back(path), replace(made, names=("Fz", "Pz")))


@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(2, 3000)), max_size=3, unique_by=lambda hole: hole[0]),
    st.sampled_from([128.0, 250.0, 500.0]),
)
@settings(max_examples=25, deadline=None)
def test_gaps_are_found_where_they_are(holes: list[tuple[int, int]], sfreq: float) -> None:
    holes = [(1500 + 1511 * place, n_lost) for place, n_lost in sorted(holes)]
    places = np.arange(23_000, dtype=float)
    for row, n_lost in holes:
        places[row:] += n_lost
    found = gaps(1000 + places / sfreq, sfreq)
    assert found == [Gap(row, n_lost) for row, n_lost in holes]


def test_time_that_jitters_has_no_gaps() -> None:
    rng = np.random.default_rng(0)
    times = np.arange(100_000) / 500.0 + np.repeat(rng.uniform(0, 0.004, 20_000), 5)
    assert gaps(times, 500.0) == []


def test_events_outside_the_eeg_are_put_at_its_ends() -> None:
    samples, times = eeg(1, lose=False)
    messages = [item for items in said("online", "P001").values() for item in items]
    from bci_app.recording import Stamped

    held = tuple(Stamped(stamp, message) for stamp, message in sorted(messages, key=lambda item: item[0]))
    late = Recording(Path("x.xdf"), described(*CHANNELS), samples[2000:3000], times[2000:3000], held, ())
    found = events(late, SHAPE)
    assert {row["sample"] for row in found.rows} <= set(range(1000))
    assert found.rows[0]["sample"] == 0
    assert found.rows[-1]["sample"] == 999
    seen = [row["trial_type"] != "move/unseen" for row in found.rows if "action" in row]
    inside = [times[2000] <= row["stamp"] + 0.25 <= times[2999] for row in found.rows if "action" in row]
    assert seen == inside
    assert sum(seen) == 1


def test_rows_come_into_a_table_beside_what_others_wrote() -> None:
    old = (["id", "mine"], [{"id": "a", "mine": "1"}])
    columns, rows = tables.merged(old, ["id", "age"], [{"id": "a", "age": 3}, {"id": "b", "age": None}], "id")
    assert columns == ["id", "mine", "age"]
    assert rows == [{"id": "a", "mine": "1", "age": "3"}, {"id": "b", "mine": "n/a", "age": "n/a"}]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[eeg\n", "not valid TOML"),
        ("[eeg]\nRef = 'FCz'", "unknown key 'eeg.Ref'"),
        ("x = 1", "known: dataset"),
        (
            "[participants.P001]\nage = 'thirty'",
            r"'participants\.P001\.age' must be a number of years .*found 'thirty'",
        ),
        ("[participants.P001]\nage = -3", "found -3"),
    ],
)
def test_a_mistake_in_what_the_lab_tells_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "about.toml"
    path.write_text(text)
    with pytest.raises(SetupError, match=says):
        read_about(path)


def test_whom_only_the_lab_tells_of_is_told(study: Study, tmp_path: Path) -> None:
    assert [each["notes"] for each in study.told] == [[], []]
    some = next(study.recordings.glob("*/*/*/*P002*.xdf"))
    about = About.model_validate({"participants": {"P002": {"age": "89+"}, "P02": {"age": 31.5}}})
    assert export_bids([some], tmp_path / "bids", about, False, quiet)["notes"] == [
        "--about tells of P02, of whom there is no recording here. There are some of P002."
    ]


def test_other_verbs_dont_wait_for_the_libraries_of_this_one() -> None:
    look = "import sys, bci_app.cli; sys.exit(str({'mne', 'mne_bids', 'pybv', 'eeglabio'} & set(sys.modules) or ''))"
    assert not subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=False).stderr.strip()


def test_mistakes_are_sentences(study: Study, tmp_path: Path) -> None:
    some = next(study.recordings.glob("*/*/*/*P001*online*.xdf"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    (tmp_path / "empty").mkdir()
    shutil.copy(some, tmp_path / "mine.xdf")
    wrong = tmp_path / some.name.replace("P001", "P003")
    shutil.copy(some, wrong)
    new = tmp_path / "new"
    for paths, out, says in (
        ([tmp_path / "absent"], new, "no recording or folder"),
        ([tmp_path / "empty"], new, "There are no recordings"),
        ([some], tmp_path / "full", "something else than a BIDS dataset"),
        ([some], tmp_path / "full" / "x", "is a file"),
    ):
        with pytest.raises(SetupError, match=says):
            export_bids(paths, out, About(), False, quiet)
    left_out = export_bids([tmp_path / "mine.xdf", wrong], new, About(), False, quiet)["left_out"]
    assert "must be named as in" in left_out[0]
    assert "is called online of P003, and holds online of P001" in left_out[1]
    assert not new.exists()
    done = CliRunner().invoke(app, ["export-bids", str(wrong), "--out", str(new)])
    assert done.exit_code == 2
    assert "P003" in done.output
    (tmp_path / "file").touch()
    for what, out, says in (
        (tmp_path / "absent.xdf", new, "There is no recording"),
        (tmp_path / "empty", new, "export-bids takes folders"),
        (some, tmp_path / "file", "is a file; --out must be a folder"),
        (tmp_path / "mine.xdf", new, "must be named as in"),
    ):
        with pytest.raises(SetupError, match=says):
            export(what, out, "eeglab", False, quiet)
    done = CliRunner().invoke(app, ["export", str(some), "--out", str(new), "--format", "edf"])
    assert done.exit_code == 2
    assert "--format must be brainvision or eeglab" in done.output
