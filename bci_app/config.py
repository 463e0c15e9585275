"""Every default, once. A TOML file overrides any of them; an unknown key is refused.

Sources: "paper" is Wang et al., J. Neural Eng. 19 066023 (2022); "decided" marks what it leaves open.
"""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bci_app.errors import SetupError

Seconds = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
PRACTICE_MOVES = 6
"""Moves to practise on before a calibration, where nothing else is set: two of them errors (decided)."""


class Section(BaseModel):
    """A part of the configuration: immutable, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class StimulusConfig(Section):
    """One step on the screen (paper V.A.1) and the window it is drawn in."""

    countdown_s: Seconds = 1.0
    """Session seconds the countdown before a move takes (paper)."""
    arrow_s: Seconds = 1.0
    """Session seconds the arrow of a move is shown (paper)."""
    rest_s: Seconds = 1.0
    """Session seconds between a move and the next countdown, and to look at a new episode (paper)."""
    hold_s: Annotated[float, Field(gt=0)] = 5.0
    """Real seconds a missing action may hold the countdown before the session pauses (decided)."""
    window_px: Annotated[int, Field(ge=200)] = 880
    """Side of the window, in pixels (decided)."""
    fullscreen: bool = False
    """Fill the whole display instead."""
    display: Annotated[int, Field(ge=0)] = 0
    """Number of the display the window opens on."""
    headless: bool = False
    """Draw with SDL's dummy driver: no screen needed."""
    person: bool = True
    """Somebody sits before the window, reads and presses keys: else there are no pages, no practice and no breaks in an
    online run. A simulation has nobody."""
    texts: Annotated[str, Field(min_length=1)] = "en"
    """What the participant reads: a language that is shipped (en), or a folder of text files of your own."""
    font: str | None = None
    """A font file for texts in letters that the built-in one lacks (it has Latin, Greek and Cyrillic)."""
    instructions: bool = True
    """Show instructions before each part, where there is a window and a person to turn them by the space key."""
    photodiode: Literal["top-left", "top-right", "bottom-left", "bottom-right"] | None = None
    """Corner of the screen in which a square changes between black and white with each jump, for a photodiode."""
    photon_delay_ms: Annotated[float, Field(ge=0, le=500)] = 0.0
    """How long after a jump's flip its light comes, as `bci-app certify` measures: onsets are stamped so much later."""
    set_up: str | None = None
    """Path of the set-up file that `bci-app certify` wrote: `photon_delay_ms` is taken from there."""


class CalibrationConfig(Section):
    """The calibration run (paper V.A.1)."""

    map: str = "open"
    """The map it runs on: open, obstacles or a map file."""
    n_blocks: Count = 5
    """Blocks, at most (paper)."""
    moves_per_block: Count = 120
    """Moves of a block whose epochs are valid (paper)."""
    max_steps: Count = 60
    """Moves after which an episode ends without the goal (paper)."""
    error_probability: Annotated[float, Field(gt=0, lt=1)] = 0.3
    """Probability that the calibrating agent moves away from the goal (decided; the paper doesn't say)."""
    break_s: Seconds = 10.0
    """Shortest break between blocks."""
    worthwhile: Probability = 0.015
    """Gain in balanced accuracy expected of all remaining blocks together below which more calibration isn't worthwhile
    (decided: 20 simulated participants' decoders lose 0.02 points, and 59 % of the moves are saved, measured by
    `benchmarks/decoder_calibration_length.py`)."""
    stop_when_clear: bool = False
    """End after the block at which that is known, instead of after all."""
    wait_for_key: bool = True
    """After the break wait for the person's key, where there is a person; else the break alone ends it."""
    practice_moves: Annotated[int, Field(ge=0)] | None = None
    """Moves to practise on before the first block, which aren't recorded; by default 6, and none without a person."""
    eye_movements_s: Seconds = 0.0
    """Seconds of blinks and looks to the sides, up and down before the first block, for the ocular correction to be
    learnt from; 30 do. Without, it is learnt from what the eyes do anyway."""


class OnlineConfig(Section):
    """The online run (paper V.B.3): one pre-generated episode for each initial distance."""

    distances: tuple[int, int] = (2, 20)
    """Shortest and longest initial distance to the goal, in moves (paper)."""
    rounds: Count = 1
    """Episodes of each initial distance (paper: one)."""
    max_steps: Count = 60
    """Moves after which an episode ends without the goal (paper)."""
    break_every: Annotated[int, Field(ge=0)] = 5
    """Episodes between two breaks, which end by the person's key; 0 for none. None in a simulation (decided)."""
    practice_moves: Annotated[int, Field(ge=0)] = 0
    """Moves to practise on before the first episode, which aren't recorded."""
    episodes_seed: Annotated[int, Field(ge=0)] = 2022
    """Seed of the pre-generated episodes: the same episodes for every participant (decided)."""
    expected_moves: Count = 200
    """Moves of a run that the predicted accuracy is for (decided: 19 episodes of 10 or more)."""
    expected_errors: Annotated[float, Field(gt=0, lt=1)] = 0.3
    """Share of errors among them (decided: as in the calibration)."""


class EegConfig(Section):
    """Which EEG stream to use and what it must look like."""

    stream_type: str = "EEG"
    """LSL type of the amplifier's stream."""
    stream_name: str | None = None
    """Name of the amplifier's stream; needed only where several EEG streams are on the network."""
    source_id: str | None = None
    """Source id of the amplifier's stream, where its name isn't enough."""
    rate_tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Largest relative difference of the measured from the nominal rate (decided)."""
    max_uv: Annotated[float, Field(gt=0)] = 5_000_000.0
    """Samples beyond this many microvolts are not EEG but a wrong unit or a broken channel (decided)."""
    max_band_uv: Annotated[float, Field(gt=0)] = 500.0
    """A feature beyond this many microvolts, in the decoder's band and after repair, is an artefact: blinks and all,
    the real EEG we measured reaches 341 (decided)."""
    patience_s: Annotated[float, Field(ge=1)] = 600.0
    """Real seconds a session waits, paused, for an amplifier that is gone; then it ends (decided)."""
    buffer_s: Annotated[float, Field(ge=10)] = 60.0
    """Seconds of EEG the decoder keeps (decided: longer than anything it may have to wait for)."""


LAST_WINDOW_MS = 1500
"""A verdict must be there before the next move, 2 s after this one at the earliest (decided)."""


class ChainConfig(Section):
    """The decoder's linear chain (paper V.A.3-4)."""

    sfreq: Annotated[float, Field(gt=0)] = 256.0
    """Rate the EEG is brought to, Hz (paper)."""
    low_hz: Annotated[float, Field(ge=0.1)] = 1.0
    """Lower edge of the band, Hz (paper)."""
    high_hz: Annotated[float, Field(gt=0)] = 50.0
    """Upper edge of the band, Hz (paper)."""
    phase: Literal["minimum", "linear"] = "minimum"
    """FIR phase: minimum is ready at the end of the last window, linear waits for its delay (decided)."""
    start_ms: float = 150.0
    """Where the first window begins, ms after the onset (paper)."""
    window_ms: Annotated[float, Field(gt=0)] = 30.0
    """Length of a window, ms; its mean is a feature (paper)."""
    n_windows: Count = 15
    """Windows one after the other (paper)."""

    @model_validator(mode="after")
    def _band(self) -> Self:
        if not self.low_hz < self.high_hz < self.sfreq / 2:
            raise ValueError("low_hz must be below high_hz, and high_hz below half of sfreq")
        end_ms = self.start_ms + self.n_windows * self.window_ms
        if end_ms > LAST_WINDOW_MS:
            raise ValueError(
                f"the {self.n_windows} windows must end within {LAST_WINDOW_MS} ms of a move, for the policy waits for "
                f"them; found {end_ms:g} ms"
            )
        return self


class EyesConfig(Section):
    """Ocular correction, learnt from the calibration."""

    correct: Literal["auto", "always", "never"] = "auto"
    """`auto` corrects where there are electrodes and eye movements to learn it from, and says so where not."""
    learn_s: Annotated[float, Field(ge=30)] = 600.0
    """Seconds of EEG it is learnt from, at most: 100 blinks (decided)."""


class ClassifierConfig(Section):
    """The linear classifier and its evaluation (paper V.A.5)."""

    covariance: Literal["separable", "ledoit-wolf"] = "separable"
    """How LDA learns the noise: as a covariance of channels times one of windows (decided: more often right on every
    kind of simulated people, see `benchmarks/decoder_classifiers.py`), or as in the paper."""
    estimator: Annotated[str, Field(min_length=1)] | None = None
    """Instead of LDA: a scikit-learn classifier of one's own as "module:factory", linear, two classes. It is fitted
    without `prior_error`, so let it balance the classes itself."""
    prior_error: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """Class prior of `error`; set, not taken from the blocks' error rate (decided)."""
    n_folds: Annotated[int, Field(ge=2)] = 10
    """Folds of the cross-validation (paper)."""
    min_per_class: Annotated[int, Field(ge=2)] = 20
    """Fewest epochs of each class a decoder may be fitted on (decided)."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the shuffled folds and of bootstrap intervals."""


class PolicyConfig(Section):
    """The policy server and the gate."""

    choice: Literal["told", "accuracy"] = "told"
    """The policy that is told the decoder's statistics, or the paper's: the one trained at the nearest accuracy."""
    gate_accuracy: Probability = 0.55
    """Cross-validated balanced accuracy below which an online run goes without verdicts, for they no longer help.
    The paper sends participants home below 0.70 (plain accuracy)."""
    verdict_timeout_s: Annotated[float, Field(gt=0)] = 5.0
    """Real seconds without a verdict after which it is said to be missing (decided)."""


class SimulationConfig(Section):
    """The participant and amplifier without hardware."""

    sfreq: Annotated[float, Field(gt=0)] = 500.0
    """Rate of the simulated amplifier, Hz (the paper's)."""
    decodability: Annotated[float, Field(ge=0.5, lt=1)] = 0.75
    """Balanced accuracy that the decoder reaches on this participant in cross-validation."""
    errp: bool = True
    """False switches the error-related potential off: verdicts must then be at chance."""
    errp_at_edge: Probability = 1.0
    """Size of the ErrP of moves that lead to within two cells of the wall, relative to that of others (paper, Fig. 11:
    smaller at the edge, without a number)."""
    errp_habituation: Annotated[float, Field(ge=0, le=1 / 3)] = 0.0
    """Share of its size by which the ErrP shrinks with each of the second to the fourth error in a row (paper, Fig. 13:
    it shrinks over the first four, without a number)."""
    errp_online: Annotated[float, Field(ge=0, le=2)] = 1.0
    """Size of the ErrP in an online run, relative to that in a calibration (paper, Table I: online accuracies are a few
    points lower)."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Who the participant is."""
    run: int = 0
    """Which hour of that person's: other noise, other single trials. bci-app sets it to the run's seed."""
    delay_s: Annotated[float, Field(gt=0)] = 0.04
    """Real seconds from acquisition to emission, as an amplifier's own (decided; 10-50 ms are usual)."""
    chunk_s: Annotated[float, Field(gt=0)] = 0.01
    """Real seconds of samples a push (decided; 5-30 ms are advised)."""
    photodiode_ms: Annotated[float, Field(ge=0)] | None = None
    """Adds a channel PHOTO, whose light changes so many ms after each move's flip; none by default."""
    dead: tuple[str, ...] = ()
    """Channels whose electrodes are off: all they deliver is an input's noise."""
    drop_outs: tuple[tuple[Seconds, Seconds], ...] = ()
    """Beginnings and lengths, real seconds after the session's start, of times in which no sample is delivered."""
    disconnects: tuple[tuple[Seconds, Seconds], ...] = ()
    """The same, but the stream is gone from the network as well."""
    clock_jumps: tuple[tuple[Seconds, Seconds, float], ...] = ()
    """Beginnings and lengths, as above, of times in which stamps are off, and by how many seconds."""
    packet_loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of packets, of `chunk_s` each, that are lost on their way, in bursts of five in the mean."""
    background: str | None = None
    """Path of a recording (EDF, XDF, ...) whose EEG replaces the synthetic background."""
    rehearse: str | None = None
    """Path of a person that `bci-app rehearse` made; takes the place of the made-up one, decodability and all."""

    @model_validator(mode="after")
    def _one_person(self) -> Self:
        if self.background and self.rehearse:
            raise ValueError("background and rehearse exclude each other: a rehearsed person has a background")
        return self


class Config(Section):
    """The whole configuration; `load` reads it, `bci-app config` prints it."""

    recordings: str = "recordings"
    """Folder all recordings go to."""
    priority: Literal["auto", "high", "normal"] = "auto"
    """Whether the loop's processes go before all others of their computer, where the system lets them: `high` has them
    ask for it, `normal` doesn't, and `auto` is high at real speed and normal in simulations at other speeds, of which
    several may share the processors. A setting of no section: it stands above the first."""
    stimulus: StimulusConfig = StimulusConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    online: OnlineConfig = OnlineConfig()
    eeg: EegConfig = EegConfig()
    chain: ChainConfig = ChainConfig()
    eyes: EyesConfig = EyesConfig()
    classifier: ClassifierConfig = ClassifierConfig()
    policy: PolicyConfig = PolicyConfig()
    simulation: SimulationConfig = SimulationConfig()


def load(path: Path | None = None, overrides: dict[str, Any] | None = None) -> Config:
    """The defaults, overridden by a TOML (or JSON) file, overridden by ``{"section": {"key": value}}``.

    Raises SetupError for a file that can't be read or parsed, an unknown key or a value out of range.
    """
    values = _read(path) if path else {}
    if not isinstance(values, dict):
        raise SetupError(f"{path} should hold a table of settings, found {values!r:.60}.")
    return validated(_overridden(values, overrides or {}), str(path or "the command line"))


def changed(config: Config, overrides: dict[str, Any]) -> Config:
    """A configuration overridden by ``{"section": {"key": value}}``. Raises SetupError as `load` does."""
    return validated(_overridden(config.model_dump(mode="json"), overrides), "the program itself")


def _overridden(values: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    found = dict(values)
    for section, keys in overrides.items():
        both_tables = isinstance(keys, dict) and isinstance(values.get(section, {}), dict)
        found[section] = {**values.get(section, {}), **keys} if both_tables else keys
    return found


def validated(values: Any, where: str) -> Config:
    """A configuration from plain values. Raises SetupError for an unknown key or a value out of range."""
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise SetupError(f"Configuration from {where}: {_sentences(error)}") from error


def explained(config: Config) -> Iterator[tuple[str, str, str]]:
    """Each setting as (``section.key``, its value as in TOML or JSON, what it is)."""
    for name, field in Config.model_fields.items():
        value = getattr(config, name)
        if not isinstance(value, Section):
            yield name, json.dumps(value), field.description or ""
            continue
        values = value.model_dump(mode="json")
        for key, inner in type(value).model_fields.items():
            yield f"{name}.{key}", json.dumps(values[key]), " ".join((inner.description or "").split())


def _read(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8-sig")  # Windows editors put a byte-order mark in front
        parsed: dict[str, Any] = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"Can't read the configuration {path}: {error}.") from error
    except ValueError as error:
        raise SetupError(f"{path} is not valid {'JSON' if path.suffix == '.json' else 'TOML'}: {error}.") from error
    return parsed


def _sentences(error: ValidationError) -> str:
    parts = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            parts.append(f"unknown key '{key}'; known: {', '.join(_known_keys(item['loc'][:-1]))}")
        else:
            parts.append(f"'{key}': {item['msg']}, found {item['input']!r}")
    return "; ".join(parts) + "."


def _known_keys(section: tuple[int | str, ...]) -> list[str]:
    model: Any = Config
    for name in section:
        model = model.model_fields[str(name)].annotation
    return list(model.model_fields)
