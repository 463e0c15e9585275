"""Other people's programs, for tests: written against docs/protocol.md with pylsl and json, and nothing of ours."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pylsl

LABELS = list(
    "Fp1 Fp2 F7 F3 Fz F4 F8 FC5 FC1 FCz FC2 FC6 T7 C3 Cz C4 T8 CP5 CP1 CP2 CP6 P7 P3 Pz P4 P8 POz O1 Oz O2".split()  # noqa: SIM905
)


def a_moment() -> None:
    """Between two looks: whoever is waited for needs the core more."""
    time.sleep(0.01)


def until(condition: Callable[[], Any], seconds: float, what: str, between: Callable[[], None] = a_moment) -> Any:
    """Wait on a condition with a deadline; between two looks do `between`."""
    deadline = time.monotonic() + seconds
    while True:
        result = condition()
        if result:
            return result
        between()
        assert time.monotonic() < deadline, f"waited {seconds} s in vain for {what}"


class ForeignAmplifier:
    """Three noises that named channels share, with a sample counter in the first: a lost or doubled sample shows.

    With `on_arrival` they are stamped in chunks of 35 ms or more, as if when these came, 10 us a sample apart.
    """

    def __init__(
        self,
        name: str = "ForeignAmp",
        labels: list[str] | None = None,
        sfreq: float = 250.0,
        unit: str | None = "microvolts",
        delivered: float | None = None,
        spoil: Callable[[np.ndarray], None] = lambda samples: None,
        clock_s: float = 0.0,
        on_arrival: bool = False,
    ) -> None:
        self.labels = LABELS if labels is None else labels
        self._info = info = pylsl.StreamInfo(name, "EEG", len(self.labels), sfreq, "float32", f"{name}-1")
        channels = info.desc().append_child("channels")
        for label in self.labels:
            channel = channels.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("type", "EEG")
            if unit is not None:
                channel.append_child_value("unit", unit)
        self._outlet: pylsl.StreamOutlet | None = pylsl.StreamOutlet(info)
        self._in_a_microvolt = {"millivolts": 1e-3, "volts": 1e-6}.get(unit or "", 1.0)
        self._on_arrival = on_arrival
        self._rng = np.random.default_rng(1)
        mixing = self._rng.normal(0, 1, (3, len(self.labels)))
        self._mixing = 10 * mixing / np.linalg.norm(mixing, axis=0)
        self._started = pylsl.local_clock()
        self._sent = 0
        self._rate = delivered or sfreq
        self._spoil = spoil
        self._clock_s = clock_s

    def change_rate(self, delivered: float) -> None:
        """From now on deliver another rate, stamps and all."""
        shift = self._sent * (1 / self._rate - 1 / delivered)
        self._started, self._rate = self._started + shift, delivered

    @property
    def next_stamp(self) -> float:
        """The stamp of the next sample to be sent, where samples come at their rate."""
        return self._started + self._clock_s + self._sent / self._rate

    def close(self) -> None:
        """Take the stream off the network, even where a failed test still holds this object."""
        self._outlet = None

    def connect(self) -> None:
        """Put it back, as its connector does that is started again."""
        self._outlet = pylsl.StreamOutlet(self._info)

    def play(self) -> None:
        """Send what is due by now, unless it is off the network; then let a hundredth of a second pass."""
        now = pylsl.local_clock()
        due = int((now - self._started) * self._rate)
        a_chunk = int(np.ceil(0.035 * self._rate)) if self._on_arrival else 1
        due -= due % a_chunk
        if due > self._sent:
            number = np.arange(self._sent, due)
            samples = self._rng.normal(0, 1, (len(number), len(self.labels)))
            samples = (samples + self._rng.normal(0, 1, (len(number), 3)) @ self._mixing).astype(np.float32)
            samples[:, 0] = number % 1000
            self._spoil(samples)
            stamps = self._started + self._clock_s + number / self._rate
            if self._on_arrival:
                arrived = self._started + self._clock_s + (number // a_chunk + 1) * a_chunk / self._rate
                stamps = arrived + (number % a_chunk - a_chunk) * 1e-5
            if self._outlet is not None:
                self._outlet.push_chunk((samples * self._in_a_microvolt).astype(np.float32), stamps.tolist())
            self._sent = due
        a_moment()

    def play_for(self, seconds: float) -> None:
        """Play as long as that."""
        ends = pylsl.local_clock() + seconds
        until(lambda: pylsl.local_clock() > ends, seconds + 10, "time to pass", self.play)


class ForeignStimulus:
    """The stimulus of docs/protocol.md in a page: streams, messages, and a walk along the first row."""

    def __init__(self, session: str) -> None:
        self.session = session
        self._out = self._outlet("bci-stimulus", "Events")
        self.truth = self._outlet("bci-truth", "Truth")
        self._actions: pylsl.StreamInlet | None = None
        self._verdicts: pylsl.StreamInlet | None = None

    def _outlet(self, name: str, kind: str) -> pylsl.StreamOutlet:
        info = pylsl.StreamInfo(name, kind, 1, 0.0, "string", f"bci-app/{self.session}/{name}")
        return pylsl.StreamOutlet(info)

    def say(self, kind: str, stamp: float | None = None, **fields: Any) -> None:
        message = {"protocol": 2, "session": self.session, "type": kind, **fields}
        self._out.push_sample([json.dumps(message)], pylsl.local_clock() if stamp is None else stamp)

    def walk(self, n_moves: int, wait: Callable[[float], None], every_s: float = 1.0) -> list[float]:
        """Begin a session of one episode and make moves; their onsets."""
        self.say("SessionStart", task="online", participant="P", map="open", layout=["." * 11] * 11, n_episodes=1)
        self.say("EpisodeStart", episode=0, position=[5, 0], sensed=[False] * 5, max_steps=60)
        onsets = []
        for step in range(1, n_moves + 1):
            onsets.append(self.move(step))
            wait(every_s)
        return onsets

    def move(self, step: int, onset: float | None = None, episode: int = 0) -> float:
        """One move to the right, now or said once more; its onset."""
        onset = float(pylsl.local_clock()) if onset is None else onset
        where = {"position": [5, step], "sensed": [False] * 5}
        self.say("MoveOnset", onset, episode=episode, step=step, action="east", **where)
        return onset

    def has_listeners(self) -> bool:
        return bool(self._out.have_consumers())

    def raw(self, text: str) -> None:
        self._out.push_sample([text], pylsl.local_clock())

    def listen(self, name: str) -> "Listener":
        return Listener(name, self.session)


class Listener:
    """Hears one message stream and keeps what it heard."""

    def __init__(self, name: str, session: str) -> None:
        predicate = f"source_id='bci-app/{session}/{name}'"
        found = until(lambda: pylsl.resolve_bypred(predicate, 1, 1.0), 30, f"stream {name}")
        self._inlet = pylsl.StreamInlet(found[0])
        self._inlet.open_stream(10)
        self.heard: list[tuple[float, dict[str, Any]]] = []

    def of(self, kind: str) -> list[dict[str, Any]]:
        while True:
            sample, stamp = self._inlet.pull_sample(0.0)
            if sample is None:
                return [message for _, message in self.heard if message["type"] == kind]
            self.heard.append((stamp, json.loads(sample[0])))

    def is_ready(self) -> bool:
        return any(status["state"] in ("ready", "running") for status in self.of("Status"))


@contextmanager
def process(*words: object, host: tuple[str, ...] = ()) -> Iterator[subprocess.Popen[str]]:
    """A bci-app process that is gone when the block ends."""
    command = [*host, sys.executable, "-m", "bci_app", *map(str, words)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield running
    finally:
        running.kill()
        running.communicate()


def lab_config(folder: Path) -> Path:
    path = folder / "lab.toml"
    path.write_text(
        f'recordings = "{(folder / "recordings").as_posix()}"\n[stimulus]\nheadless = true\n'
        "[calibration]\nn_blocks = 1\nmoves_per_block = 40\n",
        encoding="utf-8",
    )
    return path
