"""The two ways to make a participant's runs: through the real processes over LSL, or in one process."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bci_app import fitting, verbs
from bci_app.config import Config
from bci_app.gridworld import load_map
from bci_app.progress import Progress
from bci_app.recording import Recording
from bci_app.study import alone
from bci_app.study.conditions import Choice
from decoder import model


class Stopped(Exception):
    """The participant stopped within a run."""


class Way(Protocol):
    """How runs are made."""

    def calibrate(self, config: Config, participant: str, visit: str, seed: int) -> str:
        """Make a calibration; where it is, or nothing where it is no file. Raises Stopped where it was broken off."""

    def recording(self, config: Config, participant: str, seed: int, path: str) -> Recording:
        """The calibration that was made."""

    def online(
        self, config: Config, participant: str, visit: str, seed: int, map_name: str, decoder: Path, choice: Choice
    ) -> tuple[Recording, str]:
        """Make an online run; it and where it is. Raises Stopped where it was broken off."""


class InOneProcess:
    """With the live functions in this process. Without verdicts to hear nobody has EEG: the moves are the same."""

    def calibrate(self, config: Config, participant: str, visit: str, seed: int) -> str:
        """As `Way`."""
        return ""

    def recording(self, config: Config, participant: str, seed: int, path: str) -> Recording:
        """As `Way`."""
        return alone.calibrate(config, participant, seed)

    def online(
        self, config: Config, participant: str, visit: str, seed: int, map_name: str, decoder: Path, choice: Choice
    ) -> tuple[Recording, str]:
        """As `Way`."""
        world = load_map(map_name)
        fitted = model.load(decoder)
        listening = fitted if choice.listens else None
        told = str(fitted.info.evidence.told)
        return alone.online(config, participant, seed, world, listening, choice.policy, told), ""


@dataclass
class ThroughProcesses:
    """Over LSL, recorded, with a person or a simulated participant.

    Attributes
    ----------
    simulate, speed : as `bci_app.verbs.Wishes`.
    progress : how far a run is.
    """

    simulate: bool
    speed: float
    progress: Progress

    def _wishes(self, config: Config, participant: str, visit: str, seed: int) -> verbs.Wishes:
        return verbs.Wishes(config, participant, visit, self.simulate, self.speed if self.simulate else 1.0, seed)

    def calibrate(self, config: Config, participant: str, visit: str, seed: int) -> str:
        """As `Way`."""
        look = None if self.simulate else fitting.look_ahead
        told = verbs.calibrate(self._wishes(config, participant, visit, seed), self.progress, look)
        if told["reason"] != "complete":
            raise Stopped(f"{told['reason']}: {told['text']} ({told['recording']})")
        return str(told["recording"])

    def recording(self, config: Config, participant: str, seed: int, path: str) -> Recording:
        """As `Way`."""
        return fitting.read_calibration(Path(path), allow_damage=False)[0]

    def online(
        self, config: Config, participant: str, visit: str, seed: int, map_name: str, decoder: Path, choice: Choice
    ) -> tuple[Recording, str]:
        """As `Way`."""
        wishes = self._wishes(config, participant, visit, seed)
        told, recording = verbs.online(wishes, map_name, decoder, str(choice.policy), True, self.progress)
        if told["reason"] != "complete":
            raise Stopped(f"{told['reason']}: {told['text']} ({told['recording']})")
        return recording, str(told["recording"])
