"""What is left of a recording that was cut, or in which bytes were overwritten: is all that is whole still there?

    python benchmarks/recording_damage.py RECORDING.xdf [--places 200]

The recording is one of bci-app's, with its checksums (.chunks.json) beside it. It is cut at random places behind its
first message, as by a power failure (then there are no checksums) or later (then there are), and 64 bytes of it are
overwritten at random places, headers and all. A file counts as read where all EEG samples of all chunks that weren't
touched were read, and no others; as silent where no damage was reported.
"""

import argparse
import shutil
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bci_app.errors import SetupError
from bci_app.recording import read
from bci_app.runs import sums_of
from bci_app.terminal import progress_bar
from bci_app.xdf import MAGIC, SAMPLES, Chunk, Chunks, unstamped

N_BYTES = 64


def n_samples(data: bytes, chunk: Chunk) -> int:
    """Samples a chunk says it has."""
    width = data[chunk.content]
    return int.from_bytes(data[chunk.content + 1 : chunk.content + 1 + width], "little")


class Original:
    """A whole recording, and how many samples each of its chunks holds."""

    def __init__(self, path: Path) -> None:
        self.path, self.data = path, path.read_bytes()
        chunks = Chunks(self.data)
        self.chunks = [item for item in chunks if isinstance(item, Chunk)]
        recording = read(path)
        (self.eeg,) = (
            stream for stream, header in chunks.headers.items() if header.source_id == recording.eeg.source_id
        )
        self.header = chunks.headers[self.eeg]
        sampled = [chunk for chunk in self.chunks if chunk.tag == SAMPLES]
        self.begun = max(
            next(chunk.stop for chunk in sampled if (chunk.stream == self.eeg) == is_eeg) for is_eeg in (True, False)
        )
        """Bytes after which there is EEG, and something was said: of less no reader can tell what it is."""

    def expected(self, untouched: list[Chunk]) -> int:
        """EEG samples of these chunks, but for those without a stamp of their own where the one before them is lost."""
        kept, n_expected, is_lost = set(untouched), 0, False
        for chunk in self.chunks:
            if chunk.tag != SAMPLES or chunk.stream != self.eeg:
                is_lost |= chunk not in kept
            elif chunk in kept:
                n_unstamped = unstamped(self.data, chunk, self.header)[0] if is_lost else 0
                n_expected += n_samples(self.data, chunk) - n_unstamped
                is_lost &= n_unstamped == n_samples(self.data, chunk)
            else:
                is_lost = True
        return n_expected


def judged(path: Path, expected: int) -> tuple[bool, bool, float]:
    """Whether all EEG samples that weren't touched are there, and no others; whether damage was reported; seconds."""
    started = time.perf_counter()
    recording = read(path, allow_damage=True)
    took = time.perf_counter() - started
    try:
        read(path)
        refused = False
    except SetupError:
        refused = True
    return len(recording.times) == expected, bool(recording.damage) and refused, took


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--places", type=int, default=200, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    original, rng = Original(options.recording), np.random.default_rng(options.seed)
    data, rows = original.data, []
    with TemporaryDirectory() as folder, progress_bar(quiet=False) as show:
        path = Path(folder) / options.recording.name
        for kind in ("cut while written", "cut later", "overwritten"):
            found = []
            first = len(MAGIC) if kind == "overwritten" else original.begun
            for number, at in enumerate(rng.integers(first, len(data) - N_BYTES, options.places).tolist()):
                show(kind, number, options.places)
                if kind == "overwritten":
                    path.write_bytes(data[:at] + rng.bytes(N_BYTES) + data[at + N_BYTES :])
                    untouched = [c for c in original.chunks if c.stop <= at or c.start >= at + N_BYTES]
                else:
                    path.write_bytes(data[:at])
                    untouched = [chunk for chunk in original.chunks if chunk.stop <= at]
                sums_of(path).unlink(missing_ok=True)
                if kind != "cut while written":
                    shutil.copy(sums_of(original.path), sums_of(path))
                found.append(judged(path, original.expected(untouched)))
            whole, told, took = zip(*found, strict=True)
            rows.append((kind, len(found), sum(whole), len(found) - sum(told), max(took)))
    print(f"{options.recording.name}, {len(data) / 1e6:.0f} MB\n")
    print("| recording | files | all that is whole was read | silent | longest, s |\n|---|---|---|---|---|")
    for kind, n, whole, silent, took in rows:
        print(f"| {kind} | {n} | {whole} | {silent} | {took:.2f} |")


if __name__ == "__main__":
    main()
