"""The set-up file: what `bci-app certify` measured of a screen and an amplifier, for the sessions on them to use.

A session reads it where `stimulus.set_up` names it, and refuses it on another set-up.
"""

import json
import platform
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.whole import write_new


class SetUp(BaseModel):
    """What was measured, and on what."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    computer: str
    """Its name on the network."""
    display: int
    fullscreen: bool
    window_px: int
    photodiode: str
    """Corner of the patch."""
    stream: str | None
    """Name of the EEG stream; None for a simulated one."""
    channel: str
    """The photodiode's."""
    n: int
    """Moves measured."""
    photon_delay_ms: Annotated[float, Field(ge=0, le=500)]
    """Mean time from flip to light."""
    sd_ms: Annotated[float, Field(ge=0)]
    """Its standard deviation."""


def describe(config: Config, stream: str | None, channel: str, n: int, delay_ms: float, sd_ms: float) -> SetUp:
    """The set-up of this computer and configuration."""
    stimulus = config.stimulus
    return SetUp(
        computer=platform.node(),
        display=stimulus.display,
        fullscreen=stimulus.fullscreen,
        window_px=stimulus.window_px,
        photodiode=stimulus.photodiode or "",
        stream=stream,
        channel=channel,
        n=n,
        photon_delay_ms=round(delay_ms, 3),
        sd_ms=round(sd_ms, 3),
    )


def write(set_up: SetUp, path: Path) -> None:
    """Write the file. Nothing is written over: SetupError where it is there already."""
    try:
        write_new(path, f"{set_up.model_dump_json(indent=2)}\n".encode())
    except OSError as error:
        raise SetupError(f"Can't write the set-up file {path}: {error.strerror}. Choose another with --out.") from error


def applied(config: Config) -> Config:
    """The configuration with what its set-up file says; unchanged where it names none.

    Raises SetupError for a file that can't be read or is of another set-up, and for a delay given twice.
    """
    if config.stimulus.set_up is None:
        return config
    path = Path(config.stimulus.set_up)
    set_up = _read(path)
    now = describe(config, None, set_up.channel, set_up.n, set_up.photon_delay_ms, set_up.sd_ms)
    for key in ("computer", "display", "fullscreen", "window_px"):
        measured, found = getattr(set_up, key), getattr(now, key)
        if measured != found and not (key == "window_px" and set_up.fullscreen):
            raise SetupError(
                f"The set-up file {path} was measured with {key} = {measured}, and now it is {found}: light comes at "
                "another time there. Run `bci-app certify` again, or leave out stimulus.set_up."
            )
    if config.eeg.stream_name is not None:
        check_stream(config, config.eeg.stream_name)
    given = config.stimulus.photon_delay_ms
    if given not in (0.0, set_up.photon_delay_ms):
        raise SetupError(
            f"stimulus.photon_delay_ms is {given:g} and the set-up file {path} says {set_up.photon_delay_ms:g}. "
            "Leave out one of them."
        )
    stimulus = config.stimulus.model_copy(update={"photon_delay_ms": set_up.photon_delay_ms})
    return config.model_copy(update={"stimulus": stimulus})


def check_stream(config: Config, stream: str) -> None:
    """Raise SetupError where the configuration names a set-up file that was measured with another EEG stream."""
    if config.stimulus.set_up is None:
        return
    path = Path(config.stimulus.set_up)
    measured = _read(path).stream
    if measured != stream:
        theirs = f"the EEG stream '{measured}'" if measured else "a simulated amplifier"
        raise SetupError(
            f"The set-up file {path} was measured with {theirs}, not with '{stream}': another amplifier is late by "
            "another time. Run `bci-app certify` again, or leave out stimulus.set_up."
        )


def _read(path: Path) -> SetUp:
    try:
        return SetUp.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"Can't read the set-up file {path}: {error}. `bci-app certify` writes one.") from error
    except (ValueError, ValidationError) as error:
        raise SetupError(f"{path} is no set-up file: {error}. `bci-app certify` writes one.") from error
