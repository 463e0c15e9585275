"""The console's web pages: the page itself, a stream of what changed, averages, and what is asked for.

Served to this computer alone. Each viewer has a stream of its own; what they are sent is made once for all.
"""

import asyncio
import json
import logging
import secrets
from collections.abc import AsyncIterator, Callable
from importlib.resources import files
from threading import Event
from typing import Any, Literal, Protocol

import uvicorn
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route

from bci_app.console.gate import App, Gate
from bci_app.errors import SetupError
from bci_app.protocol import Command, Message, Note

log = logging.getLogger(__name__)

HOST = "127.0.0.1"
EVERY_S = 0.2
"""Real seconds between two looks at what changed (decided: faster than people read)."""
BEAT_S = 1.0
"""Real seconds after which a viewer hears something even if nothing changed: the page tells who is cut off."""
SLOWLY = ("progress", "streams", "head")
"""Sections that change all the time; they are sent once in `BEAT_S`, for a page that is drawn takes the processor."""
MOST_VIEWERS = 20
"""At once (decided): each is a connection that is kept open."""
MOST_BYTES = 10_000
"""Of what a page may send."""
TOKEN_BYTES = 24
FILES = {
    "": ("index.html", "text/html; charset=utf-8"),
    "console.js": ("console.js", "text/javascript; charset=utf-8"),
    "drawings.js": ("drawings.js", "text/javascript; charset=utf-8"),
    "responses.js": ("responses.js", "text/javascript; charset=utf-8"),
    "console.css": ("console.css", "text/css; charset=utf-8"),
    "icon.svg": ("icon.svg", "image/svg+xml"),
    "uPlot.js": ("vendor/uPlot.iife.min.js", "text/javascript; charset=utf-8"),
    "uPlot.css": ("vendor/uPlot.min.css", "text/css; charset=utf-8"),
}
"""What is served under which name: these, and no path that anybody gives."""


class Source(Protocol):
    """Where what is shown comes from: `bci_app.console.listener.Listener`."""

    ended: Event

    def snapshot(self) -> dict[str, Any]:
        """Sections of plain values."""

    def average(self, channel: str) -> dict[str, Any]:
        """Averages at a channel; KeyError for one that isn't there."""

    def ask(self, make: Callable[[str], Message]) -> None:
        """Ask bci-app for something; SetupError where nobody follows."""


class Asked(BaseModel):
    """What a page may ask for: one of the two."""

    model_config = ConfigDict(frozen=True, extra="forbid", str_strip_whitespace=True)
    command: Literal["pause", "resume", "finish"] | None = None
    note: str | None = Field(default=None, min_length=1, max_length=1000)

    def message(self, session: str) -> Message:
        """As a message to bci-app."""
        if self.note is not None:
            return Note(session=session, role="console", level="info", text=" ".join(self.note.split()))
        assert self.command is not None
        text = {
            "pause": "The experimenter pressed pause at the console.",
            "resume": "The experimenter pressed resume at the console.",
            "finish": "The experimenter ended the run at the console.",
        }[self.command]
        return Command(session=session, command=self.command, text=text, by_person=True)


class Pages:
    """The pages of one console."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._sections: dict[str, str] = {}
        self._made_at = -EVERY_S
        self._n_viewers = 0

    def app(self, token: str, port: int) -> App:
        """The application, behind its gate."""
        routes = [Route(f"/{name}", _file(*entry)) for name, entry in FILES.items()]
        routes += [
            Route("/events", self._events),
            Route("/average", self._average),
            Route("/ask", self._ask, methods=["POST"]),
        ]
        inner: App = Starlette(routes=[Mount(f"/{token}", routes=routes)])
        return Gate(inner, token, port)

    def sections(self) -> dict[str, str]:
        """What is shown as JSON, section by section; made anew at most every `EVERY_S`."""
        now = asyncio.get_running_loop().time()
        if now - self._made_at >= EVERY_S / 2:
            self._made_at = now
            self._sections = {name: json.dumps(value) for name, value in self._source.snapshot().items()}
        return self._sections

    async def _events(self, request: Request) -> Response:
        if self._n_viewers >= MOST_VIEWERS:
            return JSONResponse({"error": f"{MOST_VIEWERS} pages are open already. Close one."}, status_code=503)
        return StreamingResponse(self._changes(), media_type="text/event-stream")

    async def _changes(self) -> AsyncIterator[str]:
        """What a viewer doesn't have yet, as server-sent events, until it goes away or the console ends."""
        self._n_viewers += 1
        sent: dict[str, str] = {}
        since_beat_s = BEAT_S
        try:
            while not self._source.ended.is_set():
                is_beat = since_beat_s >= BEAT_S
                since_beat_s = EVERY_S if is_beat else since_beat_s + EVERY_S
                now = {name: text for name, text in self.sections().items() if is_beat or name not in SLOWLY}
                new = {name: text for name, text in now.items() if sent.get(name) != text}
                if new or is_beat:
                    body = ",".join(f'"{name}":{text}' for name, text in new.items())
                    yield f"data: {{{body}}}\n\n"
                    sent |= new
                await asyncio.sleep(EVERY_S)
            yield "event: end\ndata: {}\n\n"
        finally:
            self._n_viewers -= 1

    async def _average(self, request: Request) -> Response:
        channel = request.query_params.get("channel", "")
        try:
            return JSONResponse(self._source.average(channel))
        except KeyError:
            return JSONResponse({"error": f"There is no channel {channel!r} yet."}, status_code=404)

    async def _ask(self, request: Request) -> Response:
        if request.headers.get("content-type", "").split(";")[0] != "application/json":
            return JSONResponse({"error": "Expected application/json."}, status_code=415)
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > MOST_BYTES:
                return JSONResponse({"error": f"Expected at most {MOST_BYTES} bytes."}, status_code=413)
        try:
            asked = Asked.model_validate_json(body)
        except ValidationError:
            return JSONResponse({"error": "Expected a command or a note of 1 to 1000 characters."}, status_code=422)
        if (asked.command is None) == (asked.note is None):
            return JSONResponse({"error": "Expected a command or a note, one of the two."}, status_code=422)
        try:
            self._source.ask(asked.message)
        except SetupError as error:
            return JSONResponse({"error": str(error)}, status_code=409)
        return JSONResponse({"asked": True}, status_code=202)


def _file(name: str, media_type: str) -> Callable[[Request], Response]:
    content = files("bci_app.console").joinpath("static", *name.split("/")).read_bytes()

    def answer(request: Request) -> Response:
        return Response(content, headers={"content-type": media_type})

    return answer


def serve(source: Source, port: int, tell: Callable[[str], None]) -> None:
    """Serve until interrupted, or until the source has ended; ``tell`` is told the page's address.

    Parameters
    ----------
    port : 0 for any that is free. Raises SetupError where it is taken.
    """
    config = uvicorn.Config(
        _nothing,
        host=HOST,
        port=port,
        log_level="warning",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        ws="none",
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    try:
        listening = config.bind_socket()
    except SystemExit as error:  # uvicorn's way to say that it can't
        raise SetupError(
            f"Port {port} can't be had on this computer. Choose another with --port, or 0 for any."
        ) from error
    token, found = secrets.token_urlsafe(TOKEN_BYTES), int(listening.getsockname()[1])
    config.app = Pages(source).app(token, found)
    config.load()
    server = uvicorn.Server(config)
    listening.listen()  # whoever comes before the server is there waits a moment
    tell(f"http://{HOST}:{found}/{token}/")
    asyncio.run(_until_ended(server, source, listening))


async def _until_ended(server: uvicorn.Server, source: Source, listening: Any) -> None:
    watching = asyncio.create_task(_watch(server, source))
    try:
        await server.serve(sockets=[listening])
    finally:
        source.ended.set()
        await watching


async def _watch(server: uvicorn.Server, source: Source) -> None:
    """Each ends with the other: a stream of changes would keep a server from ending."""
    while not source.ended.is_set():
        if server.should_exit:
            source.ended.set()
        await asyncio.sleep(EVERY_S)
    server.should_exit = True


async def _nothing(scope: Any, receive: Any, send: Any) -> None:
    """Stands for the application until its address is known."""
