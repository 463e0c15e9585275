"""One participant through all parts of a study, whatever the way: calibration, decoder, and each condition on each map.

What is done is kept and not made again. Conditions have visits of their own, for a participant may come for each.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bci_app import fitting
from bci_app.config import Config, changed
from bci_app.errors import LinkLost, SetupError
from bci_app.gridworld import load_map
from bci_app.progress import Progress
from bci_app.recording import Recording
from bci_app.rehearsing import likeness_of
from bci_app.runs import checksum
from bci_app.study.conditions import choose, coin, papers
from bci_app.study.parts import CALIBRATION, Kept, of_calibration, of_online, part_name
from bci_app.study.plan import Condition, Participant, Study, Through
from bci_app.study.ways import InOneProcess, Stopped, ThroughProcesses, Way
from decoder import model, rehearsal_file

PartDone = Callable[[int, int], None]
"""Called with how many parts of a participant are done, and of how many."""

PAPER, COIN = "paper", "coin"
"""Decoders beside our own that are made of the same calibration."""
MUTE = "calibration mute"
"""The calibration of a participant without an ErrP."""


def go_through(
    study: Study, who: Participant, through: Through, progress: Progress, part_done: PartDone = lambda done, of: None
) -> Kept:
    """Make all parts that aren't done yet; ``part_done`` is called at the beginning and after each.

    A part that fails, and a participant who stops, end it: that is kept, with the reason. Raises SetupError for what
    is wrong with what is kept; KeyboardInterrupt passes through, and a person's part is then kept as stopped. So does
    any other error, which nobody foresaw: it is kept and raised.
    """
    kept = Kept.of(study, who, through)
    kept.stopped = {}
    alone = InOneProcess()
    way: Way = alone if through == "one-process" else ThroughProcesses(not who.is_real, study.speed, progress)
    conducted = _Conducted(study, who, way, alone if "mute" in study.in_one_process else way, kept, part_done)
    try:
        conducted.all()
    except (SetupError, LinkLost, Stopped) as error:
        kept.stop(conducted.part, str(error))
    except KeyboardInterrupt:
        if who.is_real:
            kept.stop(conducted.part, "interrupted by Ctrl-C")
        raise
    except Exception as error:
        try:
            kept.stop(conducted.part, f"an error of the program, {type(error).__name__}: {error}")
        except SetupError as also:
            error.add_note(str(also))
        raise
    return kept


def done_of(study: Study, who: Participant, kept: Kept) -> tuple[int, int]:
    """How many parts of a participant are done, and of how many."""
    names = names_of(study, who)
    return len(set(names) & set(kept.parts)), len(names)


def names_of(study: Study, who: Participant) -> list[str]:
    """The parts of a participant, in order."""
    runs = [part_name(condition, name) for condition, name in study.schedule(who)]
    return [CALIBRATION, *([MUTE] if "mute" in study.conditions else []), *runs]


@dataclass
class _Conducted:
    study: Study
    who: Participant
    way: Way
    mutes: Way
    kept: Kept
    part_done: PartDone
    part: str = CALIBRATION

    def all(self) -> None:
        self._tell()
        config = self._config()
        self._calibrate(CALIBRATION, config, "CAL")
        mute = changed(config, {"simulation": {"errp": False}})
        if "mute" in self.study.conditions:
            self._calibrate(MUTE, mute, "MUTE")
        for condition, map_name in self.study.schedule(self.who):
            self.part = part_name(condition, map_name)
            if self.part not in self.kept.parts:
                self._online(condition, map_name, mute if condition == "mute" else config)

    def _config(self) -> Config:
        config = self.study.settings(self.who)
        if self.who.recording is None:
            return config
        return changed(config, {"simulation": {"rehearse": str(_person(self.study, self.who, config))}})

    def _calibrate(self, part: str, config: Config, visit: str) -> None:
        self.part = part
        way = self.mutes if part == MUTE else self.way
        seed = self.study.run_seed(self.who.name, part)
        target = self._decoder(part)
        others = [] if part == MUTE else [PAPER, *([COIN] if "coin" in self.study.conditions else [])]
        missing = [name for name in (part, *others) if not self._decoder(name).exists()]
        if part in self.kept.parts and not missing:
            return
        if part not in self.kept.parts and part not in self.kept.recorded:
            self.kept.recorded[part] = way.calibrate(config, self.who.name, visit, seed)
            self.kept.save()
        path = self.kept.recorded.get(part) or self.kept.parts.get(part, {}).get("recording", "")
        if missing:
            try:
                self._fit(way.recording(config, self.who.name, seed, path), config, seed, path, missing)
            except SetupError as error:
                if self.who.is_real:  # a person's hour isn't thrown away for what may be a full disk
                    raise SetupError(
                        f"{error} The calibration is kept: {path}. To calibrate anew, take it out of 'recorded' in "
                        f"{self.kept.path}."
                    ) from error
                self.kept.recorded.pop(part, None)  # no decoder can be had of it: the next time another is made
                raise
        papers_info = model.load(self._decoder(PAPER)).info if PAPER in others else None
        self._keep(part, of_calibration(model.load(target).info, papers_info, target, path))

    def _fit(self, recording: Recording, config: Config, seed: int, path: str, missing: list[str]) -> None:
        """Make the files of the decoders that are missing."""
        sha256 = checksum(Path(path)) if path else ""
        epochs, result, fitted = fitting.decoder_of(recording, self.who.name, config, sha256)
        for name in missing:
            match name:
                case "coin":
                    made = coin(fitted, result, epochs.features, epochs.error, config.classifier, seed)
                case "paper":
                    made = fitting.decoder_of(recording, self.who.name, papers(config), sha256)[2]
                case _:
                    made = fitted
            self._decoder(name).parent.mkdir(parents=True, exist_ok=True)
            model.save(made, self._decoder(name))

    def _online(self, condition: Condition, map_name: str, config: Config) -> None:
        part = {"paper": PAPER, "coin": COIN, "mute": MUTE}.get(condition, CALIBRATION)
        decoder = self._decoder(part)
        world = load_map(map_name)
        info = model.load(decoder).info
        choice = choose(condition, info, config.policy, self.study.papers_gate, world)
        seed = self.study.run_seed(self.who.name, self.part)
        way = self.mutes if condition == "mute" else self.way
        recording, path = way.online(config, self.who.name, condition.upper(), seed, map_name, decoder, choice)
        said = {"condition": condition, "map": world.name, "policy": choice.name, "why": choice.reason}
        self._keep(self.part, said | {"listens": choice.listens} | of_online(recording, path))

    def _keep(self, part: str, result: dict[str, Any]) -> None:
        self.kept.done(part, result)
        self._tell()

    def _tell(self) -> None:
        self.part_done(*done_of(self.study, self.who, self.kept))

    def _decoder(self, part: str) -> Path:
        ending = "" if part == CALIBRATION else f"_{part.removeprefix('calibration ')}"
        name = f"{self.who.name}{ending}_decoder{model.SUFFIX}"
        return self.kept.path.parent / "decoders" / name


def _person(study: Study, who: Participant, config: Config) -> Path:
    """The person's file of a rehearsed participant, learnt from the recording where it isn't there yet."""
    recording = Path(who.recording or "")
    if recording.suffix == model.SUFFIX:
        return recording
    path = (study.home / "persons" / f"{who.name}_person{model.SUFFIX}").absolute()
    if not path.exists():
        found, person = fitting.read_calibration(recording, allow_damage=False)
        likeness, _ = likeness_of(found, config, lambda what, done, of: None)
        path.parent.mkdir(parents=True, exist_ok=True)
        rehearsal_file.save(likeness, path, person, checksum(recording))
    return path
