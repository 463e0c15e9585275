"""Does the loop notice the console? Online runs with and without it, in turns; and is what the page shows recorded?

Each run with the console has pages open in Chromium, one of which is reloaded meanwhile. What it shows at the end
is compared with the recording. Latencies are those of `bci_app.metrics`, over all moves of all runs of a kind.

    python benchmarks/console_latency.py --pairs 4 --speed 1 --out recordings/console
    python benchmarks/console_latency.py --pairs 4 --speed 20 --priority high --out recordings/console
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, expect, sync_playwright
from rich.console import Console
from rich.table import Table

from bci_app import metrics
from bci_app.protocol import Action, Verdict
from bci_app.recording import Recording, read

VIEWERS = 3
SMALL = """
recordings = "{folder}"
priority = "{priority}"
[stimulus]
headless = true
[calibration]
n_blocks = 2
moves_per_block = 60
break_s = 3
[online]
distances = {distances}
"""


def bci_app(*words: object) -> list[str]:
    """A command line."""
    return [sys.executable, "-m", "bci_app", *map(str, words)]


def calibrated(config: Path) -> None:
    """A participant with a decoder, unless there is one."""
    if list(config.parent.rglob("*_decoder.safetensors")):
        return
    words = (
        "calibrate",
        "--participant",
        "LOOP",
        "--simulate",
        "--speed",
        20,
        "--seed",
        1,
        "--config",
        config,
        "--json",
    )
    told = subprocess.run(bci_app(*words), stdout=subprocess.PIPE, check=True)
    subprocess.run(
        bci_app("fit", json.loads(told.stdout)["recording"], "--config", config), stdout=subprocess.DEVNULL, check=True
    )


def online(config: Path, speed: float, seed: int, browser: Browser | None) -> tuple[Recording, dict[str, str]]:
    """One run, with a console and pages of it where there is a `browser`; its recording, and what the page showed."""
    words = ["online", "--participant", "LOOP", "--map", "open", "--below-gate", "--simulate", "--speed", speed]
    words += ["--seed", seed, "--config", config, "--json", *(["--console"] if browser else [])]
    run = subprocess.Popen(bci_app(*words), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    shown: dict[str, str] = {}
    assert run.stderr is not None
    if browser is not None:
        address = next(found[0] for line in run.stderr if (found := re.findall(r"^Console: (\S+)", line)))
        threading.Thread(target=run.stderr.read, daemon=True).start()
        shown = watched(browser, address)
    told = json.loads(run.communicate()[0])
    return read(Path(told["recording"])), shown


def watched(browser: Browser, address: str) -> dict[str, str]:
    """Look at a run to its end on several pages; what the first shows then."""
    context = browser.new_context()
    pages = [context.new_page() for _ in range(VIEWERS)]
    for page in pages:
        page.goto(address)
    expect(pages[0].locator("#n_episodes")).to_have_text(re.compile("[1-9]"), timeout=600_000)
    pages[0].reload()
    expect(pages[0].locator("#phase")).to_have_text(re.compile("ended: complete"), timeout=7_200_000)
    expect(pages[0].locator("#accuracy")).to_have_text(re.compile(" of "))
    shown = figures_on(pages[0])
    context.close()
    return shown


def figures_on(page: Page) -> dict[str, str]:
    """The numbers on a page."""
    names = ("accuracy", "balanced", "hits", "rejections", "rejected", "n_episodes", "success", "mean_steps")
    shown = {name: page.locator(f"#{name}").inner_text() for name in names}
    for row, name in enumerate(("verdict", "action")):
        cells = page.locator("#latency tr").nth(row).locator("td").all_inner_texts()
        shown |= {f"{name} n": cells[1], f"{name} p50": cells[2], f"{name} p99": cells[3]}
    return shown


def figures_of(recording: Recording, speed: float) -> dict[str, str]:
    """The same numbers by the recording."""
    found, counts = metrics.online([recording]), metrics.confusion(recording)
    latency = metrics.latencies([recording], speed)
    judged = {(verdict.episode, verdict.step) for _, verdict in recording.of(Verdict)}
    answered = {(action.episode, action.step - 1) for _, action in recording.of(Action)} & judged
    return {
        "accuracy": f"{100 * found['verdict_accuracy']:.1f} % of {counts.n}",
        "balanced": f"{100 * found['verdict_balanced_accuracy']:.1f} %",
        "hits": f"{counts.hits} of {counts.hits + counts.misses}",
        "rejections": f"{counts.correct_rejections} of {counts.correct_rejections + counts.false_alarms}",
        "rejected": str(sum(verdict.outcome == "rejected" for _, verdict in recording.of(Verdict))),
        "n_episodes": str(found["n_episodes"]),
        "success": f"{100 * found['success']:.1f} %",
        "mean_steps": f"{found['mean_steps']:.2f}",
        "verdict n": str(len(judged)),
        "verdict p50": f"{latency['verdict_p50_ms']:.2f}",
        "verdict p99": f"{latency['verdict_p99_ms']:.2f}",
        "action n": str(len(answered)),
        "action p50": f"{latency['action_p50_ms']:.2f}",
        "action p99": f"{latency['action_p99_ms']:.2f}",
    }


def differences(shown: dict[str, str], recorded: dict[str, str]) -> list[str]:
    """Where a page and its recording don't agree."""
    return [
        f"{name}: shown {shown[name]}, recorded {recorded[name]}" for name in recorded if shown[name] != recorded[name]
    ]


def resampled(recordings: list[Recording], speed: float, name: str) -> tuple[float, float]:
    """Standard error of the 99th percentile, by runs drawn again with replacement, and the percentile."""
    rng = np.random.default_rng(0)
    drawn = [
        metrics.latencies([recordings[place] for place in rng.integers(len(recordings), size=len(recordings))], speed)
        for _ in range(200)
    ]
    whole: Any = metrics.latencies(recordings, speed)[name]
    return float(np.std([figures[name] for figures in drawn])), float(whole)


def main() -> None:
    """Run pairs in the order without, with, without, with ... and print one table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=4)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--priority", choices=["auto", "high", "normal"], default="auto")
    parser.add_argument("--distances", type=int, nargs=2, default=(2, 20))
    parser.add_argument("--out", type=Path, default=Path("recordings/console"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    config = arguments.out / "console.toml"
    folder = (arguments.out / "recordings").as_posix()
    settings = SMALL.format(folder=folder, priority=arguments.priority, distances=list(arguments.distances))
    config.write_text(settings, encoding="utf-8")
    calibrated(config)
    without: list[Recording] = []
    beside: list[Recording] = []
    wrong: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for pair in range(arguments.pairs):
            without.append(online(config, arguments.speed, 2 * pair, None)[0])
            recording, shown = online(config, arguments.speed, 2 * pair, browser)
            beside.append(recording)
            wrong += differences(shown, figures_of(recording, arguments.speed))
        browser.close()
    table = Table("real ms", "without", "with", "with / without", title=f"Latency at speed {arguments.speed:g}")
    for name in metrics.latencies(without, arguments.speed):
        (error_without, a), (error_with, b) = (resampled(runs, arguments.speed, name) for runs in (without, beside))
        table.add_row(name, f"{a:.2f} +- {error_without:.2f}", f"{b:.2f} +- {error_with:.2f}", f"{b / a:.3f}")
    moves = [sum(len(run.of(Verdict)) for run in runs) for runs in (without, beside)]
    table.add_row("verdicts", *map(str, moves), "")
    Console(width=100).print(table)
    print(f"figures on the page that differ from the recordings': {len(wrong)} of {14 * len(beside)}", *wrong, sep="\n")


if __name__ == "__main__":
    main()
