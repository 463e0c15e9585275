"""Who may have the page: whoever knows its token, from a browser on this computer that was pointed at this computer.

An ASGI application in front of the others. Pure: it knows requests and answers, no sockets.
"""

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

Scope = MutableMapping[str, Any]
Event = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Event]]
Send = Callable[[Event], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy: nothing but the page's own files, no script or style within the page, no frame around it."""
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
"""Of every answer. There is none that lets another origin read it."""


class Gate:
    """Refuses with 403 what doesn't come from the page itself, and hardens every answer.

    Parameters
    ----------
    app : what lies behind.
    token : the first part of every path.
    port : where it is served; a browser that was led here by another name (DNS rebinding) says another host.
    """

    def __init__(self, app: App, token: str, port: int) -> None:
        self._app, self._token = app, token
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http" or not self._is_ours(scope):
            await _refuse(scope, send)
            return

        async def hardened(event: Event) -> None:
            if event["type"] == "http.response.start":
                event["headers"] = [*event.get("headers", []), *_encoded(HEADERS)]
            await send(event)

        await self._app(scope, receive, hardened)

    def _is_ours(self, scope: Scope) -> bool:
        """Whether host, token and, where the browser tells it, origin are the page's own."""
        headers: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        hosts, origins = headers.get("host", []), headers.get("origin", [])
        given = scope["path"].split("/")[1] if scope["path"].startswith("/") else ""
        return (
            len(hosts) == 1
            and hosts[0] in self._hosts
            and secrets.compare_digest(given.encode(), self._token.encode())
            and all(origin == f"http://{hosts[0]}" for origin in origins)
            and all(site in ("same-origin", "none") for site in headers.get("sec-fetch-site", []))
        )


def _encoded(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode(), value.encode()) for name, value in headers.items()]


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    text = b"Expected the address that `bci-app` printed when this console was started. Open that.\n"
    headers = [*_encoded(HEADERS), *_encoded({"content-type": "text/plain", "content-length": str(len(text))})]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": text})
