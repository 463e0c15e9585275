"""A day in one session: what grows, and what is lost.

    python benchmarks/soak.py [--hours 24] [--speed 40] --out FOLDER

One online run of that many session hours at `--speed`, through the real processes and LabRecorder, with a simulated
amplifier of 128 Hz so that a day fits a disk. Every minute of real time the memory of each process and the size of each
file are written into FOLDER/soak.csv; at the end it is told by how much each grew in an hour of session time (with the
95 % interval of the slope, the first tenth left out), which files grew besides the recording, and whether each message
of the stimulus has its marker. What each process keeps of a run by design is said beside it: bci-app keeps what was
said, so that a process that dies can be told.
"""

import argparse
import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pyxdf
from rich.console import Console
from rich.table import Table
from scipy.stats import linregress

from bci_app.protocol import decode, marker_code

EVERY_S = 20.0
EPISODES_AN_HOUR = 75.0
"""Of 14 moves and rests in the mean: 48 s."""
DISTANCES = 19
ROLES = ("session", "stimulus", "decoder", "policy", "amplifier", "recorder")
MB = 1e6


def run(*words: object) -> dict:
    """What a command prints as JSON."""
    command = [sys.executable, "-m", "bci_app", *map(str, words), "--json"]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)


def role_of(process: psutil.Process) -> str:
    """Which of a run's processes it is."""
    words = process.cmdline()
    return next((role for role in ROLES if role in words[:5]), "recorder" if "LabRecorder" in words[0] else words[0])


def sizes(folder: Path) -> dict[str, int]:
    """Bytes of each file but recordings, by its path."""
    return {
        str(path.relative_to(folder)): path.stat().st_size
        for path in folder.rglob("*")
        if path.is_file() and path.suffix != ".xdf"
    }


def watch(running: subprocess.Popen[bytes], folder: Path, out: Path, speed: float) -> list[dict[str, float]]:
    """Memory in MB, and megabytes of other files, over session hours."""
    rows: list[dict[str, float]] = []
    started, main = time.monotonic(), psutil.Process(running.pid)
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["hours", *ROLES, "other_files"])
        writer.writeheader()
        while running.poll() is None:
            found = {"session": main.memory_info().rss / MB}
            for child in main.children(recursive=True):
                try:
                    found[role_of(child)] = child.memory_info().rss / MB
                except psutil.Error:
                    continue  # it ended meanwhile
            hours = (time.monotonic() - started) * speed / 3600
            row = {"hours": hours, "other_files": sum(sizes(folder).values()) / MB} | found
            rows.append({key: value for key, value in row.items() if key in writer.fieldnames})
            writer.writerow(rows[-1])
            file.flush()
            try:
                running.wait(EVERY_S)
            except subprocess.TimeoutExpired:
                continue
    return rows


def slopes(rows: list[dict[str, float]]) -> Table:
    """By how much each process, and the files, grew."""
    table = Table("process", "MB at first", "MB at last", "MB an hour of session time [95 %]", title="What grows")
    whole = [row for row in rows if all(role in row for role in ROLES)]
    kept = whole[len(whole) // 10 :]
    for name in (*ROLES, "other_files"):
        hours, values = (np.array([row[key] for row in kept]) for key in ("hours", name))
        fit = linregress(hours, values)
        half = 1.96 * fit.stderr
        cells = (
            f"{values[0]:.1f}",
            f"{values[-1]:.1f}",
            f"{fit.slope:+.3f} [{fit.slope - half:+.3f}, {fit.slope + half:+.3f}]",
        )
        table.add_row(name, *cells)
    return table


def markers(path: Path) -> tuple[int, int, int]:
    """Messages that have a marker, those whose marker is there with their stamp, and markers in all."""
    wanted = [{"name": "bci-stimulus"}, {"name": "bci-markers"}]
    streams, _ = pyxdf.load_xdf(str(path), wanted, synchronize_clocks=False, dejitter_timestamps=False)
    by_name = {stream["info"]["name"][0]: stream for stream in streams}
    stimulus, codes = by_name["bci-stimulus"], by_name["bci-markers"]
    there = {
        (float(stamp), int(code[0])) for stamp, code in zip(codes["time_stamps"], codes["time_series"], strict=True)
    }
    expected = [
        (float(stamp), marker_code(decode(sample[0])))
        for stamp, sample in zip(stimulus["time_stamps"], stimulus["time_series"], strict=True)
    ]
    meant = [pair for pair in expected if pair[1] is not None]
    return len(meant), sum(pair in there for pair in meant), len(codes["time_stamps"])


def main() -> None:
    """Calibrate, go online for a day, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--speed", type=float, default=40.0)
    parser.add_argument("--out", type=Path, required=True)
    wishes = parser.parse_args()
    folder = wishes.out / "recordings"
    folder.mkdir(parents=True)
    config = wishes.out / "soak.toml"
    rounds = max(1, round(wishes.hours * EPISODES_AN_HOUR / DISTANCES))
    config.write_text(
        f'recordings = "{folder.as_posix()}"\n[stimulus]\nheadless = true\n[simulation]\nsfreq = 128.0\n'
        f"[calibration]\nn_blocks = 2\n[online]\nrounds = {rounds}\n",
        encoding="utf-8",
    )
    who = ("--participant", "SOAK", "--simulate", "--speed", wishes.speed, "--config", config)
    model = run("fit", run("calibrate", *who)["recording"], "--config", config)["model"]
    before = sizes(folder)
    command = [sys.executable, "-m", "bci_app", "online", *map(str, who), "--map", "open", "--model", model, "--json"]
    with (wishes.out / "online.json").open("wb") as told:
        running = subprocess.Popen(command, stdout=told)
        rows = watch(running, folder, wishes.out / "soak.csv", wishes.speed)
    console = Console(width=120)
    console.print(f"bci-app online ended with {running.returncode} after {rows[-1]['hours']:.1f} session hours.")
    console.print(slopes(rows))
    grown = {name: size - before.get(name, 0) for name, size in sizes(folder).items() if size != before.get(name, 0)}
    console.print({"other files that are new or grew, bytes": grown})
    told_json = json.loads((wishes.out / "online.json").read_text(encoding="utf-8"))
    told_json.pop("notes", None)
    meant, there, in_all = markers(Path(told_json["recording"]))
    console.print(f"{meant} messages have a marker: {there} are there with their stamp, {in_all} markers in all.")
    console.print({key: told_json[key] for key in ("reason", "moves", "verdicts", "actions", "verified")})


if __name__ == "__main__":
    main()
