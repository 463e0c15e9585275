"""The console's pages without a browser: what is refused, what is answered, and what every answer carries."""

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import Any
from urllib.parse import urlsplit

import pytest

from bci_app.config import Config
from bci_app.console.gate import HEADERS
from bci_app.console.server import FILES, serve
from bci_app.console.state import State
from bci_app.errors import SetupError
from bci_app.protocol import Command, Message, Note

JSON = {"Content-Type": "application/json"}


class Shelf:
    """A source that shows a state nobody changes and keeps what is asked for."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.asked: list[Message] = []
        self.is_led = True

    def snapshot(self) -> dict[str, Any]:
        return State("s", Config()).snapshot(0.0, 0.0)

    def average(self, channel: str) -> dict[str, Any]:
        return {"Fz": {"channel": "Fz"}}[channel]

    def ask(self, make: Callable[[str], Message]) -> None:
        if not self.is_led:
            raise SetupError("nobody would follow")
        self.asked.append(make("s"))


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Shelf, str]]:
    shelf, told = Shelf(), SimpleQueue[str]()
    thread = threading.Thread(target=serve, args=(shelf, 0, told.put))
    thread.start()
    yield shelf, told.get(timeout=20)
    shelf.ended.set()
    thread.join(20)
    assert not thread.is_alive()


def fetch(
    address: str, path: str, method: str = "GET", body: bytes | None = None, headers: dict[str, str] | None = None
) -> http.client.HTTPResponse:
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=20)
    connection.request(method, parts.path + path if not path.startswith("/") else path, body, headers or {})
    return connection.getresponse()


def test_every_file_is_there_and_every_answer_is_hardened(served: tuple[Shelf, str]) -> None:
    for name, (_, media_type) in FILES.items():
        answer = fetch(served[1], name)
        assert answer.status == 200
        assert answer.getheader("content-type") == media_type
        assert answer.read()
        assert {key: answer.getheader(key) for key in HEADERS} == HEADERS
        assert answer.getheader("access-control-allow-origin") is None
    refused = fetch(served[1], "/")
    assert refused.status == 403
    assert {key: refused.getheader(key) for key in HEADERS} == HEADERS


def test_no_page_refers_to_another_place() -> None:
    """A page in a laboratory without internet, and one that tells nobody that it was opened."""
    from importlib.resources import files

    for name, _ in FILES.values():
        text = files("bci_app.console").joinpath("static", *name.split("/")).read_text(encoding="utf-8")
        told = text.replace("http://www.w3.org/2000/svg", "").replace("https://github.com/leeoniya/uPlot", "")
        assert "http:" not in told
        assert "https:" not in told
        assert "url(" not in told


@pytest.mark.parametrize("path", ["/", "//", "/x/", "/../", "/favicon.ico", "/x/../y"])
def test_without_the_token_there_is_nothing(served: tuple[Shelf, str], path: str) -> None:
    assert fetch(served[1], path).status == 403


@pytest.mark.parametrize("path", ["../console.js", "static/console.js", "%2e%2e/server.py", "vendor/uPlot.iife.min.js"])
def test_only_the_files_that_are_meant_are_served(served: tuple[Shelf, str], path: str) -> None:
    assert fetch(served[1], path).status in (403, 404)


def test_a_viewer_hears_all_sections_at_first(served: tuple[Shelf, str]) -> None:
    answer = fetch(served[1], "events")
    assert answer.getheader("content-type") == "text/event-stream; charset=utf-8"
    first = json.loads(answer.readline().removeprefix(b"data: "))
    assert first == served[0].snapshot()
    answer.close()


def test_an_average_is_of_a_channel_that_is_there(served: tuple[Shelf, str]) -> None:
    assert json.loads(fetch(served[1], "average?channel=Fz").read()) == {"channel": "Fz"}
    assert fetch(served[1], "average?channel=%3Cb%3E").status == 404
    assert fetch(served[1], "average").status == 404


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b'{"command": "pause"}', 202),
        (b'{"command": "finish"}', 202),
        (b'{"note": " a\\n b "}', 202),
        (b'{"command": "stop"}', 422),
        (b'{"command": "start"}', 422),
        (b'{"note": "   "}', 422),
        (b'{"note": "a", "command": "pause"}', 422),
        (b'{"note": "a", "role": "decoder"}', 422),
        (b"{}", 422),
        (b"\xff", 422),
        (b'{"note": "\\ud800"}', 422),
        (b'{"note": "%s"}' % (b"x" * 1001), 422),
        (b'{"note": "%s"}' % (b"x" * 20_000), 413),
    ],
)
def test_what_is_asked_for_is_one_of_few_things(served: tuple[Shelf, str], body: bytes, status: int) -> None:
    shelf, address = served
    shelf.asked.clear()
    assert fetch(address, "ask", "POST", body, JSON).status == status
    assert len(shelf.asked) == (status == 202)
    for asked in shelf.asked:
        assert isinstance(asked, Command | Note)
        assert asked.by_person if isinstance(asked, Command) else asked.text == "a b"


def test_other_pages_cannot_ask(served: tuple[Shelf, str]) -> None:
    shelf, address = served
    shelf.asked.clear()
    body = b'{"command": "pause"}'
    assert fetch(address, "ask", "POST", body).status == 415
    assert fetch(address, "ask", "POST", body, JSON | {"Origin": "http://errp.example"}).status == 403
    assert fetch(address, "ask", "OPTIONS", None, {"Origin": "http://errp.example"}).status == 403
    assert fetch(address, "ask", "GET", body, JSON).status == 405
    shelf.is_led = False
    assert fetch(address, "ask", "POST", body, JSON).status == 409
    shelf.is_led = True
    assert not shelf.asked


def test_a_port_that_is_taken_is_said(served: tuple[Shelf, str]) -> None:
    port = urlsplit(served[1]).port
    assert port is not None
    with pytest.raises(SetupError, match="can't be had"):
        serve(Shelf(), port, lambda address: None)
