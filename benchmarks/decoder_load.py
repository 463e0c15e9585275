"""What the decoder costs while it runs: a share of one core at real speed, and memory over eight hours.

    python benchmarks/decoder_load.py [--seconds 60] [--hours 8]

At real speed the decoder is a process of its own on a live stream in chunks of 20 ms, with a move every 3 s and an
episode every 24 s, as in a session; counted is the processor time of its process over what the clock says. The eight
hours go through the same buffer, examiner and judge in this process, as fast as they take them.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import psutil
import pylsl

from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.protocol import PROTOCOL_VERSION
from bci_app.terminal import progress_bar
from decoder.calibration import calibrate
from decoder.chain import design
from decoder.electrodes import Examiner
from decoder.epochs import EpochBuffer
from decoder.judge import judge_with
from decoder.model import DecoderModel, make_model, save
from decoder.montage import MONTAGE_64, canonical, template

SESSION = "load"
CHUNK_S, MOVE_S, MOVES = 0.02, 3.0, 8
SETTLE_S = 5.0


def cap(n_channels: int) -> tuple[str, ...]:
    """Electrodes of the 10-05 system, each once, those of the 10-10 system first."""
    names = {canonical(name): name for name in (*MONTAGE_64, *template().ch_names)}
    return tuple(names.values())[:n_channels]


def minute(n_channels: int, sfreq: float) -> np.ndarray:
    """A minute of noise that channels share, float32, uV: as much to compute as EEG."""
    rng = np.random.default_rng(0)
    shared = rng.normal(0, 10, (round(60 * sfreq), 12)) @ rng.normal(0, 0.3, (12, n_channels))
    return (shared + rng.normal(0, 3, shared.shape)).astype(np.float32)


def decoder_for(channels: tuple[str, ...], sfreq: float) -> DecoderModel:
    """A decoder fitted on noise: it answers, and its answers mean nothing."""
    config, error = Config(), np.arange(80) % 2 == 0
    chain = design(config.chain, sfreq)
    rows = np.random.default_rng(0).normal(0, 3, (80, len(channels) * len(chain.windows)))
    fitted = calibrate(rows, error, config.classifier)
    return make_model(fitted, error, chain, config.classifier, participant="NOISE", channels=channels, n_rejected=0)


class Session:
    """The amplifier and the stimulus of docs/protocol.md, in so far as a decoder needs them."""

    def __init__(self, channels: tuple[str, ...], sfreq: float) -> None:
        info = pylsl.StreamInfo("LoadAmp", "EEG", len(channels), sfreq, "float32", "load-amp")
        described = info.desc().append_child("channels")
        for name in channels:
            channel = described.append_child("channel")
            for key, value in (("label", name), ("type", "EEG"), ("unit", "microvolts")):
                channel.append_child_value(key, value)
        self._eeg = pylsl.StreamOutlet(info)
        events = pylsl.StreamInfo("bci-stimulus", "Events", 1, 0.0, "string", f"bci-app/{SESSION}/bci-stimulus")
        self._events = pylsl.StreamOutlet(events)
        self._samples, self._sfreq = minute(len(channels), sfreq), sfreq
        self._started, self._sent = pylsl.local_clock(), 0

    def say(self, kind: str, **fields: object) -> None:
        """Send a message of the stimulus."""
        message = {"protocol": PROTOCOL_VERSION, "session": SESSION, "type": kind, **fields}
        self._events.push_sample([json.dumps(message)], pylsl.local_clock())

    def play(self, until: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Send samples as they are due until something is so."""
        n_chunk = round(CHUNK_S * self._sfreq)
        while not until():
            while (self._sent + n_chunk) / self._sfreq > pylsl.local_clock() - self._started:
                time.sleep(0.001)
            start = self._sent % len(self._samples)
            stamps = self._started + (self._sent + np.arange(n_chunk)) / self._sfreq
            self._eeg.push_chunk(self._samples[start : start + n_chunk], stamps.tolist())
            self._sent += n_chunk
            each()


def live(n_channels: int, sfreq: float, seconds: float) -> tuple[float, float]:
    """Share of one core, and resident memory in MB."""
    channels = cap(n_channels)
    session = Session(channels, sfreq)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "noise_decoder.safetensors"
        save(decoder_for(channels, sfreq), path)
        config = Path(folder) / "load.toml"
        config.write_text('[eeg]\nsource_id = "load-amp"\n', encoding="utf-8")
        words = ["decoder", "--session", SESSION, "--model", str(path), "--config", str(config)]
        process = subprocess.Popen([sys.executable, "-m", "bci_app", *words], stderr=subprocess.DEVNULL)
        try:
            found: list[pylsl.StreamInfo] = []
            while not found:
                session.play(lambda: True)
                found = pylsl.resolve_bypred(f"source_id='bci-app/{SESSION}/bci-verdicts'", 1, 0.05)
                session.play(lambda: session._sent / sfreq > pylsl.local_clock() - session._started - CHUNK_S)
            verdicts = pylsl.StreamInlet(found[0])
            heard: list[dict[str, object]] = []

            def listen() -> None:
                while (sample := verdicts.pull_sample(0.0)[0]) is not None:
                    heard.append(json.loads(sample[0]))

            session.play(lambda: process.poll() is not None or any(m.get("state") == "ready" for m in heard), listen)
            if process.poll() is not None:
                raise SystemExit(f"The decoder ended with code {process.returncode} before it was ready.")
            session.say("SessionStart", task="online", participant="P", map="open", layout=["..."], n_episodes=1)
            begun = pylsl.local_clock()
            moves = 0

            def stimulus() -> None:
                nonlocal moves
                listen()
                if pylsl.local_clock() - begun > moves * MOVE_S:
                    episode, step = divmod(moves, MOVES)
                    place = {"position": [0, 0], "sensed": [False] * 5}
                    if step == 0:
                        session.say("EpisodeStart", episode=episode, max_steps=60, **place)
                    session.say("MoveOnset", episode=episode, step=step + 1, action="north", **place)
                    moves += 1

            session.play(lambda: pylsl.local_clock() - begun > SETTLE_S, stimulus)
            watched = psutil.Process(process.pid)
            before, at = watched.cpu_times(), time.perf_counter()
            session.play(lambda: time.perf_counter() - at > seconds, stimulus)
            after, took = watched.cpu_times(), time.perf_counter() - at
            memory = watched.memory_info().rss / 1e6
            judged = [message for message in heard if message["type"] == "Verdict" and message["outcome"] != "rejected"]
            if len(judged) < seconds / MOVE_S - 2:
                raise SystemExit(f"Only {len(judged)} of {moves} moves were judged: this measures nothing.")
            return (after.user + after.system - before.user - before.system) / took, memory
        finally:
            process.kill()
            process.wait()


def memory(n_channels: int, sfreq: float, hours: float) -> list[float]:
    """Resident memory, MB, at the end of each hour."""
    config, channels = Config(), cap(n_channels)
    eeg = EegDescription("Load", "", "", channels, ("uV",) * n_channels, ("EEG",) * n_channels, sfreq)
    judge = judge_with(decoder_for(channels, sfreq), config, eeg, SESSION)
    examiner = Examiner(SESSION, channels, sfreq)
    buffer: EpochBuffer[tuple[int, int]] = EpochBuffer(judge.shape, n_channels, config.eeg.buffer_s)
    samples, n_move = minute(n_channels, sfreq), round(MOVE_S * sfreq)
    used, this = [], psutil.Process()
    n_moves = round(hours * 3600 / MOVE_S)
    with progress_bar(quiet=False) as show:
        for move in range(n_moves):
            start = move * n_move
            buffer.push(samples[start % len(samples) :][:n_move], (start + np.arange(n_move)) / sfreq)
            episode, step = divmod(move, MOVES)
            if step == 0:
                decided = examiner.examine((episode, 0), *buffer.trailing(examiner.n_window), since=0.0)
                judge = judge.with_bad(decided.bad)
            buffer.expect((episode, step + 1), (start + n_move / 2) / sfreq)
            for key, result in buffer.poll():
                judge.verdict(key, result, 0.0)
            if (move + 1) % round(3600 / MOVE_S) == 0:
                used.append(this.memory_info().rss / 1e6)
            show("moves", move + 1, n_moves)
    return used


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each rate, at real speed")
    parser.add_argument("--hours", type=float, default=8.0, help="simulated")
    options = parser.parse_args()
    for n_channels, sfreq in ((8, 250.0), (64, 500.0), (256, 2000.0)):
        share, megabytes = live(n_channels, sfreq, options.seconds)
        print(f"{n_channels} channels at {sfreq:g} Hz: {share:.1%} of one core, {megabytes:.0f} MB")
    used = memory(256, 2000.0, options.hours)
    print("256 channels at 2000 Hz, MB after each hour: " + " ".join(f"{megabytes:.0f}" for megabytes in used))


if __name__ == "__main__":
    main()
