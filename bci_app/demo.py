"""The whole experiment with a simulated participant, and one table that says how it went."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bci_app import fitting, metrics, verbs
from bci_app import replay as replaying
from bci_app.config import Config
from bci_app.gridworld import SHIPPED_MAPS
from bci_app.progress import Progress, named
from bci_app.recording import read
from bci_app.runs import free_visit

PARTICIPANT = "DEMO"


def run(config: Config, speed: float, seed: int, progress: Progress) -> dict[str, Any]:
    """Calibrate, fit, go online on both maps, replay all three; the summary is also written as ``summary.json``."""
    wishes = verbs.Wishes(config, PARTICIPANT, free_visit(Path(config.recordings), PARTICIPANT), True, speed, seed)
    calibrated = verbs.calibrate(wishes, named(progress, "1/4 calibrate"))
    fitted = fitting.fit([Path(calibrated["recording"])], config, False, named(progress, "2/4 fit"))
    runs = {}
    for number, name in enumerate(SHIPPED_MAPS):
        wish = replace(wishes, seed=seed + 1 + number)
        told = named(progress, f"3/4 online {name}")
        runs[name], _ = verbs.online(wish, name, Path(fitted["model"]), None, True, told)
    paths = [Path(calibrated["recording"]), *(Path(told["recording"]) for told in runs.values())]
    replays = [replaying.replay(path, None, None, False, named(progress, "4/4 replay")) for path in paths]
    summary = _summary(fitted, runs, replays, paths, speed)
    newest = Path(config.recordings) / "summary.json"
    summary["summary"] = str(newest)
    for path in (paths[0].parent.parent / newest.name, newest):
        path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


def is_good(summary: dict[str, Any]) -> bool:
    """Whether everything was recorded and replayed as it should be."""
    calibration, same = summary["calibration"], replaying.is_equal(summary)
    return same and calibration["n_valid"] == calibration["n_moves"] > 0


def _summary(
    fitted: dict[str, Any],
    runs: dict[str, dict[str, Any]],
    replays: list[dict[str, Any]],
    paths: list[Path],
    speed: float,
) -> dict[str, Any]:
    recordings = {name: read(Path(told["recording"])) for name, told in runs.items()}
    return {
        "calibration": fitted["calibration"],
        "model": fitted["model"],
        "policy": {name: told["policy"] for name, told in runs.items()},
        "online": {name: metrics.online([recording]) for name, recording in recordings.items()},
        "latency": metrics.latencies(list(recordings.values()), speed),
        "replay": {key: sum(result["replay"][key] for result in replays) for key in replays[0]["replay"]},
        "differences": [text for result in replays for text in result["differences"]],
        "replay_seconds": [result["seconds"] for result in replays],
        "recordings": [str(path) for path in paths],
    }


def show(summary: dict[str, Any], console: Console) -> None:
    """The summary as one table."""
    table = Table("figure", "value", title="Demo: one simulated participant, all of the experiment")
    calibration, latency, replay = summary["calibration"], summary["latency"], summary["replay"]
    table.add_row("valid epochs", f"{calibration['n_valid']} of {calibration['n_moves']}")
    for name in ("accuracy", "balanced_accuracy", "auc"):
        interval = calibration["tenfold"][name]
        blocked = calibration["blocked"][name]["value"]
        text = (
            f"{interval['value']:.3f} [{interval['low']:.3f}, {interval['high']:.3f}], contiguous folds {blocked:.3f}"
        )
        table.add_row(f"cross-validated {name.replace('_', ' ')}", text)
    for name, figures in summary["online"].items():
        table.add_section()
        table.add_row(f"{name}: policy", summary["policy"][name])
        table.add_row(f"{name}: success", f"{_percent(figures['success'])} of {figures['n_episodes']} episodes")
        table.add_row(f"{name}: mean steps", f"{figures['mean_steps']:.2f}")
        accuracy = f"{_percent(figures['verdict_accuracy'])}, balanced {_percent(figures['verdict_balanced_accuracy'])}"
        table.add_row(f"{name}: verdict accuracy", accuracy)
    table.add_section()
    for name in ("verdict", "action"):
        table.add_row(
            f"{name} latency p50 / p99", " / ".join(f"{latency[f'{name}_{p}_ms']:.2f} ms" for p in ("p50", "p99"))
        )
    table.add_row("replay: verdicts equal", f"{replay['verdicts_equal']} of {replay['verdicts']}")
    table.add_row("replay: actions equal", f"{replay['actions_equal']} of {replay['actions']}")
    console.print(table)
    for path in [summary["summary"], *summary["recordings"]]:
        console.print(path, style="dim", markup=False, soft_wrap=True)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.1%}"
