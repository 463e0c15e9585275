"""Sessions made without LSL: messages of a person who watches an agent wander, EEG that answers, and both as XDF."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bci_app.eeg import EegDescription
from bci_app.gridworld import ACTIONS, load_map
from bci_app.protocol import (
    ACTIONS_STREAM,
    MARKERS,
    STIMULUS,
    TRUTH,
    VERDICTS,
    Action,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    RunSeed,
    SessionEnd,
    SessionStart,
    Truth,
    Verdict,
    encode,
    marker_code,
)
from bci_app.recording import Recording, Stamped
from decoder.participant import Participant

SFREQ = 250.0
LEAD_S, BETWEEN_S = 10.0, 2.0
SESSION = "by-hand"


@dataclass(frozen=True)
class Wish:
    """What a recording should be like: how many episodes of how many moves, and what of it."""

    task: str = "calibration"
    map: str = "open"
    n_episodes: int = 10
    n_moves: int = 10
    error_share: float = 0.4
    seed: int = 1
    with_eeg: bool = True


def messages(wish: Wish) -> list[Stamped]:
    """All that is said, in order."""
    rng, world = np.random.default_rng(wish.seed), load_map(wish.map)
    now, said = LEAD_S, []

    def say(message: Message, at: float | None = None) -> None:
        said.append(Stamped(now if at is None else at, message))

    about = {"task": wish.task, "participant": "P001", "map": wish.map, "layout": world.layout()}
    say(SessionStart(session=SESSION, **about))
    say(RunSeed(session=SESSION, seed=wish.seed))
    for episode in range(wish.n_episodes):
        key = {"session": SESSION, "episode": episode}
        cell, goal = 0, int(rng.integers(40, world.n_cells))
        say(EpisodeStart(position=tuple(world.cells[cell]), sensed=(False,) * 5, max_steps=60, **key))
        say(EpisodeGoal(goal=tuple(world.cells[goal]), distance=int(world.distance[cell, goal]), **key))
        say(Electrodes(last_time=now, n_samples=1000, bad={"Cz": ["flat"]} if episode == 3 else {}, **key))
        steps = 0
        for step in range(1, wish.n_moves + 1):
            wrong = bool(rng.random() < wish.error_share)
            legal = [a for a in range(4) if world.legal[cell, a]]
            fitting = [a for a in legal if world.is_error(cell, a, goal) == wrong] or legal
            action = int(rng.choice(fitting))
            error, cell = world.is_error(cell, action, goal), int(world.next_cell[cell, action])
            now, steps = now + BETWEEN_S, step
            move = {**key, "step": step}
            say(Action(action=ACTIONS[action], probabilities=(0.25,) * 4, verdict="missing", **move), now - 1.2)
            onset = {"action": ACTIONS[action], "position": tuple(world.cells[cell])}
            say(MoveOnset(sensed=(False,) * 5, **onset, **move))
            say(Truth(error=error, distance=int(world.distance[cell, goal]), **move))
            say(_verdict(wish, error, rng, move, now), now + 0.7)
            if cell == goal:
                break
        now += 1.0
        say(EpisodeEnd(steps=steps, reason="goal" if cell == goal else "limit", **key))
    say(SessionEnd(session=SESSION, reason="complete"), now + 1.0)
    return sorted(said, key=lambda item: item.stamp)


def _verdict(wish: Wish, error: bool, rng: np.random.Generator, move: dict, onset: float) -> Verdict:
    base = {**move, "clock_offset": 0.0, "first_time": onset - 3.0, "n_samples": 900, "latency_ms": 1.0}
    if wish.task == "calibration":
        return Verdict(outcome="unjudged", **base)
    log_odds = float(rng.normal(1.2 if error else -1.2, 1.5))
    return Verdict(outcome="error" if log_odds > 0 else "correct", log_odds=log_odds, evidence=log_odds, **base)


def recording(wish: Wish, said: Sequence[Stamped] | None = None) -> Recording:
    """As it would be read from a file."""
    said = messages(wish) if said is None else list(said)
    person = Participant(1, SFREQ, 0.9)
    for item in said:
        if isinstance(item.message, Truth):
            person.respond(item.stamp, item.message.error)
    n = round((said[-1].stamp + 3.0) * SFREQ)
    names, n_channels = person.names, len(person.names)
    samples = person.render(0, n).astype(np.float32)
    eeg = EegDescription("Amp", "amp", "host", names, ("microvolts",) * n_channels, ("EEG",) * n_channels, SFREQ)
    codes = ((item.stamp, marker_code(item.message)) for item in said)
    markers = tuple((stamp, code) for stamp, code in codes if code is not None)
    return Recording(Path("by-hand.xdf"), eeg, samples, np.arange(n) / SFREQ, tuple(said), (), markers)


def without(whole: Recording, *kinds: type[Message]) -> Recording:
    """The same without some messages."""
    return replace(whole, messages=tuple(item for item in whole.messages if not isinstance(item.message, kinds)))


def write(whole: Recording, path: Path, protocol: int = 5) -> Path:
    """As an XDF file that LabRecorder could have written."""
    streams = {
        STIMULUS: (SessionStart, EpisodeStart, MoveOnset, EpisodeEnd, SessionEnd),
        TRUTH: (RunSeed, EpisodeGoal, Truth),
        VERDICTS: (Verdict, Electrodes),
        ACTIONS_STREAM: (Action,),
    }
    parts = [b"XDF:", _chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")]
    names = whole.eeg.channels
    channels = "".join(f"<channel><label>{name}</label><unit>uV</unit><type>EEG</type></channel>" for name in names)
    parts.append(_header(1, "Amp", "EEG", len(names), SFREQ, "float32", f"<channels>{channels}</channels>"))
    for number, spec in enumerate((*streams, MARKERS), 2):
        kind = "string" if spec.string else "int32"
        parts.append(_header(number, spec.name, spec.kind, 1, 0, kind, ""))
    timed = []
    for start in range(0, len(whole.times), 250):
        block = slice(start, start + 250)
        body = [struct.pack("<BI", 4, len(whole.times[block]))]
        for time, row in zip(whole.times[block], whole.samples[block], strict=True):
            body.append(b"\x08" + struct.pack("<d", time) + row.astype("<f4").tobytes())
        timed.append((float(whole.times[block][-1]), _chunk(3, b"".join(body), 1)))
    counts = [len(whole.times)]
    for number, kinds in enumerate(streams.values(), 2):
        mine = [item for item in whole.messages if isinstance(item.message, kinds)]
        counts.append(len(mine))
        for item in mine:
            text = encode(item.message.model_copy(update={"protocol": protocol})).encode()
            timed.append((item.stamp, _sample(item.stamp, b"\x04" + struct.pack("<I", len(text)) + text, number)))
    counts.append(len(whole.markers))
    timed += [(stamp, _sample(stamp, struct.pack("<i", code), len(counts))) for stamp, code in whole.markers]
    parts += [content for _, content in sorted(timed, key=lambda item: item[0])]
    for number, count in enumerate(counts, 1):
        parts.append(_chunk(6, f"<info><sample_count>{count}</sample_count></info>".encode(), number))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(parts))
    return path


def _sample(stamp: float, content: bytes, stream: int) -> bytes:
    return _chunk(3, struct.pack("<BB", 1, 1) + b"\x08" + struct.pack("<d", stamp) + content, stream)


def _header(number: int, name: str, kind: str, n: int, rate: float, dtype: str, desc: str) -> bytes:
    text = (
        f"<?xml version='1.0'?><info><name>{name}</name><type>{kind}</type><channel_count>{n}</channel_count>"
        f"<nominal_srate>{rate}</nominal_srate><channel_format>{dtype}</channel_format><source_id>{name}</source_id>"
        f"<hostname>host</hostname><desc>{desc}</desc></info>"
    )
    return _chunk(2, text.encode(), number)


def _chunk(tag: int, content: bytes, stream: int | None = None) -> bytes:
    body = struct.pack("<H", tag) + (b"" if stream is None else struct.pack("<I", stream)) + content
    return b"\x04" + struct.pack("<I", len(body)) + body
