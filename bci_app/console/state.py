"""What was heard of a session, and what the page shows of it: messages and EEG in, a snapshot of plain values out.

Pure: no LSL, no web. A snapshot is a dictionary of sections, so that only those that changed need be sent again.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.config import Config
from bci_app.console.averages import Averages
from bci_app.console.heads import LOOK_S, amplitudes, head, places
from bci_app.console.links import QUIET_S, Links
from bci_app.console.progress import Course
from bci_app.console.scores import Key, Ledger
from bci_app.eeg import EegDescription
from bci_app.protocol import (
    SESSION,
    AnyMessage,
    Belief,
    Command,
    Continued,
    Electrodes,
    EpisodeStart,
    LateFrame,
    Link,
    MoveOnset,
    Note,
    Pause,
    Recall,
    Resume,
    Role,
    Screen,
    SessionEnd,
    Status,
)
from decoder.chain import design

USUAL_HZ = 500.0
"""The paper's rate; any does."""
MOST_LOGGED = 300
"""Newest lines of the log that are kept (decided)."""


def warm_up(config: Config) -> None:
    """Load what is slow to load, before EEG comes."""
    places(("Cz",))
    design(config.chain, USUAL_HZ)


@dataclass
class State:
    """One session as the console knows it. Stamps are session seconds, `now` real seconds of LSL's clock."""

    session: str
    config: Config
    speed: float = 1.0
    ledger: Ledger = field(default_factory=Ledger)
    links: Links = field(default_factory=Links)
    averages: Averages | None = None
    eeg: EegDescription | None = None

    def __post_init__(self) -> None:
        self.ledger.speed = self.speed
        self.course = Course(self.ledger)
        self._belief: Belief | None = None
        self._electrodes: Electrodes | None = None
        self._screen: str | None = None
        self._asked: Command | None = None
        self._is_recalled = False
        self._statuses: dict[Role, Status] = {}
        self._late: list[LateFrame] = []
        self._log: list[dict[str, Any]] = []
        self._n_logged = 0
        self._last_said = ""
        self._averaged: set[Key] = set()
        self._places: list[tuple[float, float] | None] = []
        self._uv: list[float | None] = []

    # What is heard.

    def take(self, stream: str, stamp: float, message: AnyMessage, now: float) -> None:
        """Take in one message of a stream."""
        self.links.came(stream, now)
        self._take(stamp, message)

    def _take(self, stamp: float, message: AnyMessage) -> None:
        self.course.take(stamp, message)
        self.ledger.take(stamp, message)
        match message:
            case Link():
                self.links.take(message)
            case Status():
                self._take_status(stamp, message)
            case Note():
                self.log(stamp, message.role, message.level, message.text)
            case Electrodes():
                self._electrodes = message
            case Belief():
                self._belief = message
            case Screen():
                self._screen = message.name
            case LateFrame():
                self._late.append(message)
            case Command():
                self._take_command(stamp, message)
            case EpisodeStart() | MoveOnset():
                self._screen = None  # the map again
            case Pause() if self._asked is not None and self._asked.command == "pause":
                self._asked = None
            case Resume() | SessionEnd():
                self._asked = None
            case Continued():
                self._asked = None
                self._averaged = {key for key in self._averaged if key in self.ledger.moves}
                if self.averages is not None:
                    self.averages.forget(lambda key: key not in self.ledger.moves)
            case Recall(role="console") if not self._is_recalled:
                self._is_recalled = True
                for said in message.said:
                    self._take(said.stamp, said.message)
        self._say_what_changed(stamp)
        self._expect_epochs()

    def _take_status(self, stamp: float, status: Status) -> None:
        before = self._statuses.get(status.role)
        self._statuses[status.role] = status
        if before is None or before.state != status.state:
            self.log(
                stamp, status.role, "info", f"{status.state} {status.text if status.state == 'waiting' else ''}".strip()
            )

    def _take_command(self, stamp: float, command: Command) -> None:
        if command.command == "finish":
            self.course.is_last = True
        if command.by_person and command.command != "finish":
            self._asked = command
        if command.by_person:
            self.log(stamp, "console", "info", f"{command.command} asked for at the console")

    def _say_what_changed(self, stamp: float) -> None:
        """A pause's beginning and end, and the run's, are lines of the log."""
        pause, end = self.course.pause, self.course.end
        said = f"began on map {self.course.start.map}" if self.course.start else ""
        if end is not None:
            said = f"ended: {end.reason}. {end.text}".strip()
        elif pause is not None:
            said = f"paused: {pause.reason}"
        elif self.course.paused_s:
            said = "goes on"
        if said != self._last_said:
            self._last_said = said
            self.log(stamp, "stimulus", "info", f"The run {said}")

    def log(self, stamp: float, role: str, level: str, text: str) -> None:
        """A line for the experimenter; the stamp is a session time."""
        self._n_logged += 1
        began = self.course.began if self.course.start is not None else None
        self._log.append(
            {
                "n": self._n_logged,
                "t": None if began is None else round(stamp - began, 1),
                "role": role,
                "level": level,
                "text": text,
            }
        )
        del self._log[:-MOST_LOGGED]

    def begin_eeg(self, eeg: EegDescription, now: float) -> None:
        """The EEG is heard from now on. Raises SetupError when the chain can't be designed for it."""
        self.eeg = eeg
        self.averages = Averages(eeg.picked, eeg.sfreq, self.config.chain, self.config.eeg)
        self._places = places(eeg.picked)
        self.links.opened(eeg.name, now, speaks=True)
        self._expect_epochs()

    def take_eeg(self, samples: NDArray[np.floating], stamps: NDArray[np.float64], now: float) -> None:
        """Take in EEG: (n_times, n_picks) in uV and raw stamps."""
        if self.averages is None or self.eeg is None or not len(stamps):
            return
        self.links.came_samples(self.eeg.name, stamps, now)
        self.averages.push(samples, stamps)

    def look_at_electrodes(self) -> None:
        """Measure the amplitudes anew."""
        if self.averages is not None and self.eeg is not None:
            self._uv = amplitudes(self.averages.newest(LOOK_S, self.eeg.sfreq))

    def _expect_epochs(self) -> None:
        """Moves of which verdict and truth are known by now go into the average, unless they were rejected."""
        if self.averages is None:
            return
        for key in [key for key in self.ledger.verdicts if key not in self._averaged]:
            _, verdict = self.ledger.verdicts[key]
            move, error = self.ledger.moves.get(key), self.ledger.truths.get(key)
            if move is None or error is None:
                continue
            self._averaged.add(key)
            if verdict.outcome != "rejected":
                bad = frozenset(self._electrodes.bad if self._electrodes else ())
                self.averages.expect(key, move[0] + verdict.clock_offset, error, bad)

    # What is shown.

    @property
    def is_led(self) -> bool:
        """Whether bci-app leads this session, as far as was heard: only it follows what is asked for."""
        return "session" in self._statuses

    @property
    def is_over(self) -> bool:
        """Whether the run has ended, and all of its moves that can be have been judged."""
        end = self.course.end
        return end is not None and (end.reason != "complete" or self.ledger.moves.keys() <= self.ledger.verdicts.keys())

    def snapshot(self, now: float, session_now: float) -> dict[str, Any]:
        """All sections, of values that JSON has."""
        return {
            "session": self._session_section(now),
            "progress": self.course.progress(session_now),
            "world": self._world_section(),
            "episode": self._episode_section(),
            "verdicts": self.ledger.accuracy() | {"recent": self.ledger.recent()},
            "episodes": self.ledger.success() | {"finished": self.ledger.finished()},
            "latency": self._latency_section(),
            "streams": self.links.rows(now),
            "head": self._head_section(),
            "average": self._average_section(),
            "log": self._log,
        }

    def _session_section(self, now: float) -> dict[str, Any]:
        start, end, pause = self.course.start, self.course.end, self.course.pause
        is_led = self.is_led and self.links.age(SESSION.name, now) < QUIET_S
        is_on = is_led and self.course.phase in ("running", "paused")
        by_person = pause is not None and pause.by_person
        asked = self._asked.command if self._asked else None
        return {
            "id": self.session,
            "speed": self.speed,
            "phase": self.course.phase,
            "task": start.task if start else None,
            "participant": start.participant if start else None,
            "map": start.map if start else None,
            "pause": pause.reason if pause else None,
            "by_person": by_person,
            "end": f"{end.reason}. {end.text}".strip() if end else None,
            "screen": self._screen,
            "asked": asked if is_on else None,
            "is_last": self.course.is_last,
            "is_led": is_led,
            "is_late": self._is_recalled,
            "can": {
                "pause": is_on and not by_person and asked != "pause",
                "resume": is_on and (by_person or asked == "pause"),
                "finish": is_on and not self.course.is_last,
                "note": is_led and end is None,
            },
        }

    def _world_section(self) -> dict[str, Any]:
        start = self.course.start
        return {"map": start.map if start else None, "layout": start.layout if start else []}

    def _episode_section(self) -> dict[str, Any] | None:
        episode = self.ledger.current
        if episode is None:
            return None
        path = [
            {
                "position": onset.position,
                "action": onset.action,
                "truth": self.ledger.truths.get((episode.number, onset.step)),
                "outcome": said[1].outcome
                if (said := self.ledger.verdicts.get((episode.number, onset.step)))
                else None,
            }
            for onset in self.ledger.path(episode.number)
        ]
        belief = self._belief if self._belief and self._belief.episode == episode.number else None
        return {
            "episode": episode.number,
            "start": episode.start,
            "agent": path[-1]["position"] if path else episode.start,
            "goal": episode.goal,
            "distance": episode.distance,
            "path": path,
            "end": episode.end.reason if episode.end else None,
            "belief": None if belief is None else {"step": belief.step, "goal": belief.goal, "exact": belief.exact},
        }

    def _latency_section(self) -> dict[str, Any]:
        late = self._late[-1] if self._late else None
        return self.ledger.latencies() | {
            "late_frames": len(self._late),
            "worst_frame_ms": max((frame.late_ms for frame in self._late), default=None),
            "last_late_ms": late.late_ms if late else None,
        }

    def _head_section(self) -> dict[str, Any]:
        bad = self._electrodes.bad if self._electrodes else {}
        rows = head(self.eeg.picked, self._places, self._uv, bad) if self.eeg and self._uv else []
        return {"electrodes": rows, "bad": bad}

    def _average_section(self) -> dict[str, Any]:
        averages = self.averages
        if averages is None:
            return {"channels": [], "version": 0, "n": {}, "left_out": 0}
        return {
            "channels": averages.channels,
            "version": averages.version,
            "n": averages.counts(),
            "left_out": averages.n_left_out,
        }
