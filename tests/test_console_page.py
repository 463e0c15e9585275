"""The experimenter's console in a real browser, beside a real session: what it shows is what is recorded."""

import http.client
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from browsing import CHROMIUM, chromium, complaints
from playwright.sync_api import Browser, Page, expect

from bci_app.metrics import latencies
from bci_app.protocol import Command, EpisodeEnd, MoveOnset, Note, Pause, Resume, SessionEnd, Truth, Verdict
from bci_app.recording import Recording, read

SPEED = 24
MOST, A_BLOCK = 960, 16
"""Moves of the whole session, which nobody waits for: it is ended after some block."""
NOTE = "Moved the chair; <b>C3</b> & the reference look fine."
SMALL = """
recordings = "{folder}"
[stimulus]
headless = true
[calibration]
n_blocks = 60
moves_per_block = 16
break_s = 3
[simulation]
dead = ["C3"]
"""
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")


@dataclass(frozen=True)
class Session:
    """A running calibration with its console."""

    process: subprocess.Popen[str]
    address: str
    folder: Path

    def recording(self) -> Recording:
        assert self.process.wait(60) == 0
        return read(next(self.folder.rglob("*_eeg.xdf")))


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    config = tmp_path / "small.toml"
    config.write_text(SMALL.format(folder=(tmp_path / "recordings").as_posix()), encoding="utf-8")
    words = [
        "calibrate",
        "--participant",
        "P001",
        "--config",
        config,
        "--simulate",
        "--speed",
        SPEED,
        "--console",
        "--json",
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "bci_app", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        address = next(found[0] for line in process.stderr if (found := re.findall(r"^Console: (\S+)", line)))
        threading.Thread(target=process.stderr.read, daemon=True).start()  # so that nobody waits to say more
        yield Session(process, address, tmp_path / "recordings")
    finally:
        process.terminate()
        process.wait(60)


@pytest.fixture
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


def status(address: str, path: str | None = None, host: str | None = None, method: str = "GET", **headers: str) -> int:
    """Of an answer to a request that no page of ours makes."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=10)
    connection.putrequest(method, parts.path if path is None else path, skip_host=True)
    for name, value in ({"Host": host or parts.netloc} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    return connection.getresponse().status


def refused(address: str) -> list[int]:
    token = urlsplit(address).path.strip("/")
    return [
        status(address, "/"),
        status(address, f"/{token[:-1]}x/"),
        status(address, f"/{token[:-1]}/events"),
        status(address, host="errp.example:80"),
        status(address, host="127.0.0.1"),
        status(address, f"/{token}/events", Origin="http://errp.example"),
        status(address, f"/{token}/ask", method="POST", Origin="null"),
        status(address, **{"Sec-Fetch-Site": "cross-site"}),
    ]


def press(page: Page, name: str) -> None:
    """By keyboard."""
    button = page.get_by_role("button", name=name)
    expect(button).to_have_attribute("aria-disabled", "false", timeout=30_000)
    button.focus()
    page.keyboard.press("Enter")


def test_the_page_follows_a_session_and_the_session_what_is_asked_for(session: Session, browser: Browser) -> None:
    assert refused(session.address) == [403] * 8
    assert status(session.address) == 200
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    phone = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    third = browser.new_page()
    troubles: list[str] = []
    for viewer in (page, phone, third):
        viewer.on("pageerror", lambda error: troubles.append(str(error)))
        viewer.on("console", lambda said: troubles.append(said.text) if said.type == "error" else None)
        viewer.goto(session.address)
    # The electrodes are looked at when the first block begins; a pause that came before would leave them unknown.
    expect(page.locator("#bad")).to_have_text("bad: C3 (flat)", timeout=30_000)
    press(page, "Pause")
    page.locator("#note").fill(NOTE)
    page.keyboard.press("Enter")
    for viewer in (page, phone, third):
        expect(viewer.locator("#phase")).to_contain_text("paused: The experimenter pressed pause", timeout=30_000)
        expect(viewer.locator("#log")).to_contain_text(NOTE)
        expect(viewer.locator("#bad")).to_have_text("bad: C3 (flat)")
    page.reload()
    expect(page.locator("#phase")).to_contain_text("paused")
    expect(page.locator("#plot canvas")).to_be_visible()
    for viewer, other in ((page, "dark"), (phone, "light")):
        assert complaints(viewer) == []
        viewer.emulate_media(color_scheme=other)
        assert complaints(viewer) == []
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    press(phone, "Resume")
    expect(page.locator("#phase")).to_have_text("running", timeout=30_000)
    press(page, "End after this block")
    page.get_by_role("button", name="End it").press("Enter")
    expect(page.locator("#phase")).to_have_text(re.compile("ended: complete"), timeout=60_000)
    recording = session.recording()
    check_what_was_recorded(recording)
    moves = len(recording.of(MoveOnset))
    over = [end.reason for _, end in recording.of(EpisodeEnd)]
    found = latencies([recording], SPEED)
    for name, text in {
        "done": f"{moves} of {MOST} moves",
        "unjudged": str(len(recording.of(Verdict))),
        "rejected": "0",
        "n_episodes": str(sum(reason in ("goal", "limit") for reason in over)),
    }.items():
        expect(page.locator(f"#{name}")).to_have_text(text)  # some of the page is renewed once a second
    latency = page.locator("#latency tr").first.locator("td")
    expect(latency.nth(1)).to_have_text(str(moves))
    expect(latency.nth(2)).to_have_text(f"{found['verdict_p50_ms']:.2f}")
    expect(latency.nth(3)).to_have_text(f"{found['verdict_p99_ms']:.2f}")
    assert troubles == []


def check_what_was_recorded(recording: Recording) -> None:
    assert [note.text for _, note in recording.of(Note) if note.role == "console"] == [NOTE]
    assert [command.command for _, command in recording.of(Command) if command.by_person] == [
        "pause",
        "resume",
        "finish",
    ]
    assert any(pause.by_person for _, pause in recording.of(Pause))
    assert recording.of(Resume)
    assert [end.reason for _, end in recording.of(SessionEnd)] == ["complete"]
    moves = len(recording.of(MoveOnset))
    assert moves == len(recording.of(Truth)) < MOST
    assert moves % A_BLOCK == 0
