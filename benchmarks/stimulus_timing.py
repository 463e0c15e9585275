"""Markers and flips over 10,000 moves: none before its flip, how soon after it, how evenly the screen flips.

The stimulus's own frame loop runs in this process, headless at high speed or in a window at real speed (`--window`),
with a stand-in for the decoder that finds every epoch valid. Each flip's return is noted by the stamps' own clock.

    python benchmarks/stimulus_timing.py --moves 10000
    xvfb-run -s "-screen 0 1920x1080x24" python benchmarks/stimulus_timing.py --window --moves 200
"""

import argparse
import secrets
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bci_app.config import Config, changed
from bci_app.gridworld import load_map
from bci_app.lsl import MessageOutlet, local_clock, session_clock
from bci_app.peer import Peer
from bci_app.protocol import STIMULUS, VERDICTS, LateFrame, Message, MoveOnset, Verdict
from stimulus.pace import Pace
from stimulus.paradigm import Paradigm
from stimulus.process import _Shell
from stimulus.view import View

SECONDS = {"countdown_s": 0.5, "arrow_s": 0.25, "rest_s": 0.25}
"""A step of one second, so that 10,000 don't take all day."""


class Watched(View):
    """Notes when each flip returned."""

    flips: list[float]

    def flip(self) -> None:
        """Flip, and note when it had."""
        super().flip()
        self.flips.append(local_clock())


class Notebook(Peer):
    """Notes when each move was told, and answers it as a decoder does."""

    def __init__(self, *words: Any) -> None:
        super().__init__(*words)
        self.decoder = MessageOutlet(VERDICTS, self.session)
        self.told: list[tuple[float, float]] = []
        """Stamp and real time of each move's message."""
        self.late: list[LateFrame] = []

    def push(self, message: Message, stamp: float | None = None) -> None:
        """Publish, and note when it was out."""
        super().push(message, stamp)
        if isinstance(message, LateFrame):
            self.late.append(message)
        if isinstance(message, MoveOnset) and stamp is not None:
            self.told.append((stamp, local_clock()))
            fields = {"episode": message.episode, "step": message.step, "clock_offset": 0.0}
            self.decoder.push(Verdict(session=self.session, outcome="unjudged", **fields), stamp)


def measure(config: Config, speed: float) -> tuple[list[float], Notebook, Pace, tuple[int, int]]:
    """Play one calibration."""
    session, clock = f"timing-{secrets.token_hex(4)}", session_clock(speed)
    peer = Notebook(STIMULUS, "stimulus", session, clock)
    view = Watched(config.stimulus, "timing")
    view.flips = []
    paradigm = Paradigm.calibration(config, load_map("open"), session, "TIMING", 1)
    shell = _Shell(config, peer, paradigm, view)
    shell.find_pace()
    shell.connect(commanded=False)
    view.flips.clear()
    paradigm.start(clock.now())
    while not paradigm.done:
        shell.frame()
    size = view.size
    view.close()
    return view.flips, peer, shell._pace, size


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=10_000)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument("--window", action="store_true", help="on a screen, at real speed")
    parser.add_argument("--fullscreen", action="store_true")
    arguments = parser.parse_args()
    speed = 1.0 if arguments.window else arguments.speed
    screen = {"headless": not arguments.window, "fullscreen": arguments.fullscreen, "person": False}
    stimulus, calibration = {**SECONDS, **screen}, {"n_blocks": 1, "moves_per_block": arguments.moves}
    config = changed(Config(), {"stimulus": stimulus, "calibration": calibration})
    times, peer, pace, size = measure(config, speed)
    clock, flips = peer.clock, np.array(times)
    stamps, told = (np.array(part) for part in zip(*peer.told, strict=True))
    real = clock.origin + (stamps - clock.origin) / speed if speed != 1.0 else stamps
    # Rounding of a session time at speed N may take a millionth of a microsecond off.
    before = flips[np.searchsorted(flips, real + 1e-9, side="right") - 1]
    table = Table("figure", "value")
    table.add_row(
        "moves", f"{len(stamps)} at speed {speed:g}, {size[0]} x {size[1]}, {len(peer.late)} late frames said"
    )
    table.add_row("stamps before the flip's return", str(int((real < before - 1e-9).sum())))
    table.add_row("messages sent before the flip's return", str(int((told < before).sum())))
    # Every move must have a flip of its own right before it.
    n_flips = len(np.unique(before))
    table.add_row("flips with a move", f"{n_flips} for {len(stamps)} moves")
    for name, delays in (("flip's return to stamp", real - before), ("flip's return to message sent", told - before)):
        p50, p99, top = np.percentile(delays * 1e3, (50, 99, 100))
        table.add_row(name, f"{p50:.3f} ms, 99 % within {p99:.3f}, longest {top:.3f}, SD {delays.std() * 1e3:.3f}")
    gaps = np.diff(flips) * 1e3
    running = gaps[gaps < 3e3 * pace.interval]
    text = f"{np.median(running):.2f} ms, SD {running.std():.2f}, {'paced' if pace.paced else 'not paced'}"
    table.add_row("flip interval while the countdown runs", text)
    steps = np.diff(stamps)
    same = steps[steps < 1.2]
    table.add_row(
        "onset to onset of one episode", f"{same.mean():.4f} s, SD {same.std() * 1e3:.2f} ms, of 1 s asked for"
    )
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
