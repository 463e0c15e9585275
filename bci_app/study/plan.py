"""The study file: who takes part, under which conditions, on which maps. A misspelt key, a participant twice and a
missing recording are refused before anything starts."""

import json
import tomllib
from collections import Counter
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args
from zlib import crc32

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator

from bci_app.config import Config, Probability, Section, changed, validated
from bci_app.errors import SetupError
from bci_app.report import published
from bci_app.runs import checksum
from bci_app.study import mistakes

Condition = Literal["none", "paper", "ours", "coin", "mute"]
CONDITIONS: tuple[Condition, ...] = get_args(Condition)
Through = Literal["processes", "one-process"]
WAYS: tuple[Through, ...] = get_args(Through)
SAID: dict[Condition, str] = {
    "none": "no ErrP: the policy without verdicts",
    "paper": "the paper's rule: its classifier, words only, the policy trained at the nearest accuracy, its gate",
    "ours": "ours: scores, the policy that is told the decoder's statistics",
    "coin": "control: as ours, but the verdicts have nothing to do with the moves",
    "mute": "control: as ours, of a participant without an ErrP",
}
SIMULATED_ONLY: tuple[Condition, ...] = ("mute",)
"""Conditions that can't be asked of people."""
SHIPPED = ("wang2022", "lab")
PAPERS_GATE = 0.70
"""Cross-validated accuracy below which the paper sends participants home (V.A.5)."""
OF_THE_LAB = (
    "priority",
    "eeg.stream_name",
    "eeg.source_id",
    "stimulus.display",
    "stimulus.set_up",
    "stimulus.photon_delay_ms",
)
"""Settings that tell of a lab's equipment: it may change within a study."""
FORMAT = 3
"""Of what is kept of participants. What another format keeps isn't taken for this one's."""
Label = Annotated[str, Field(pattern=r"^[A-Za-z0-9]+$")]


class Participant(Section):
    """Somebody who takes part: simulated, rehearsed from a recording, or real."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    name: Label
    """Letters and digits; names the files."""
    kind: Literal["simulated", "rehearsed", "real"] = "simulated"
    """Who sits there."""
    recording: str | None = None
    """Of a rehearsed participant: the calibration (.xdf) the person is learnt from, or the person's file that
    `bci-app rehearse` wrote. A relative path is one from the study file's folder."""
    published: str | None = None
    """Participant of the paper beside whom this one is shown: S2 ..."""
    decodability: Annotated[float, Field(ge=0.5, lt=1)] | None = None
    """Of a simulated participant, as `simulation.decodability`."""
    seed: Annotated[int, Field(ge=0)] | None = None
    """Of a simulated or rehearsed participant, as `simulation.seed`."""
    errp_at_edge: Probability | None = None
    """As `simulation.errp_at_edge`."""
    errp_habituation: Annotated[float, Field(ge=0, le=1 / 3)] | None = None
    """As `simulation.errp_habituation`."""
    errp_online: Annotated[float, Field(ge=0, le=2)] | None = None
    """As `simulation.errp_online`."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.kind == "rehearsed" and self.recording is None:
            raise ValueError(
                "'recording' is missing: a rehearsed participant is learnt from one. Name a calibration (.xdf), or the "
                "person's file that `bci-app rehearse` wrote"
            )
        if self.kind != "rehearsed" and self.recording is not None:
            raise ValueError(
                f"'recording' belongs to a rehearsed participant, and this one is {self.kind}. Set kind = 'rehearsed' "
                "or leave it out"
            )
        if self.kind != "simulated" and self.decodability is not None:
            raise ValueError(
                f"only a simulated participant has a 'decodability', and this one is {self.kind}. Leave it out"
            )
        if self.published is not None and self.published not in published.PEOPLE:
            raise ValueError(f"'published' must be one of {', '.join(published.PEOPLE)}, found {self.published!r}")
        return self

    @property
    def is_real(self) -> bool:
        """Whether a person takes part, with the lab's amplifier, at speed 1."""
        return self.kind == "real"


class Study(Section):
    """A study file."""

    name: Label
    """Letters and digits."""
    folder: str | None = None
    """Where everything of the study goes; by default `studies/NAME`."""
    seed: Annotated[int, Field(ge=0)] = 1
    """What all runs' seeds follow from."""
    through: Through = "processes"
    """Simulated participants go through the real processes over LSL, or through the same functions in one process."""
    speed: Annotated[float, Field(ge=0.1, le=100)] = 24.0
    """Session seconds a real second of simulated participants; real ones run at 1."""
    side_by_side: Annotated[int, Field(ge=0)] = 0
    """Simulated participants at a time; 0 for as many as the cores allow."""
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] = ("none", "paper", "ours")
    """What is compared, each participant with each; the first is the one the others are compared with."""
    in_one_process: tuple[Literal["mute"], ...] = ()
    """Conditions that always go through one process: a control with a calibration of its own tells nothing of LSL."""
    maps: Annotated[tuple[str, ...], Field(min_length=1)] = ("open", "obstacles")
    """Maps, shipped or files, on each of which every condition has its episodes."""
    papers_gate: Probability = PAPERS_GATE
    """Cross-validated accuracy below which condition `paper` goes without verdicts."""
    config: dict[str, Any] = Field(default={})
    """Settings of all runs, as in a --config file."""
    participants: Annotated[tuple[Participant, ...], Field(min_length=1)]
    """Who takes part."""

    @field_validator("conditions", "maps")
    @classmethod
    def _each_once(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        doubled = [value for value, count in Counter(values).items() if count > 1]
        if doubled:
            raise ValueError(f"{', '.join(doubled)} is there twice")
        return values

    @model_validator(mode="after")
    def _fits(self) -> Self:
        # Names differ in more than case, for some disks take P01 and p01 for one file.
        alike: dict[str, list[str]] = {}
        for each in self.participants:
            alike.setdefault(each.name.lower(), []).append(each.name)
        for names in alike.values():
            if len(set(names)) > 1:
                raise ValueError(
                    f"participants {' and '.join(dict.fromkeys(names))} differ only in upper and lower case, which "
                    "some disks take for the same. Rename one"
                )
            if len(names) > 1:
                raise ValueError(f"participant {names[0]} is there twice. Rename one")
        stems = Counter(Path(name).stem for name in self.maps)
        if max(stems.values()) > 1:
            raise ValueError(f"maps need names of their own: {stems.most_common(1)[0][0]} is there twice")
        if self.conditions[0] != "none" and len(self.conditions) > 1:
            raise ValueError(
                f"conditions must begin with none, which the others are compared with; found {self.conditions[0]}"
            )
        if any(each.is_real for each in self.participants) and set(self.conditions) & set(SIMULATED_ONLY):
            raise ValueError(f"people can't be had without an ErrP: leave out condition {', '.join(SIMULATED_ONLY)}")
        return self

    @property
    def home(self) -> Path:
        """The study's folder."""
        return Path(self.folder or f"studies/{self.name}")

    @property
    def parts(self) -> tuple[tuple[Condition, str], ...]:
        """Online runs of a participant: condition and map, in order."""
        return tuple((condition, name) for condition in self.conditions for name in self.maps)

    def digest(self, who: Participant) -> str:
        """Of all that a participant's parts depend on: what is kept of another study isn't taken for this one's.

        Which amplifier and display the lab uses from now on isn't among it, and a recording counts by its content.
        """
        config = {
            section: {key: value for key, value in values.items() if f"{section}.{key}" not in OF_THE_LAB}
            if isinstance(values, dict)
            else values
            for section, values in self.config.items()
        }
        config = {key: value for key, value in config.items() if value != {} and key not in OF_THE_LAB}
        common = {"format": FORMAT, "seed": self.seed, "papers_gate": self.papers_gate, "config": config}
        person = who.model_dump(mode="json", exclude={"published", "recording"})
        recording = checksum(Path(who.recording)) if who.recording else None
        words = json.dumps([common, person, recording], sort_keys=True, default=str)
        return sha256(words.encode()).hexdigest()[:16]

    def schedule(self, who: Participant) -> tuple[tuple[Condition, str], ...]:
        """The online runs of a participant in the order in which they are made: conditions rotate from participant to
        participant, and every other begins with the other map, so that neither always comes first."""
        place = [each.name for each in self.participants].index(who.name)
        turn = place % len(self.conditions)
        maps = self.maps if place // len(self.conditions) % 2 == 0 else tuple(reversed(self.maps))
        turned = self.conditions[turn:] + self.conditions[:turn]
        return tuple((condition, name) for condition in turned for name in maps)

    def participant(self, name: str) -> Participant:
        """Of that name. Raises SetupError where there is none."""
        for each in self.participants:
            if each.name == name:
                return each
        names = ", ".join(each.name for each in self.participants)
        raise SetupError(f"No participant {name} in study {self.name}; it has {names}.")

    def run_seed(self, participant: str, part: str) -> int:
        """Of one run: another for each, the same whenever it is made."""
        return crc32(f"{self.seed} {participant} {part}".encode()) >> 1

    def settings(self, who: Participant) -> Config:
        """The configuration of a participant's runs. Raises SetupError as `bci_app.config.load` does."""
        config = validated(self.config, f"[config] of study {self.name}")
        names = ("decodability", "seed", "errp_at_edge", "errp_habituation", "errp_online")
        given = {name: getattr(who, name) for name in names if getattr(who, name) is not None}
        if not who.is_real:
            given.setdefault("seed", crc32(who.name.encode()) % 100_000)
        values: dict[str, Any] = {"recordings": str(self.home / "recordings"), "simulation": given}
        if not who.is_real:  # several share the processors
            values |= {"stimulus": {"headless": True}, "priority": "normal"}
        return changed(config, values)


def load(name: str) -> Study:
    """A study file (.toml), or a shipped study by its name.

    Raises SetupError for a file that can't be read, an unknown key, a participant twice, a recording that is missing.
    """
    path = Path(name)
    if not path.exists() and name in SHIPPED:
        text, folder = files("bci_app.study").joinpath("studies", f"{name}.toml").read_text("utf-8"), Path()
    else:
        try:
            text, folder = path.read_text(encoding="utf-8"), path.parent
        except (OSError, UnicodeDecodeError) as error:
            raise SetupError(
                f"Can't read the study '{name}' ({error}). Name a study file, or one that is shipped: "
                f"{', '.join(SHIPPED)}."
            ) from error
    try:
        study = parse(tomllib.loads(text), name)
    except tomllib.TOMLDecodeError as error:
        raise SetupError(f"The study '{name}' is not a TOML file: {error}.") from error
    return _with_paths(study, folder)


def parse(values: dict[str, Any], where: str) -> Study:
    """A study from plain values. Raises SetupError for an unknown key or what can't be."""
    try:
        study = Study.model_validate(values)
    except ValidationError as error:
        said = mistakes.sentences(error, values, list(Study.model_fields), list(Participant.model_fields))
        raise SetupError(f"Study '{where}': {said}. See docs/study.md for what a study file holds.") from error
    for who in study.participants:
        study.settings(who)
    return study


def _with_paths(study: Study, folder: Path) -> Study:
    """Recordings by their whole paths. Raises SetupError for one that isn't there."""
    found = []
    for who in study.participants:
        if who.recording is not None:
            path = (folder / who.recording).absolute()
            if not path.is_file():
                raise SetupError(f"Participant {who.name} is to be rehearsed from {path}, and there is no such file.")
            who = who.model_copy(update={"recording": str(path)})
        found.append(who)
    return study.model_copy(update={"participants": tuple(found)})
