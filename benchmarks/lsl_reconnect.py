"""How long LSL itself takes to hear a stream again that was taken off the network and is back: nothing of ours is in it
but the settings of `bci_app/lsl_api.cfg`.

    python benchmarks/lsl_reconnect.py --losses 200

An inlet that lost its stream asks for it for a second at least, then rests for half a second. A stream that goes closes
its connections before it falls silent: where it still answers the first question, the inlet takes it for alive, tries
it in vain and begins anew, which takes a second and a half more. These times are fixed in liblsl. Losses are of 0.1 to
30 s as in `bci-app drill`, even in their logarithm; `--longest` shortens them.
"""

import argparse
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from random import Random

import numpy as np
import pylsl

import bci_app.lsl  # noqa: F401  (its settings)
from bci_app.drill import DROP_OUT_S

CHUNK_S, SFREQ, N_CHANNELS = 0.01, 256, 8
STAYS_S = 6.0
"""How long the stream stays between two losses: longer than LSL has ever taken."""


def play(name: str, losses: list[float]) -> None:
    """Be the stream: tell the time of each return on stdout."""
    info = pylsl.StreamInfo(name, "EEG", N_CHANNELS, SFREQ, "float32", f"source of {name}")
    chunk = [[0.0] * N_CHANNELS] * round(CHUNK_S * SFREQ)

    def send(seconds: float, outlet: pylsl.StreamOutlet | None) -> None:
        ends = pylsl.local_clock() + seconds
        while (now := pylsl.local_clock()) < ends:
            if outlet is not None:
                outlet.push_chunk(chunk)
            time.sleep(min(CHUNK_S, ends - now))

    outlet: pylsl.StreamOutlet | None = pylsl.StreamOutlet(info)
    send(STAYS_S, outlet)
    for loss in losses:
        outlet = None
        send(loss, None)
        outlet = pylsl.StreamOutlet(info)
        print(pylsl.local_clock(), flush=True)
        send(STAYS_S, outlet)


def follow(name: str, losses: list[float]) -> list[float]:
    """Seconds from each return of the stream until a sample is here."""
    words = [sys.executable, __file__, "--play", name, *map(str, losses)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        found = pylsl.resolve_byprop("name", name, 1, 20.0)
        inlet = pylsl.StreamInlet(found[0], recover=True)
        inlet.open_stream(10.0)
        took = []
        for line in process.stdout:
            returned = float(line)
            while True:
                samples, stamps = inlet.pull_chunk(timeout=CHUNK_S, max_samples=4096)
                if samples and stamps[-1] > returned:
                    break
            took.append(pylsl.local_clock() - returned)
    return took


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--losses", type=int, default=200)
    parser.add_argument("--longest", type=float, default=DROP_OUT_S[1], help="Seconds a loss may last.")
    parser.add_argument("--streams", type=int, default=8, help="How many are lost side by side.")
    parser.add_argument("--seed", type=int, default=2022)
    parser.add_argument("--play", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.play:
        play(asked.play[0], list(map(float, asked.play[1:])))
        return
    rng, low = Random(asked.seed), DROP_OUT_S[0]
    lasts = [low * (asked.longest / low) ** rng.random() for _ in range(asked.losses)]
    shares = [lasts[number :: asked.streams] for number in range(asked.streams)]
    with ThreadPoolExecutor(asked.streams) as threads:
        took = np.concatenate(list(threads.map(follow, [f"Lost {number}" for number in range(len(shares))], shares)))
    since_loss = took + np.concatenate(shares)
    again = (np.concatenate(shares) < 1.0) & (since_loss > 2.0)
    figures = {
        "losses": len(took),
        **{f"p{share}_s": round(float(np.quantile(took, share / 100)), 2) for share in (50, 95, 99)},
        "slowest_s": round(float(took.max()), 2),
        "of_losses_below_1_s": int((np.concatenate(shares) < 1.0).sum()),
        "of_these_tried_the_old_one_first": int(again.sum()),
    }
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
