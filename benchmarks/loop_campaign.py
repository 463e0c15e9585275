"""The loop's figures at full length: calibrations by decodability, online runs over seeds, controls, latency.

Every run goes through the real processes over LSL. Results are appended to a JSON-lines file, so that an interrupted
campaign continues where it stopped.

    python benchmarks/loop_campaign.py decodability online controls latency --out campaign.jsonl
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bci_app import metrics
from bci_app.config import Config
from bci_app.fitting import labelled
from bci_app.recording import read
from decoder.calibration import calibrate, permuted_accuracies

SEEDS = (1, 2, 3, 4, 5)
MAPS = ("open", "obstacles")


class Campaign:
    """Runs `bci-app` and remembers what it printed."""

    def __init__(self, out: Path, recordings: Path, speed: float) -> None:
        self.out, self.speed = out, speed
        self.config = out.with_suffix(".toml")
        self.config.parent.mkdir(parents=True, exist_ok=True)
        self.config.write_text(f'recordings = "{recordings.as_posix()}"\n', encoding="utf-8")
        lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
        self.done: dict[str, dict[str, Any]] = {entry["key"]: entry for entry in map(json.loads, lines)}

    def once(self, key: str, *words: object) -> dict[str, Any]:
        """The JSON that a command printed, now or in an earlier call of this campaign."""
        if key not in self.done:
            print(f"{key} ...", file=sys.stderr, flush=True)
            command = [sys.executable, "-m", "bci_app", *map(str, words), "--config", str(self.config), "--json"]
            finished = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            self.done[key] = {"key": key, **json.loads(finished.stdout)}
            with self.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(self.done[key]) + "\n")
        return self.done[key]

    def fitted(self, decodability: float, seed: int) -> dict[str, Any]:
        """A participant's calibration of 600 moves, fitted."""
        name = f"d{decodability:.2f} s{seed}"
        words = self.words(decodability, seed)
        calibrated = self.once(f"calibrate {name}", "calibrate", *words, "--seed", seed, "--simulate")
        fit = self.once(f"fit {name}", "fit", calibrated["recording"])
        return {**fit, "recording": calibrated["recording"]}

    def online(self, decodability: float, seed: int, map_name: str, control: bool) -> dict[str, Any]:
        """An online run of 19 episodes; `control` switches the participant's ErrP off, so verdicts are coin flips."""
        self.fitted(decodability, seed)
        name = f"online d{decodability:.2f} s{seed} {map_name}{' no-errp' if control else ''}"
        words = [*self.words(decodability, seed), "--map", map_name, "--seed", 100 + seed, "--below-gate", "--simulate"]
        return self.once(name, "online", *words, *(["--no-errp"] if control else []))

    def words(self, decodability: float, seed: int, speed: float | None = None) -> list[object]:
        """Who takes part, and how fast."""
        who = ["--participant", f"D{round(decodability * 100)}S{seed}", "--participant-seed", seed]
        return [*who, "--decodability", decodability, "--speed", speed or self.speed, "--headless"]


def decodability(campaign: Campaign, table: Table) -> None:
    """Set against cross-validated balanced accuracy."""
    for level in (0.60, 0.75, 0.90):
        for seed in SEEDS[:3]:
            found = campaign.fitted(level, seed)["calibration"]
            text = f"{found['balanced_accuracy']:.3f} ({found['n_valid']} of {found['n_moves']} epochs valid)"
            table.add_row(f"CV balanced accuracy, set {level:.2f}, participant {seed}", text)


def online(campaign: Campaign, table: Table) -> None:
    """Steps and success at 0.75, against the same policy on coin flips."""
    for map_name in MAPS:
        for control in (False, True):
            told = [campaign.online(0.75, seed, map_name, control) for seed in (SEEDS[:3] if control else SEEDS)]
            figures = metrics.online([read(Path(run["recording"])) for run in told])
            steps = [metrics.online([read(Path(run["recording"]))])["mean_steps"] for run in told]
            error = float(np.std(steps, ddof=1) / np.sqrt(len(steps)))
            text = f"{figures['mean_steps']:.2f} +- {error:.2f} steps, success {figures['success']:.1%}, verdicts "
            text += f"{figures['verdict_accuracy']:.3f}, balanced {figures['verdict_balanced_accuracy']:.3f}"
            table.add_row(f"{map_name}, 0.75, {'ErrP off' if control else 'ErrP on'}, {len(told)} seeds", text)


def controls(campaign: Campaign, table: Table) -> None:
    """What must be at chance: permuted labels, and the 450 ms before the move, on a well decodable participant."""
    path = Path(campaign.fitted(0.90, 1)["recording"])
    settings = Config()
    recording = read(path)
    epochs = labelled(recording, settings)
    features, error = epochs.features, epochs.error
    chance = permuted_accuracies(features, error, settings.classifier, 20, np.random.default_rng(0))
    low, high = np.percentile(chance, (2.5, 97.5))
    text = f"{chance.mean():.3f} [{low:.3f}, {high:.3f}] over 20 permutations"
    table.add_row("CV balanced accuracy, labels permuted", text)
    before = settings.model_copy(update={"chain": settings.chain.model_copy(update={"start_ms": -450.0})})
    epochs = labelled(recording, before)
    scores = calibrate(epochs.features, epochs.error, settings.classifier, settings.chain.n_windows)
    for name, found in (("tenfold", scores.tenfold), ("contiguous", scores.blocked)):
        value = found.balanced_accuracy
        table.add_row(f"450 ms before the move, {name} folds", f"{value.value:.3f} [{value.low:.3f}, {value.high:.3f}]")


def latency(campaign: Campaign, table: Table) -> None:
    """At speed 1, over a whole online run."""
    campaign.fitted(0.75, 1)
    words = [*campaign.words(0.75, 1, speed=1.0), "--map", "open", "--seed", 7, "--below-gate", "--simulate"]
    run = campaign.once("latency", "online", *words)
    recording = read(Path(run["recording"]))
    found = metrics.latencies([recording], speed=1.0)
    table.add_row("moves at speed 1", str(run["moves"]))
    for name, value in found.items():
        table.add_row(name, f"{value:.2f}")


def main() -> None:
    """Run the parts named on the command line and print one table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = {"decodability": decodability, "online": online, "controls": controls, "latency": latency}
    parser.add_argument("parts", nargs="*", choices=[*parts, []], default=list(parts))
    parser.add_argument("--out", type=Path, default=Path("recordings/campaign.jsonl"))
    parser.add_argument("--speed", type=float, default=20.0)
    arguments = parser.parse_args()
    campaign = Campaign(arguments.out, arguments.out.with_suffix("") / "recordings", arguments.speed)
    table = Table("figure", "value")
    for part in arguments.parts:
        parts[part](campaign, table)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
