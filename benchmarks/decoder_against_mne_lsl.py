"""Our decoder and MNE-LSL's `EpochsStream` on the same live streams: the same epochs, and who has them earlier.

    python benchmarks/decoder_against_mne_lsl.py [--moves 60]

A simulated calibration at real speed: stimulus, decoder and amplifier are processes of their own. MNE-LSL reads the EEG
and the int32 markers, as its documentation advises (all of LSL's time-stamp processing), and looks for new data every
millisecond. Our decoder says `unjudged` on each epoch, once its features are made; an epoch of MNE-LSL counts as there
when it can be taken. Each is timed on its arrival in this process, against the move's flip; our verdict comes over LSL.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pylsl
from mne_lsl.stream import EpochsStream, StreamLSL
from rich.console import Console
from rich.table import Table

from bci_app.config import ChainConfig
from bci_app.terminal import progress_bar
from decoder.chain import design

SESSION, SFREQ = "against", 500.0
MOVES = {"north": 1, "south": 2, "west": 3, "east": 4}
PATIENCE_S = 60.0


class Listener:
    """Messages of one of our streams, each with the time at which it was here."""

    def __init__(self, name: str) -> None:
        self._inlet = _inlet(f"bci-app/{SESSION}/{name}")
        self.heard: list[tuple[float, float, str]] = []

    def listen(self) -> None:
        """Take what is waiting: (here at, stamp, sample)."""
        while (pulled := self._inlet.pull_sample(0.0))[0] is not None:
            self.heard.append((pylsl.local_clock(), pulled[1], str(pulled[0][0])))

    def of(self, kind: str) -> list[tuple[float, float, dict[str, object]]]:
        """The messages of one type."""
        messages = [(here, stamp, json.loads(text)) for here, stamp, text in self.heard]
        return [message for message in messages if message[2]["type"] == kind]


def _inlet(source_id: str) -> pylsl.StreamInlet:
    found = pylsl.resolve_byprop("source_id", source_id, 1, PATIENCE_S)
    if not found:
        raise SystemExit(f"No stream {source_id} came within {PATIENCE_S:g} s.")
    inlet = pylsl.StreamInlet(found[0], max_buflen=600)
    inlet.open_stream(10)
    return inlet


def record(n_moves: int, processes: list[subprocess.Popen[bytes]]) -> dict[str, np.ndarray]:
    """Onsets, and of each move the onset's sample and the time at which its epoch was here, ours and MNE-LSL's."""
    verdicts, stimulus = Listener("bci-verdicts"), Listener("bci-stimulus")
    raw = _inlet(f"bci-app/{SESSION}/eeg")
    eeg = StreamLSL(20, source_id=f"bci-app/{SESSION}/eeg").connect(processing_flags="all", timeout=20)
    markers = StreamLSL(60, source_id=f"bci-app/{SESSION}/bci-markers").connect(processing_flags="all", timeout=20)
    n_after = design(ChainConfig(), SFREQ).n_after
    settings = {"tmin": 0.0, "tmax": (n_after - 1) / SFREQ, "baseline": None, "picks": "all"}
    epochs = EpochsStream(eeg, 2 * n_moves, MOVES, markers.ch_names[0], markers, **settings).connect(0.001)
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    arrivals: list[float] = []
    theirs: list[tuple[float, np.ndarray]] = []
    with progress_bar(quiet=False) as show:
        while not stimulus.of("SessionEnd") and all(process.poll() is None for process in processes):
            if n_new := epochs.n_new_epochs:
                here = pylsl.local_clock()
                theirs += [(here, data.copy()) for data in epochs.get_data()[-n_new:]]
            verdicts.listen()
            stimulus.listen()
            part = raw.pull_chunk(0.0, as_numpy=True)
            if len(part[0]):
                parts.append(part)
                arrivals.append(pylsl.local_clock())
            show("moves", len(verdicts.of("Verdict")), n_moves)
            time.sleep(0.001)
    epochs.disconnect()
    samples = np.concatenate([part for part, _ in parts])
    times = np.concatenate([stamps for _, stamps in parts])
    here = np.repeat(arrivals, [len(part) for part, _ in parts])
    onsets = np.array([stamp for _, stamp, _ in stimulus.of("MoveOnset")])
    judged = verdicts.of("Verdict")
    first = np.searchsorted(times, [float(message["first_time"]) for _, _, message in judged])  # type: ignore[arg-type]
    place_of = {samples[index].tobytes(): index for index in range(len(samples))}
    our_sample = first + design(ChainConfig(), SFREQ).n_before
    return {
        "onset": onsets,
        "our sample": our_sample,
        "last arrival": here[our_sample + n_after - 1],
        "our sent": np.array([stamp for _, stamp, _ in judged]),
        "our arrival": np.array([here for here, _, _ in judged]),
        "their sample": np.array([place_of.get(data[:, 0].astype(np.float32).tobytes(), -1) for _, data in theirs]),
        "their arrival": np.array([here for here, _ in theirs]),
    }


def main() -> None:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=60)
    n_moves = parser.parse_args().moves
    with TemporaryDirectory() as folder:
        config = Path(folder) / "bench.toml"
        config.write_text(
            f'[eeg]\nsource_id = "bci-app/{SESSION}/eeg"\n[stimulus]\nheadless = true\n'
            f"[calibration]\nn_blocks = 1\nmoves_per_block = {n_moves}\n",
            encoding="utf-8",
        )
        words = ["--session", SESSION, "--config", str(config)]
        roles = (["stimulus", "--participant", "P1", "--task", "calibration"], ["decoder"], ["amplifier"])
        processes = [subprocess.Popen([sys.executable, "-m", "bci_app", *role, *words], stderr=-3) for role in roles]
        try:
            found = record(n_moves, processes)
        finally:
            for process in processes:
                process.terminate()
                process.wait()
    n = min(len(found["our sample"]), len(found["their sample"]))
    table = Table("", "epochs", "median, ms", "95 %, ms", "99 %, ms", title="After the flip, real time")
    for label, key in (
        ("the epoch's last sample is here", "last arrival"),
        ("our verdict is sent", "our sent"),
        ("our verdict is here", "our arrival"),
        ("MNE-LSL's epoch is here", "their arrival"),
    ):
        late = 1e3 * (found[key][:n] - found["onset"][:n])
        table.add_row(label, str(len(found[key])), *(f"{np.percentile(late, share):.1f}" for share in (50, 95, 99)))
    Console().print(table)
    apart = found["their sample"][:n] - found["our sample"][:n]
    values, counts = np.unique(apart, return_counts=True)
    print("samples between the two onsets:", dict(zip(values.tolist(), counts.tolist(), strict=True)))
    for what, key in (("out", "our sent"), ("here", "our arrival")):
        earlier = found[key][:n] < found["their arrival"][:n]
        print(f"our verdict is {what} before MNE-LSL's epoch is here in {earlier.sum()} of {n}")


if __name__ == "__main__":
    main()
