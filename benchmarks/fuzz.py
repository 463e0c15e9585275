"""Mutated messages and files: nothing may crash, hang, or be taken for what it isn't.

    python benchmarks/fuzz.py [--messages 1000000] [--files 100000] [--seed 1]

Messages of every type are mutated in their bytes and in their JSON, and decoded; the files are a decoder, a
configuration, a map and a recording, each mutated in its bytes, and read. Right is either the proper refusal
(BadMessage, SetupError) in one sentence, or an acceptance that is right: a message that says the same when it is
encoded again, a decoder that is to the bit the one that was written, a recording whose damage is told and which holds
nothing it didn't hold before.
"""

import argparse
import json
import random
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bci_app import config as configuration
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.protocol import (
    Action,
    BadMessage,
    Electrodes,
    EpisodeStart,
    Message,
    MoveOnset,
    Recall,
    Said,
    SessionStart,
    Status,
    Verdict,
    decode,
    encode,
)
from bci_app.recording import read
from bci_app.runs import sums_of, write_sums
from bci_app.terminal import progress_bar
from decoder import model as models
from decoder.calibration import calibrate
from decoder.chain import design

SLOW_S = 2.0
"""Seconds after which one reading counts as hanging."""
NOTHING = [False] * 5


def messages() -> list[bytes]:
    """One of each kind that carries something."""
    place = {"episode": 3, "position": (2, 3), "sensed": NOTHING}
    onset = MoveOnset.model_validate({"session": "s", "step": 4, "action": "east", **place})
    verdict = Verdict(session="s", episode=3, step=4, outcome="error", log_odds=1.25, evidence=0.5, clock_offset=-1e-4)
    chosen = {"episode": 3, "step": 5, "action": "north", "probabilities": (0.1, 0.2, 0.3, 0.4), "verdict": "error"}
    made: list[Message] = [
        SessionStart(session="s", task="online", participant="P", map="open", layout=["..#", "..."], n_episodes=19),
        EpisodeStart.model_validate({"session": "s", "max_steps": 60, **place}),
        onset,
        verdict,
        Action.model_validate({"session": "s", **chosen}),
        Electrodes(session="s", episode=3, bad={"Fz": ["flat"]}, last_time=12.5, n_samples=900),
        Status(session="s", role="decoder", state="ready", hears={"bci-stimulus": 3.0}),
        Recall(session="s", role="policy", said=(Said(stamp=1.0, message=onset), Said(stamp=2.0, message=verdict))),
    ]
    return [encode(message).encode() for message in made]


def mutated(contents: bytes, rng: random.Random) -> bytes:
    """Bytes changed, lost, doubled or put elsewhere, in one to four places."""
    data = bytearray(contents)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(6):
            case 0 if data:
                data[at % len(data)] = rng.randrange(256)
            case 1:
                del data[at : at + rng.randint(1, 20)]
            case 2:
                data[at:at] = rng.randbytes(rng.randint(1, 8))
            case 3:
                data[at:at] = data[at : at + rng.randint(1, 40)]
            case 4 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case _:
                data[at:at] = rng.choice((b"NaN", b"1e999", b"null", b"-1", b'"', b"{}", b"\xff", b"0" * 30))
    return bytes(data)


def changed(text: bytes, rng: random.Random) -> bytes:
    """A message with one of its values, or its keys, replaced."""
    message = json.loads(text)
    key = rng.choice([*message, "extra"])
    values = (None, -1, 1e308, 10**30, "", "x" * 1000, [], {}, True, float("nan"), [[]], "2", 0.5, json.loads(text))
    if rng.random() < 0.2:
        message.pop(key, None)
    else:
        message[key] = rng.choice(values)
    return json.dumps(message).encode()


def check_message(text: bytes) -> str:
    """What came of one message."""
    try:
        message = decode(text, "s")
    except BadMessage as error:
        return "refused" if str(error) else "refused without a word"
    again = decode(encode(message), "s")
    return "accepted" if again == message and message.session == "s" else "WRONGLY ACCEPTED"


class Files:
    """A decoder, a configuration, a map and a recording, and how each is read."""

    def __init__(self, folder: Path, recording: Path | None) -> None:
        self.folder = folder
        error = np.arange(80) % 2 == 0
        chain = design(Config().chain, 128.0)
        rows = np.random.default_rng(0).normal(0, 3, (80, 2 * len(chain.windows)))
        fitted = calibrate(rows, error, Config().classifier)
        made = models.make_model(
            fitted, error, chain, Config().classifier, participant="P", channels=("Fz", "Cz"), n_rejected=0
        )
        models.save(made, folder / "whole.safetensors")
        self.model = made
        (folder / "whole.toml").write_text('recordings = "x"\n[calibration]\nn_blocks = 3\n[eeg]\nmax_uv = 5e6\n')
        (folder / "whole.txt").write_text("....\n.##.\n....\n")
        self.kinds: dict[str, tuple[Path, Callable[[Path], bool]]] = {
            "decoder": (folder / "whole.safetensors", self._decoder),
            "configuration": (folder / "whole.toml", lambda path: bool(configuration.load(path))),
            "map": (folder / "whole.txt", lambda path: load_map(str(path)).n_cells > 0),
        }
        if recording is not None:
            recording = Path(shutil.copy(recording, folder / "whole.xdf"))
            write_sums(recording)
            self.whole = read(recording)
            self.kinds["recording"] = (recording, self._recording)

    def _decoder(self, path: Path) -> bool:
        found = models.load(path)
        same = found.info == self.model.info and found.operator.tobytes() == self.model.operator.tobytes()
        return same and found.classifier.weights.tobytes() == self.model.classifier.weights.tobytes()

    def _recording(self, path: Path) -> bool:
        found = read(path, allow_damage=True)
        is_told = bool(found.damage) or path.read_bytes() == self.whole.path.read_bytes()
        stamps = {stamp for stamp, _ in self.whole.of(Message)}
        is_less = all(stamp in stamps for stamp, _ in found.of(Message)) and len(found.times) <= len(self.whole.times)
        return is_told and is_less


def check_file(path: Path, reader: Callable[[Path], bool]) -> str:
    """What came of one file."""
    try:
        return "accepted" if reader(path) else "WRONGLY ACCEPTED"
    except SetupError as error:
        return "refused" if str(error) and "\n" not in str(error).strip() else "refused in more than a sentence"


def main() -> None:
    """Mutate, count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--recording", type=Path, help="a short recording of bci-app, to be mutated as well")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, counts, slowest = random.Random(options.seed), Counter[tuple[str, str]](), Counter[str]()

    def judged(kind: str, what: Callable[[], str], item: bytes) -> None:
        started = time.perf_counter()
        try:
            outcome = what()
        except Exception as error:  # noqa: BLE001  -- a crash is what is looked for
            outcome = f"CRASHED: {type(error).__name__}: {error}"[:80]
            print(kind, outcome, item[:200])
        took = time.perf_counter() - started
        slowest[kind] = max(slowest[kind], took)
        counts[kind, "HANGS" if took > SLOW_S else outcome] += 1

    pool = messages()
    with progress_bar(quiet=False) as show, tempfile.TemporaryDirectory() as folder:
        for number in range(options.messages):
            text = rng.choice(pool)
            text = changed(text, rng) if rng.random() < 0.3 else mutated(text, rng)
            judged("message", lambda text=text: check_message(text), text)
            if number % 1000 == 0:
                show("messages", number, options.messages)
        files = Files(Path(folder), options.recording)
        names = list(files.kinds)
        whole = {name: path.read_bytes() for name, (path, _) in files.kinds.items()}
        for number in range(options.files):
            name = names[number % len(names)]
            origin, reader = files.kinds[name]
            # A name of its own, for maps are read once.
            path = Path(folder) / f"mutated-{number}{''.join(origin.suffixes)}"
            contents = mutated(whole[name], rng)
            path.write_bytes(contents)
            if name == "recording":  # its checksums, as beside every recording: without them a changed stamp is a stamp
                shutil.copy(sums_of(origin), sums_of(path))
            judged(name, lambda path=path, reader=reader: check_file(path, reader), contents)
            path.unlink()
            sums_of(path).unlink(missing_ok=True)
            if number % 100 == 0:
                show("files", number, options.files)
    print("| what | outcome | how many | slowest, s |\n|---|---|---|---|")
    for (kind, outcome), n in sorted(counts.items()):
        print(f"| {kind} | {outcome} | {n} | {slowest[kind]:.3f} |")


if __name__ == "__main__":
    main()
