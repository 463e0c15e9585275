"""A recording that is to be exported: what it is called, what is in it, what is known of how it came about."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bci_app.bids.events import Events, events
from bci_app.bids.signals import Signals, signals
from bci_app.config import validated
from bci_app.errors import SetupError
from bci_app.protocol import RunSeed, SessionEnd, SessionStart
from bci_app.recording import Recording, read_run
from bci_app.runs import Run, checksum
from decoder.chain import design
from decoder.epochs import Shape
from decoder.timeline import measured_rate

NAME = re.compile(
    r"sub-(?P<participant>[A-Za-z0-9]+)_ses-(?P<visit>[A-Za-z0-9]+)_task-(?P<task>[A-Za-z0-9]+)_run-(?P<run>\d+)_eeg\.xdf"
)
MACHINE = ("recordings", "background", "rehearse", "set_up")
"""Settings that are paths of the machine the run was made on: they aren't told."""


@dataclass(frozen=True, eq=False)
class Source:
    """A recorded run, read.

    Attributes
    ----------
    run : participant, visit, task and number, as its name tells them.
    path : of the recording.
    sidecar : what was kept beside it; empty where there is none.
    recording, signals, events : what is in it.
    start : its first message.
    """

    run: Run
    path: Path
    sidecar: dict[str, Any]
    recording: Recording
    signals: Signals
    events: Events
    start: SessionStart

    @property
    def simulated(self) -> bool:
        """Whether a program took the participant's place."""
        return bool(self.sidecar.get("simulated")) or self.recording.eeg.source_id.startswith("bci-app/")

    @property
    def ended(self) -> str:
        """How it ended."""
        ends = self.recording.of(SessionEnd)
        return ends[-1][1].reason if ends else "cut"

    @property
    def continues(self) -> list[str]:
        """Names of the runs that it went on from."""
        return [Path(name).name for name in self.sidecar.get("continues", [])]

    @property
    def n_lost(self) -> int:
        """Samples missing inside it."""
        return sum(max(0, gap.n_lost) for gap in self.events.gaps)

    def told(self) -> dict[str, Any]:
        """What ``_eeg.json`` tells of the run under ``ErrpBci``."""
        seeds, eeg, sidecar = self.recording.of(RunSeed), self.recording.eeg, self.sidecar
        return {
            "Simulated": self.simulated,
            "Map": self.start.map,
            "Layout": self.start.layout,
            "Ended": self.ended,
            "Continues": self.continues,
            "Seed": seeds[0][1].seed if seeds else None,
            "Speed": sidecar.get("speed"),
            "Session": self.start.session,
            "Stream": {"Name": eeg.name, "SourceId": eeg.source_id},
            "SamplesExact": self.signals.exact,
            "PhotonDelayMs": _photon_delay(sidecar.get("config", {})),
            "MeasuredSamplingFrequency": _rate(self.recording),
            "FirstStamp": float(self.recording.times[0]),
            "LostSamples": self.n_lost,
            "Gaps": [{"Sample": gap.row, "Lost": gap.n_lost} for gap in self.events.gaps],
            "Damage": list(self.recording.damage),
            "Sources": {"Recording": self.path.name, "SHA256": checksum(self.path)},
            "Decoder": (sidecar.get("model") or {}).get("sha256"),
            "Policy": (sidecar.get("policy") or {}).get("sha256"),
            "Versions": sidecar.get("versions", {}),
            "Configuration": _without_paths(sidecar.get("config", {})),
        }

    def companions(self) -> list[Path]:
        """The files beside the recording that belong to it: sidecar, checksums, decoders; not the logs."""
        stem = self.path.name.removesuffix("_eeg.xdf")
        beside = self.path.parent.glob(f"{stem}_*")
        return sorted(path for path in beside if path.suffix in (".json", ".safetensors"))


def find(paths: Sequence[Path]) -> list[Path]:
    """All recordings that are named, or lie below the folders that are, each once and in order.

    Raises SetupError where a path doesn't exist, or there is none.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += sorted(each for each in path.rglob("*_eeg.xdf") if NAME.fullmatch(each.name))
        elif path.exists():
            found.append(path)
        else:
            raise SetupError(f"There is no recording or folder {path}.")
    if not found:
        raise SetupError(f"There are no recordings (sub-*_eeg.xdf) below {', '.join(map(str, paths))}.")
    return list({path.resolve(): path for path in found}.values())


def run_of(path: Path) -> Run:
    """Which run a recording is, by its name. Raises SetupError for another name."""
    match = NAME.fullmatch(path.name)
    if match is None:
        raise SetupError(
            f"{path} must be named as in sub-P001_ses-S001_task-online_run-001_eeg.xdf to be exported. "
            "Rename it and its sidecar."
        )
    return Run(path.parent, match["participant"], match["visit"], match["task"], int(match["run"]))


def read_source(path: Path, allow_damage: bool) -> Source:
    """Read a recording. Raises SetupError where it is no run of ours, or (unless `allow_damage`) isn't whole."""
    run = run_of(path)
    recording, start, sidecar = read_run(path, allow_damage)
    recording.eeg.check()
    if start.task != run.task or start.participant != run.participant:
        raise SetupError(
            f"{path} is called {run.task} of {run.participant}, and holds {start.task} of {start.participant}. Give it "
            "its own name again."
        )
    return Source(
        run,
        path,
        sidecar,
        recording,
        signals(recording.eeg, recording.samples),
        events(recording, _shape(sidecar, path, recording)),
        start,
    )


def _shape(sidecar: dict[str, Any], path: Path, recording: Recording) -> Shape:
    """What an epoch of the run looked like, by its own configuration."""
    config = sidecar.get("config", {})
    kept = config.get("chain", {}) if isinstance(config, dict) else {}
    made = design(validated({"chain": kept}, str(path)).chain, recording.eeg.sfreq)
    return Shape(recording.eeg.sfreq, made.n_before, made.n_after)


def _photon_delay(config: Any) -> float | None:
    """What is in the stamps of the moves, in ms; None where the sidecar doesn't tell."""
    stimulus = config.get("stimulus") if isinstance(config, dict) else None
    return stimulus.get("photon_delay_ms") if isinstance(stimulus, dict) else None


def _rate(recording: Recording) -> float | None:
    return measured_rate(recording.times, recording.eeg.sfreq) if len(recording.times) > 2 else None


def _without_paths(config: Any) -> Any:
    if not isinstance(config, dict):
        return config
    return {key: _without_paths(value) for key, value in config.items() if key not in MACHINE}
