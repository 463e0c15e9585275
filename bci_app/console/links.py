"""How well each stream of a session is heard: as its listeners say in `Link`, and as the console hears it itself.

Pure: arrivals are handed in, in real seconds of LSL's clock.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.protocol import Link

QUIET_S = 2.0
"""Real seconds after which a stream that always says something (twice a second) is called quiet (decided)."""
RATE_S = 5.0
"""Session seconds over which the console measures a rate (decided)."""


@dataclass
class _Stream:
    n: int = 0
    came: float | None = None  # None where only others hear it
    chunks: deque[tuple[float, int]] = field(default_factory=deque)  # newest stamp and samples of each
    links: dict[str, Link] = field(default_factory=dict)


class Links:
    """All streams of one session, by name."""

    def __init__(self) -> None:
        self._streams: dict[str, _Stream] = {}
        self._speaks: set[str] = set()

    def opened(self, name: str, now: float, speaks: bool) -> None:
        """The console hears a stream from now on; one that `speaks` is never silent for long."""
        self._streams.setdefault(name, _Stream()).came = now
        if speaks:
            self._speaks.add(name)

    def came(self, name: str, now: float) -> None:
        """A message came."""
        stream = self._streams[name]
        stream.n, stream.came = stream.n + 1, now

    def came_samples(self, name: str, stamps: NDArray[np.float64], now: float) -> None:
        """EEG came."""
        if not len(stamps):
            return
        stream = self._streams[name]
        stream.n, stream.came = stream.n + len(stamps), now
        stream.chunks.append((float(stamps[-1]), len(stamps)))
        while stream.chunks[-1][0] - stream.chunks[0][0] > RATE_S:
            stream.chunks.popleft()

    def take(self, link: Link) -> None:
        """What a process says of a stream it hears."""
        self._streams.setdefault(link.stream, _Stream()).links[link.role] = link

    def rows(self, now: float) -> list[dict[str, Any]]:
        """Each stream: who hears it how. Ages are real seconds; `state` is ok or quiet."""
        rows = []
        for name, stream in self._streams.items():
            rows.append(
                {
                    "stream": name,
                    "n": stream.n,
                    "age_s": None if stream.came is None else round(now - stream.came, 1),
                    "rate_hz": _rate(stream),
                    "state": self._state(name, stream, now),
                    "heard_by": [
                        link.model_dump(exclude={"protocol", "session", "type", "stream"})
                        for link in stream.links.values()
                    ],
                }
            )
        return rows

    def age(self, name: str, now: float) -> float:
        """Real seconds since something came on a stream; infinite where nothing is heard of it."""
        stream = self._streams.get(name)
        return now - stream.came if stream and stream.n and stream.came is not None else float("inf")

    def _state(self, name: str, stream: _Stream, now: float) -> str:
        ages = [link.age_s for link in stream.links.values()]
        if name in self._speaks and stream.came is not None:
            ages.append(now - stream.came)
        return "quiet" if ages and max(ages) > QUIET_S else "ok"


def _rate(stream: _Stream) -> float | None:
    if len(stream.chunks) < 2:
        return None
    span = stream.chunks[-1][0] - stream.chunks[0][0]
    n = sum(count for _, count in stream.chunks) - stream.chunks[0][1]
    return round(n / span, 2) if span > 0 else None
