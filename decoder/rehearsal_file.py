"""A likeness in one file without pickle: safetensors with the numbers, JSON metadata with the rest."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from bci_app.errors import SetupError
from bci_app.sealed import Damaged, card_of, seal
from bci_app.whole import write_new
from decoder.rehearsal import Likeness

FORMAT_VERSION: Literal[2] = 2
_KEY = "bci-app rehearsal"
_ARRAYS = {"background": 2, "edges": 1, "courses": 2, "maps": 2, "errp_courses": 2, "errp_maps": 2}
Size = Annotated[float, Field(ge=0)]


class LikenessInfo(BaseModel):
    """All of a likeness that isn't an array; `recording_sha256` tells what it was learnt from."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    format_version: Literal[2] = FORMAT_VERSION
    names: tuple[str, ...]
    sfreq: Annotated[float, Field(gt=0)]
    spread: Size
    scale: Size
    participant: str
    recording_sha256: str


def save(likeness: Likeness, path: Path, participant: str, recording_sha256: str) -> None:
    """Write a new file. Raises SetupError when there is one already, or it can't be written."""
    if path.exists():
        raise SetupError(f"There is a rehearsal {path} already, and none is overwritten. Move it.")
    info = LikenessInfo(
        names=likeness.names,
        sfreq=likeness.sfreq,
        spread=likeness.spread,
        scale=likeness.scale,
        participant=participant,
        recording_sha256=recording_sha256,
    )
    arrays = {name: np.ascontiguousarray(getattr(likeness, name)) for name in _ARRAYS}
    try:
        contents = seal(lambda words: save_tensors(arrays, metadata=words), _KEY, info.model_dump_json())
        write_new(path, contents)
    except (OSError, SafetensorError) as error:
        raise SetupError(f"Can't write the rehearsal {path}: {error}. Is the disk full, or locked?") from error


def load(path: Path) -> Likeness:
    """Read a file. Raises SetupError for anything but a whole likeness of a known format."""
    try:
        contents = path.read_bytes()
        info = LikenessInfo.model_validate_json(card_of(contents, _KEY))
        tensors = load_tensors(contents)
        arrays = {name: tensors[name] for name in _ARRAYS}
    except OSError as error:
        raise SetupError(f"Can't read the rehearsal {path}: {error}. Make one with `bci-app rehearse`.") from error
    except (SafetensorError, ValidationError, Damaged, KeyError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise SetupError(
            f"{path} is no rehearsal of format {FORMAT_VERSION}, or is damaged ({reason}). Make one with `bci-app "
            "rehearse`."
        ) from error
    n_channels = len(info.names)
    fits = all(arrays[name].ndim == n for name, n in _ARRAYS.items()) and all(
        arrays[name].shape[1] == n_channels for name in ("background", "maps", "errp_maps")
    )
    edges = arrays["edges"]
    cut = len(edges) >= 2 and edges[-1] == len(arrays["background"]) and bool((np.diff(edges) > 0).all())
    if not (fits and cut):
        raise SetupError(f"{path} is damaged: its arrays don't fit its {n_channels} channels. Make it again.")
    return Likeness(**arrays, spread=info.spread, scale=info.scale, names=info.names, sfreq=info.sfreq)
