"""The report: its numbers are those that were told before, its page needs nothing else, bad input is said to be bad."""

import csv
import json
import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from browsing import CHROMIUM, chromium, complaints
from recorded_by_hand import BETWEEN_S, Wish, messages, recording, without, write
from typer.testing import CliRunner

from bci_app import fitting, metrics
from bci_app.cli import app
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.protocol import (
    STREAMS,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    LateFrame,
    Link,
    Note,
    Pause,
    Resume,
    Returned,
    SessionEnd,
    SessionStart,
    Truth,
    Verdict,
)
from bci_app.recording import Recording, SenderClock, Stamped, read
from bci_app.report import Tables, contents, in_a_row, making, merged, study, those, words
from bci_app.report.drawing import Drawn
from bci_app.report.sources import Source, Visit, free_folder, missing, visits
from bci_app.report.visits import see_recordings
from bci_app.runs import checksum

EEG = "sub-P001/ses-S001/eeg/sub-P001_ses-S001_task-{}_run-{:03d}_eeg.xdf"
WISHES = (Wish(), Wish("online", "open", 4, 12, 0.3, 2), Wish("online", "obstacles", 4, 12, 0.3, 3))


def nothing(*_: object) -> None:
    """Nobody looks at progress here."""


def put(folder: Path, whole: Recording, task: str, number: int, **sidecar: Any) -> Path:
    """A recording and its sidecar, where a run would put them."""
    path = write(whole, folder / EEG.format(task, number))
    told = {"participant": "P001", "speed": 2.0, "simulated": True, "state": "closed", **sidecar}
    path.with_suffix(".json").write_text(json.dumps(told), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def whole() -> list[Recording]:
    return [recording(wish) for wish in WISHES]


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory: pytest.TempPathFactory, whole: list[Recording]) -> tuple[Path, dict[str, Any]]:
    """A calibration, its decoder, a run on each map; and what `fit` told."""
    folder = tmp_path_factory.mktemp("recordings")
    fitted = fitting.fit([put(folder, whole[0], "calibration", 1)], Config(), False, nothing)
    used = {
        "model": {"path": fitted["model"], "sha256": checksum(Path(fitted["model"]))},
        "policy": {"path": "open_told.safetensors"},
    }
    for number, each in enumerate(whole[1:], 1):
        put(folder, each, "online", number, **used)
    (folder / "notes.txt").write_text("of the lab")
    write(replace(whole[0], messages=(), markers=()), folder / "sub-P002" / "somebody_elses.xdf")
    return folder, fitted


@pytest.fixture(scope="module")
def made(study_folder: tuple[Path, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder, _ = study_folder
    return making.make([folder], tmp_path_factory.mktemp("out") / "report", False, nothing)


def table(made: dict[str, Any], name: str) -> list[dict[str, Any]]:
    path = Path(made["report"]).parent / "tables" / f"{name}.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return rows


def tables_of(*recordings: Recording, sidecar: dict[str, Any] | None = None) -> Tables:
    """The tables of a visit that never was on a disk."""
    runs = tuple((Source(each.path, sidecar or {}, "P001", "S001"),) for each in recordings)
    seen = see_recordings(Visit("P001", "S001", runs), [[each] for each in recordings])
    return study.complete(merged([seen.tables]))


def said(tables: Tables) -> str:
    return "\n".join(f"{row['kind']}: {row['text']}" for row in tables["events"])


# What it says.


def test_the_numbers_are_those_that_fit_and_online_tell(made: Any, study_folder: Any, whole: list[Recording]) -> None:
    (session,) = json.loads((Path(made["report"]).parent / "report.json").read_text(encoding="utf-8"))["sessions"]
    assert session["calibration"] == json.loads(json.dumps(study_folder[1]["calibration"]))
    assert session["online"] == {"open": metrics.online([whole[1]]), "obstacles": metrics.online([whole[2]])}
    assert session["latency"] == metrics.latencies(whole[1:], 2.0)
    assert made["participants"] == 1
    assert (made["recordings"], len(made["left_out"])) == (3, 1)
    assert "somebody_elses" in made["left_out"][0]


def test_tables_hold_the_same_numbers_as_the_figures(made: Any, study_folder: Any, whole: list[Recording]) -> None:
    (one,) = those(table(made, "table_1"), series="ours")
    fitted = study_folder[1]["calibration"]
    assert one["tenfold_accuracy"] == fitted["tenfold"]["accuracy"]["value"]
    assert one["contiguous_auc_low"] == fitted["blocked"]["auc"]["low"]
    told = metrics.online([whole[1]])
    assert one["open_accuracy"] == told["verdict_accuracy"]
    assert one["open_balanced_accuracy"] == told["verdict_balanced_accuracy"]
    (two,) = those(table(made, "table_2"), series="ours")
    assert (two["open_success"], two["open_mean_steps_all"]) == (told["success"], told["mean_steps"])
    (counts,) = those(table(made, "confusion"), source="open")
    found = metrics.confusion(whole[1])
    assert [counts[name] for name in ("hits", "misses", "false_alarms")] == [
        found.hits,
        found.misses,
        found.false_alarms,
    ]
    published = those(table(made, "table_2"), participant="S10")
    assert published[0]["obstacles_mean_steps"] == 23.61
    (ours,) = those(table(made, "table_a_open"), series="ours")
    steps = [int(n) for name, value in ours.items() if name.startswith("distance_") for n in value.split(", ")]
    assert sorted(steps) == sorted(end.steps for _, end in whole[1].of(EpisodeEnd))


def test_a_table_is_the_same_as_csv_and_as_json(made: Any) -> None:
    folder = Path(made["report"]).parent / "tables"
    names = {path.stem for path in folder.glob("*.json")}
    assert names == {path.stem for path in folder.glob("*.csv")}
    for name in names:
        with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        written = table(made, name)
        assert len(rows) == len(written)
        for key, value in written[0].items():
            assert rows[0][key] == ("" if value is None else str(value))


def test_every_table_and_column_is_in_the_docs(made: Any) -> None:
    text = (Path(__file__).parents[1] / "docs" / "report.md").read_text(encoding="utf-8")
    for path in (Path(made["report"]).parent / "tables").glob("*.json"):
        name = "table_a_MAP" if path.stem.startswith("table_a_") else path.stem
        assert f"### `{name}`" in text, name
        part = text.split(f"### `{name}`")[1].split("\n### ")[0]
        for column in {column for row in table(made, path.stem) for column in row}:
            plain = re.sub(r"_(low|high)$", "", column)
            alike = re.sub(
                r"^(tenfold|contiguous|open|obstacles)_", "SOURCE_", re.sub(r"distance_\d+", "distance_N", plain)
            )
            assert f"`{plain}`" in part or f"`{alike}`" in part or f"`{column}`" in part, (name, column)


# The page.


class Page(HTMLParser):
    """What matters of a page: headings, images, links, tables."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.images: list[dict[str, str | None]] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.scopes = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.headings += [int(tag[1])] if re.fullmatch("h[1-6]", tag) else []
        self.images += [given] if tag == "img" else []
        self.references += [str(given[name]) for name in ("src", "href") if name in given]
        self.ids += [str(given["id"])] if "id" in given else []
        self.scopes += tag == "th" and given.get("scope") in ("row", "col")


@pytest.fixture(scope="module")
def page(made: Any) -> tuple[str, Page]:
    text = Path(made["report"]).read_text(encoding="utf-8")
    return text, Page(text)


def test_the_page_needs_no_network(page: tuple[str, Page]) -> None:
    text, parsed = page
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    assert "<script" not in text
    assert all(reference.startswith(("data:", "#")) for reference in parsed.references)
    assert {reference[1:] for reference in parsed.references if reference[0] == "#"} <= set(parsed.ids)
    for image in parsed.images:
        svg = b64decode(str(image["src"]).partition("base64,")[2])
        root = ElementTree.fromstring(svg)
        links = [value for node in root.iter() for name, value in node.attrib.items() if name.endswith("href")]
        assert all(link.startswith(("#", "data:")) for link in links)
        assert b"<!DOCTYPE" not in svg
        assert b"<metadata" not in svg


def test_the_page_can_be_read_without_seeing_it(page: tuple[str, Page]) -> None:
    text, parsed = page
    assert len(parsed.images) >= 12
    assert all(len(image["alt"] or "") > 40 for image in parsed.images)
    assert parsed.headings[0] == 1
    assert parsed.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(parsed.headings, parsed.headings[1:], strict=False))
    assert len(set(parsed.ids)) == len(parsed.ids)
    assert parsed.scopes > 100
    assert '<html lang="en">' in text
    assert "nan" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", text).lower().replace("finance", "")


def test_the_page_tells_when_and_by_what_it_was_made_and_how_fast_sessions_were(page: tuple[str, Page]) -> None:
    text, _ = page
    (foot,) = re.findall(r"<footer>(.*)</footer>", text)
    assert re.fullmatch(rf"Made on \d{{4}}-\d\d-\d\d at \d\d:\d\d \(.+\) by bci-app {version('errp-bci')}\.", foot)
    assert text.count("<td>simulated, speed 2</td>") == len(WISHES)


def test_no_heading_is_said_twice_and_no_mark_is_left_raw(page: tuple[str, Page]) -> None:
    text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page[0])
    above = re.findall(r"<summary>(.*?)</summary>", text)
    assert any(name.startswith("Ways on") for name in above)
    assert not set(above) & set(re.findall(r"<h3>(.*?)</h3>", text))
    assert "`" not in text


def luminance(colour: str) -> float:
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


def test_letters_stand_out_in_light_and_dark(page: tuple[str, Page]) -> None:
    """WCAG 2.2, 1.4.3: a contrast of 4.5 at least; here 7, its stricter 1.4.6."""
    found = re.findall(r":root \{ (--paper.*?) \}", page[0])
    assert len(found) == 3
    for palette in found[:2]:
        colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", palette))
        for ground in ("paper", "band"):
            for letters in ("ink", "quiet", "link"):
                light, dark = sorted((luminance(colours[ground]), luminance(colours[letters])), reverse=True)
                assert (light + 0.05) / (dark + 0.05) >= 7 - (ground == "band"), (ground, letters)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_browser_finds_nothing_that_keeps_anybody_from_reading_it(made: Any) -> None:
    address = Path(made["report"]).as_uri()
    with chromium() as browser:
        page = browser.new_page()
        for width, scheme in ((1280, "light"), (390, "dark")):
            page.set_viewport_size({"width": width, "height": 844})
            page.emulate_media(color_scheme=scheme)
            page.goto(address)
            assert complaints(page) == []
            assert page.evaluate("document.documentElement.scrollWidth") == width
        page.emulate_media(media="print")
        heights = page.evaluate("[...document.images].map(image => image.getBoundingClientRect().height)")
        assert max(heights) <= 14 / 2.54 * 96 + 1
        for what in ("thead", "tr", "figure", ".short"):
            kept = page.evaluate(f"getComputedStyle(document.querySelector('{what}')).breakInside")
            assert kept == "avoid", what


def test_figures_are_there_for_publication(made: Any) -> None:
    folder = Path(made["report"]).parent / "figures"
    names = {path.stem for path in folder.glob("*.svg")}
    assert len(names) == made["figures"]
    assert {"erp_online", "erp_maps_online", "erp_areas", "verdicts_decisions", "online_areas", "electrodes"} <= names
    for name in names:
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert ElementTree.parse(folder / f"{name}.svg").getroot().tag.endswith("svg")


# Where it goes.


def test_nothing_is_overwritten(made: Any, study_folder: Any, tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="is there already, and nothing is overwritten"):
        making.make([study_folder[0]], Path(made["report"]).parent, False, nothing)
    (tmp_path / "file").touch()
    with pytest.raises(SetupError, match="isn't a folder that may be written into"):
        making.make([study_folder[0]], tmp_path / "file" / "report", False, nothing)
    if Path("/proc/version").exists():  # whose folder nobody may write into, not even the administrator
        with pytest.raises(SetupError, match=r"into /proc/x: /proc isn.t a folder that may be"):
            making.make([study_folder[0]], Path("/proc/x"), False, nothing)
    (tmp_path / "report").mkdir()
    assert free_folder(tmp_path) == tmp_path / "report-2"


def test_runs_that_go_on_from_each_other_come_together() -> None:
    def of(name: str, *before: str) -> Source:
        return Source(Path(name), {"continues": list(before)}, "P001", "S001")

    first, second, third, other = of("a"), of("b", "a"), of("c", "a", "b"), of("d")
    (visit,) = visits([third, other, second, first])
    assert visit.runs == ((first, second, third), (other,))
    assert not missing(visit.runs[0])
    assert missing([third]) == ["a", "b"]
    parts = visits([of("a"), Source(Path("e"), {}, "P002", "S001"), Source(Path("f"), {}, "P001", "S002")])
    assert [(part.participant, part.visit) for part in parts] == [("P001", "S001"), ("P001", "S002"), ("P002", "S001")]


# Bad input.


def test_what_is_no_recording_of_ours_is_refused(study_folder: Any, tmp_path: Path) -> None:
    folder = study_folder[0]
    with pytest.raises(SetupError, match="isn't our experiment's run"):
        making.make([folder / "sub-P002" / "somebody_elses.xdf"], tmp_path / "out", False, nothing)
    with pytest.raises(SetupError, match="None of the 1 recordings is of this experiment"):
        making.make([folder / "sub-P002"], tmp_path / "out", False, nothing)
    with pytest.raises(SetupError, match="is not an XDF recording"):
        making.make([folder / "notes.txt"], tmp_path / "out", False, nothing)
    with pytest.raises(SetupError, match=r"There is no recording .*absent\.xdf"):
        making.make([folder / "absent.xdf"], tmp_path / "out", False, nothing)
    with pytest.raises(SetupError, match="holds no recording"):
        making.make([tmp_path], tmp_path / "out", False, nothing)
    assert not (tmp_path / "out").exists()


def test_a_run_that_never_began_is_left_out_of_a_folder(whole: list[Recording], tmp_path: Path) -> None:
    good = put(tmp_path, whole[1], "online", 1)
    false_start = put(tmp_path, without(whole[1], SessionStart), "online", 2)
    silent = put(tmp_path, replace(whole[1], samples=whole[1].samples[:0], times=whole[1].times[:0]), "online", 3)
    done = making.make([tmp_path], tmp_path / "out", False, nothing)
    assert done["recordings"] == 1
    assert all(path.name in said for path, said in zip([false_start, silent], done["left_out"], strict=True))
    assert [row["recordings"] for row in table(done, "runs")] == [good.name]
    for path, says in ((false_start, "holds no SessionStart"), (silent, "exactly one EEG stream with samples")):
        with pytest.raises(SetupError, match=says):
            making.make([tmp_path, path], tmp_path / "other", False, nothing)


def test_a_damaged_recording_is_used_only_when_asked(whole: list[Recording], tmp_path: Path) -> None:
    path = put(tmp_path, whole[1], "online", 1)
    contents = path.read_bytes()
    path.write_bytes(contents[: len(contents) // 3])
    with pytest.raises(SetupError, match="--allow-damage"):
        making.make([path], None, False, nothing)
    tables = tables_of(read(path, allow_damage=True))
    assert "damage: The file was cut off before it was closed" in said(tables)
    assert contents_of(tables)


def contents_of(tables: Tables) -> dict[str, Any]:
    """All figures that can be drawn of some tables, drawn; and the page's parts."""
    drawn = {name: found for name, draw in contents.drawings(tables) if (found := draw()) is not None}
    assert contents.sections(tables, {}, [])
    return drawn


def test_a_calibration_of_one_class_is_said_to_be_one(whole: list[Recording]) -> None:
    right = tuple(
        Stamped(item.stamp, item.message.model_copy(update={"error": False}))
        if isinstance(item.message, Truth)
        else item
        for item in whole[0].messages
    )
    tables = tables_of(replace(whole[0], messages=right))
    assert "A decoder needs at least 20 error epochs; this calibration has 0" in said(tables)
    drawn = contents_of(tables)
    assert "erp_calibration" not in drawn
    assert "verdicts_accuracy" not in drawn


def test_without_a_truth_there_are_ways_and_steps(whole: list[Recording]) -> None:
    tables = tables_of(without(whole[1], Truth, EpisodeGoal))
    assert "There is no truth" in said(tables)
    assert "There is no sidecar" in said(tables)
    assert "Its decoder isn't there" in said(tables)
    (two,) = those(tables["table_2"], series="ours")
    assert two["open_n_episodes"] == 4
    assert not tables.get("scores")
    assert {"ways_P001_S001_by-hand", "latencies"} <= set(contents_of(tables))


@pytest.mark.parametrize("protocol", [1, 2, 3, 4])
def test_older_recordings_are_read(whole: list[Recording], tmp_path: Path, protocol: int) -> None:
    """What a protocol hadn't is missing, and everything else is there."""
    old = whole[1] if protocol > 2 else without(whole[1], Electrodes)
    if protocol == 1:
        plain = (
            Stamped(i.stamp, i.message.model_copy(update={"evidence": None})) if isinstance(i.message, Verdict) else i
            for i in old.messages
        )
        old = replace(old, messages=tuple(plain))
    tables = tables_of(read(write(old, tmp_path / "old.xdf", protocol)))
    assert those(tables["scores"], source="open", measure="accuracy")
    assert bool(tables.get("reliability")) == (protocol > 1)
    assert bool(tables["electrodes"]) == (protocol > 2)


def test_what_went_wrong_is_told(whole: list[Recording]) -> None:
    at, about = whole[1].messages[40].stamp, {"session": "by-hand"}
    extra = [
        Stamped(at, Note(role="decoder", level="warning", text="The EEG drifts.", **about)),
        Stamped(at + 1, Pause(reason="P was pressed.", by_person=True, **about)),
        Stamped(at + 8, Resume(**about)),
        Stamped(at + 9, Returned(role="policy", **about)),
        Stamped(at + 9.5, Returned(role="policy", **about)),
        Stamped(at + 10, Continued(episode=1, step=2, **about)),
        Stamped(at + 11, LateFrame(episode=0, step=3, late_ms=17.0, **about)),
        Stamped(at + 12, LateFrame(episode=0, late_ms=4.0, **about)),
        Stamped(at + 13, Link(role="decoder", stream="Amp", age_s=0.0, gaps=2, reconnects=1, **about)),
        Stamped(at + 13.5, Link(role="decoder", stream="Amp", age_s=0.0, gaps=1, reconnects=0, **about)),
        Stamped(at + 14, Pause(reason="The amplifier is gone.", **about)),
    ]
    ended = [item for item in whole[1].messages if not isinstance(item.message, SessionEnd)]
    gap = np.r_[:9000, 10000 : len(whole[1].times)]
    spoilt = replace(
        whole[1],
        messages=tuple(sorted([*ended, *extra], key=lambda item: item.stamp)),
        samples=whole[1].samples[gap],
        times=whole[1].times[gap],
    )
    tables = tables_of(spoilt, sidecar={"state": "recording", "missing": ["3 verdicts are missing."]})
    lines = said(tables)
    for sentence in (
        "note: The EEG drifts.",
        "pause: Paused for 7.0 s: P was pressed.",
        "pause: Paused until the end: The amplifier is gone.",
        "restart: The policy was started again.",
        "restart: The stimulus went on after step 2 of episode 1.",
        "late frame: 2 frames came late, 1 of them with a jump; the worst by 17.0 ms.",
        "link: Stream Amp: gaps in its samples 3, times it was away 1.",  # the decoder was started again
        "gap: The EEG has 1 gap of a second or more, 4.0 s together.",
        "end: The recording has no end",
        "damage: 3 verdicts are missing.",
        "file: The run was never closed: its sidecar says recording.",
    ):
        assert sentence in lines
    assert lines.count("The policy was started again") == 1
    (lost,) = those(tables["waveforms"], source="online")
    assert lost["n_without"] > 0
    (late,) = those(tables["latency"], what="late frame")
    assert (late["n"], late["max_ms"]) == (2, 17.0)


def test_that_a_run_was_gone_on_with_is_a_note(whole: list[Recording]) -> None:
    end = {"reason": "interrupted", "text": "Stopped by the experimenter."}
    messages = tuple(
        Stamped(item.stamp, item.message.model_copy(update=end)) if isinstance(item.message, SessionEnd) else item
        for item in whole[1].messages
    )
    first = replace(whole[1], messages=messages, path=Path(EEG.format("online", 1)))
    second = replace(whole[1], path=Path(EEG.format("online", 2)))
    for broken, how in (
        (first, "was interrupted: Stopped by the experimenter."),
        (without(first, SessionEnd), "was broken off, or its recorder was."),
    ):
        run = tuple(Source(each.path, {}, "P001", "S001") for each in (broken, second))
        (told,) = those(
            see_recordings(Visit("P001", "S001", (run,)), [[broken, second]]).tables["events"],
            kind="end",
        )
        assert (told["level"], told["text"]) == ("info", f"Online 001 {how} It went on in online 002.")
        (alone,) = those(tables_of(broken)["events"], kind="end")
        assert alone["level"] == "error"


def test_without_a_decoder_beside_it_nobody_says_that_none_was_fitted(whole: list[Recording]) -> None:
    lines = said(tables_of(whole[0]))
    assert "No decoder lies beside it" in lines
    assert "fitted" not in lines


def test_somebody_who_only_opened_a_run_is_refused(whole: list[Recording]) -> None:
    with pytest.raises(SetupError, match="holds no SessionStart"):
        tables_of(without(whole[1], SessionStart))


def test_a_study_has_means_and_tests_over_participants(made: Any) -> None:
    """Seven times the same person, a little different each time: rows of each, and of all."""
    names = [path.stem for path in (Path(made["report"]).parent / "tables").glob("*.json")]
    own = {name: those(table(made, name), participant="P001") for name in names if name not in study_only(names)}
    people = []
    for number in range(7):
        rng = np.random.default_rng(number)
        mine = {name: [dict(row, participant=f"P{number}") for row in rows] for name, rows in own.items()}
        for row in mine["erp"]:
            row["mean_uv"] += rng.normal(0, 0.2)
        for row in mine["area_test"]:
            row["difference"] += 0.05 + rng.normal(0, 0.02)
        for row in mine["errors_in_a_row_trend"]:
            row["slope"] += rng.normal(0, 0.2)
        people.append(mine)
    people[0]["maps"] = table(made, "maps")
    tables = study.complete(merged(people))
    assert len(those(tables["table_1"], series="ours")) == 8
    (mean,) = [row for row in tables["table_2"] if (row["series"], row["participant"]) == ("ours", "mean")]
    assert mean["open_mean_steps_all"] == pytest.approx(table(made, "table_2")[0]["open_mean_steps_all"])
    tests = those(tables["area_test"], participant="all")
    assert {row["map"] for row in tests} == {"open", "obstacles"}
    assert all(row["n"] == 7 and row["test"].startswith("Wilcoxon") for row in tests)
    waves = those(tables["erp_average"], source="online", area="all", condition="difference", channel="Fz")
    single = those(own["erp"], source="online", area="all", condition="difference", channel="Fz")
    assert waves[100]["mean_uv"] == pytest.approx(single[100]["mean_uv"], abs=0.3)
    assert those(tables["erp_clusters"], participant="all", unit="participants")
    assert those(tables["errors_in_a_row"], participant="all", source="online")
    draw = dict(contents.drawings(tables))
    for name, says in (
        ("erp_online", "7 participants"),
        ("online_areas", "Wilcoxon"),
        ("verdicts_accuracy", "in the mean"),
    ):
        drawn = draw[name]()
        assert drawn is not None
        assert says in drawn.alt


def several(made: dict[str, Any], number: int) -> Tables:
    """The made report's session as so many participants', each a little different."""
    names = [path.stem for path in (Path(made["report"]).parent / "tables").glob("*.json")]
    own = {name: table(made, name) for name in names if name not in study_only(names)}
    people = [
        {name: [dict(row, participant=f"P{n}") for row in rows] for name, rows in own.items()} for n in range(number)
    ]
    for n, mine in enumerate(people):
        for row in mine["errors_in_a_row"]:
            row["mean"] += n
        mine["learning_curve"] = [learnt(f"P{n}", epochs, 0.01 * n) for epochs in (40, 80, 120)]
    people[0]["maps"] = table(made, "maps")
    return study.complete(merged(people))


def learnt(who: str, epochs: int, more: float) -> dict[str, Any]:
    """What is expected after a block of a calibration that is long enough to tell."""
    expected = {f"balanced_accuracy{end}": 0.6 + epochs / 1000 + more + wide for end, wide in BOUNDS.items()}
    where = {"participant": who, "visit": "S001", "run": "calibration 001", "map": "open"}
    return {**where, "n_epochs": epochs, **expected, "sentence": f"After {epochs} epochs."}


BOUNDS = {"": 0.0, "_low": -0.05, "_high": 0.05}


def figure_of(tables: Tables, name: str) -> Drawn:
    found = dict(contents.drawings(tables))[name]()
    assert found is not None
    return found


PROMISES = {
    "erp_online": ("Grey bars",),
    "erp_areas": ("Shaded", "Bands"),
    "calibration_learning_curve": ("the band",),
    "verdicts_decisions": ("bars are Wilson's",),
}


def test_a_caption_names_only_what_is_drawn(made: Any) -> None:
    one, two = several(made, 1), several(made, 2)
    for name, promises in PROMISES.items():
        assert not any(promise in figure_of(two, name).caption for promise in promises), name
    assert "isn't tested, for that needs 6 participants" in figure_of(two, "erp_online").caption
    for name in ("calibration_learning_curve", "verdicts_decisions"):
        assert PROMISES[name][0] in figure_of(one, name).caption
    areas = figure_of(one, "erp_areas")
    patches = [len(axes.patches) for axes in areas.figure.axes]
    assert ("Shaded" in areas.caption) == any(patches)
    assert "Bands" in areas.caption


def test_learning_curves_have_their_participants_names(made: Any) -> None:
    two = figure_of(several(made, 2), "calibration_learning_curve").figure
    assert [text.get_text() for text in two.legends[0].get_texts()] == ["P0", "P1"]
    assert len({line.get_color() for line in two.axes[0].lines}) == 2
    tables = several(made, 8)
    *each, mean = figure_of(tables, "calibration_learning_curve").figure.axes[0].lines
    assert len(each) == 8
    assert len({line.get_color() for line in each}) == 1
    assert mean.get_ydata() == pytest.approx(np.mean([line.get_ydata() for line in each], axis=0))
    assert mean.get_linewidth() > each[0].get_linewidth()


def test_the_papers_gate_is_drawn_where_plain_accuracies_are(made: Any) -> None:
    def gates(figure: Any) -> list[list[float]]:
        lines = [[line for line in axes.lines if set(line.get_ydata()) == {70.0}] for axes in figure.axes]
        return [[float(x) for line in mine for x in line.get_xdata()] for mine in lines]

    first, *others = gates(figure_of(several(made, 2), "verdicts_accuracy").figure)
    assert first == [0, 1]
    assert others == [[], []]
    assert gates(figure_of(several(made, 1), "verdicts_accuracy").figure) == [[-0.4, 0.4]]
    assert gates(figure_of(several(made, 2), "calibration_learning_curve").figure) == [[]]


def test_results_by_area_tell_whose_they_are(made: Any) -> None:
    two = figure_of(several(made, 2), "online_areas").caption
    assert "P0, open map: central" in two
    assert "P1, map with obstacles: central" in two
    assert "P0" not in figure_of(several(made, 1), "online_areas").caption


def test_over_two_participants_there_is_a_value_and_no_interval(made: Any) -> None:
    tables = several(made, 2)
    for name, value, low in (("erp_peaks", "mean_uv", "low_uv"), ("errors_in_a_row", "mean", "low")):
        rows = those(tables[name], participant="all")
        assert rows
        assert all(row[value] is not None and row[low] is None and row["unit"] == "participants" for row in rows)
        assert {row["unit"] for row in those(tables[name], participant="P0")} == {"moves"}
    for grid in (words.peaks(tables), words.levels(tables)):
        assert grid is not None
        mine = [row for row in grid.rows if row[0] == "all"]
        assert all(any(cell.endswith("[–]") for cell in row) for row in mine)
        assert {cell for row in mine for cell in row if "participant" in cell} <= {"1 participant", "2 participants"}
        assert "[–, –]" not in str(grid.rows)
    about = {**those(tables["errors_in_a_row"], participant="P0")[0], "errors_in_a_row": in_a_row.LAST}
    last = words.levels({"errors_in_a_row": [about]})
    assert last is not None
    assert last.rows[0][2] == f"{in_a_row.LAST} or more"


def visits_of_one(made: dict[str, Any], *visits: str) -> Tables:
    """The made report's session as several visits of its participant, each a microvolt above the one before."""
    names = [path.stem for path in (Path(made["report"]).parent / "tables").glob("*.json")]
    own = {name: table(made, name) for name in names if name not in study_only(names)}
    several = []
    for number, visit in enumerate(visits):
        mine = {name: [dict(row, visit=visit) for row in rows] for name, rows in own.items()}
        for row in mine["erp"]:
            row |= {name: row[name] + number for name in ("mean_uv", "low_uv", "high_uv")}
        several.append(mine)
    several[0]["maps"] = table(made, "maps")
    return study.complete(merged(several))


def test_two_visits_of_one_participant_are_drawn_as_their_mean(made: Any) -> None:
    tables = visits_of_one(made, "S001", "S002")
    draw = dict(contents.drawings(tables))
    for name in ("erp_online", "erp_areas", "erp_errors_in_a_row"):
        drawn = draw[name]()
        assert drawn is not None
        curves = [
            line.get_xdata()
            for axes in drawn.figure.axes
            for line in axes.lines
            if line.get_marker() != "None" or len(line.get_xdata()) > 2
        ]
        assert curves
        assert all((np.diff(np.asarray(curve, dtype=float)) > 0).all() for curve in curves), name
    where = {"source": "online", "area": "all", "condition": "error", "channel": "Fz"}
    first, both = those(table(made, "erp"), **where)[50], those(tables["erp_average"], **where, visit="mean")[50]
    assert both["mean_uv"] == pytest.approx(first["mean_uv"] + 0.5)
    assert both["high_uv"] - both["mean_uv"] == pytest.approx((first["high_uv"] - first["mean_uv"]) / 2**0.5)
    assert (both["participant"], both["n"]) == ("P001", 2 * first["n"])
    assert those(tables["erp_peaks"], source="online", visit="mean")
    where = {"source": "online", "errors_in_a_row": 1}
    (one,), (two,) = (
        those(table(made, "errors_in_a_row"), **where),
        those(tables["errors_in_a_row"], **where, visit="mean"),
    )
    assert two["mean"] == pytest.approx(one["mean"])
    assert two["n"] == 2 * one["n"]
    assert two["high"] - two["low"] < one["high"] - one["low"]
    sentences = " ".join(contents.summary(tables, [{}, {}]))
    assert "In the mean over visits" in sentences
    assert "Participants have several visits (S001, S002)" in sentences


def test_the_p_told_of_the_areas_is_the_least(made: Any) -> None:
    tables = visits_of_one(made, "S001")
    about = next(row for row in tables["erp_clusters"] if row["source"] == "online" and row["channel"] == "FCz")
    found = {**about, "comparison": "error, central - edge", "begin_ms": 200.0, "end_ms": 300.0}
    tables["erp_clusters"] = [{**found, "p": 0.003}, {**found, "p": 0.041}]
    drawn = dict(contents.drawings(tables))["erp_areas"]()
    assert drawn is not None
    assert "p = 0.003 at the least" in drawn.alt


def test_two_runs_on_a_map_are_taken_together_in_table_one(whole: list[Recording]) -> None:
    again = recording(Wish("online", "open", 4, 12, 0.3, 7))
    again = replace(again, path=Path("again.xdf"))
    tables = tables_of(whole[1], again)
    (one,) = those(tables["table_1"], series="ours")
    told = metrics.online([whole[1], again])
    assert one["open_accuracy"] == pytest.approx(told["verdict_accuracy"])
    assert one["open_balanced_accuracy"] == pytest.approx(told["verdict_balanced_accuracy"])
    (single,) = those(tables_of(whole[1])["table_1"], series="ours")
    assert one["open_auc_high"] - one["open_auc_low"] < single["open_auc_high"] - single["open_auc_low"]


def test_of_two_calibrations_the_last_one_s_scores_are_in_table_one(whole: list[Recording]) -> None:
    again = replace(recording(Wish(seed=8)), path=Path("by-hand-again.xdf"))
    tables = tables_of(whole[0], again)
    (one,) = those(tables["table_1"], series="ours")
    (alone,) = those(tables_of(again)["table_1"], series="ours")
    assert one["contiguous_balanced_accuracy"] == alone["contiguous_balanced_accuracy"]
    assert "the figures of the whole visit are the last one's" in said(tables)


def elsewhere(whole: Recording, apart: float, *, host: str = "decodes", is_told: bool = True) -> Recording:
    """As if the decoder had run on another machine, its clock so many seconds ahead and drifting."""

    def ahead(stamp: float) -> float:
        return apart + 1e-4 * stamp

    said = [
        Stamped(item.stamp + ahead(item.stamp), item.message)
        if isinstance(item.message, Verdict | Electrodes)
        else item
        for item in whole.messages
    ]
    note = Note(role="decoder", level="warning", text="The EEG drifts.", session="by-hand")
    said.append(Stamped(100.0 + ahead(100.0), note))
    measured = np.arange(0, whole.messages[-1].stamp + 5, 5.0)
    times, offsets = (measured + ahead(measured)).tolist(), (-ahead(measured)).tolist()
    theirs = SenderClock(host, tuple(times), tuple(offsets)) if is_told else SenderClock(host)
    ours = SenderClock("leads", tuple(measured.tolist()), (0.0,) * len(measured)) if is_told else SenderClock("leads")
    clocks = {spec.name: theirs if spec.role == "decoder" else ours for spec in STREAMS}
    return replace(whole, messages=tuple(sorted(said, key=lambda item: item.stamp)), clocks=clocks)


@pytest.mark.parametrize(("apart", "host"), [(-5000.0, "decodes"), (80_000.0, "leads"), (0.001, "decodes")])
def test_stamps_of_two_machines_are_compared_on_one_clock(whole: list[Recording], apart: float, host: str) -> None:
    """Two machines may have the same name."""
    tables = tables_of(elsewhere(whole[1], apart, host=host))
    for what in ("action", "verdict after onset"):
        (here,), (there,) = (those(each["latency"], what=what) for each in (tables_of(whole[1]), tables))
        assert there["n"] == here["n"]
        assert there["p50_ms"] == pytest.approx(here["p50_ms"], abs=0.1)
    (note,) = those(tables["events"], kind="note")
    assert note["time_s"] == pytest.approx(100.0 - whole[1].messages[0].stamp, abs=0.01)


def test_stamps_of_two_clocks_that_nobody_compared_aren_t_subtracted(whole: list[Recording]) -> None:
    run = elsewhere(whole[1], -5000.0, is_told=False)
    tables = tables_of(run)
    assert {row["what"] for row in tables["latency"]} == {"verdict", "time left", "marker"}
    assert metrics.latencies([run], 1.0)["action_p50_ms"] is None
    assert those(tables["events"], kind="note")[0]["time_s"] is None
    assert "The decoder ran on another machine, and how far apart the clocks were isn't recorded" in said(tables)


def study_only(names: list[str]) -> set[str]:
    return {"table_1", "table_2", "by_distance", "maps", *(name for name in names if name.startswith("table_a_"))}


def test_the_command_refuses_in_a_sentence(study_folder: Any, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["report", str(study_folder[0] / "absent.xdf"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "There is no recording" in done.output
    assert "Traceback" not in done.output


def test_the_moves_of_a_session_by_hand_are_as_far_apart_as_epochs_need() -> None:
    stamps = [item.stamp for item in messages(WISHES[0]) if isinstance(item.message, Truth)]
    assert np.diff(stamps).min() >= BETWEEN_S
