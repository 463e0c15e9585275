"""How well streams of messages are heard: the age of the newest word, and how often it stayed away.

Pure: what was heard, and when, is handed in. Real times are seconds of LSL's clock.
"""

from dataclasses import dataclass

from bci_app.protocol import Link, Role

SILENT_S = 1.0
"""Real seconds without a word, of a process that speaks twice a second, after which a stream is silent."""


@dataclass
class Links:
    """The streams one process hears.

    Attributes
    ----------
    session, role : of the process that hears them.
    """

    session: str
    role: Role

    def __post_init__(self) -> None:
        self._newest: dict[str, float] = {}
        self._reconnects: dict[str, int] = {}
        self._silent: set[str] = set()

    def take(self, stream: str, now: float) -> None:
        """Something was heard on a stream at real time `now`."""
        self._newest[stream] = now

    def changes(self, now: float) -> list[str]:
        """Streams that have fallen silent, or speak again, since the last call, in sentences."""
        found = []
        for stream, heard in self._newest.items():
            age = now - heard
            if age > SILENT_S and stream not in self._silent:
                self._silent.add(stream)
                found.append(f"Nothing was heard on {stream} for {age:.1f} s.")
            elif age <= SILENT_S and stream in self._silent:
                self._silent.remove(stream)
                self._reconnects[stream] = self._reconnects.get(stream, 0) + 1
                found.append(f"{stream} is heard again.")
        return found

    @property
    def silent(self) -> tuple[str, ...]:
        """Streams that are silent, in order."""
        return tuple(sorted(self._silent))

    def told(self, now: float, offsets: dict[str, float]) -> list[Link]:
        """What is to be said of each; ``offsets`` are the seconds to add to their stamps, where they are known."""
        return [
            Link(
                session=self.session,
                role=self.role,
                stream=stream,
                age_s=max(0.0, now - heard),
                offset_s=offsets.get(stream),
                reconnects=self._reconnects.get(stream, 0),
            )
            for stream, heard in self._newest.items()
        ]
