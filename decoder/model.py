"""A decoder in one file without pickle: safetensors with the numbers, JSON metadata with everything else."""

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.errors import SetupError
from bci_app.sealed import Damaged, card_of, seal
from bci_app.whole import write_new
from decoder.calibration import Calibration, Scores
from decoder.chain import Chain
from decoder.classifier import LinearClassifier
from decoder.evidence import Evidence, calibrate_evidence
from decoder.eyes import Eyes, eeg_outputs
from decoder.montage import match_channels
from decoder.operator import chain_operator

Array = NDArray[np.float64]

FORMAT_VERSION: Literal[4] = 4
SUFFIX = ".safetensors"
_KEY = "bci-app decoder"
_RECORDING = b"XDF:"
"""How a recording begins."""
_LIBRARIES = ("numpy", "scipy", "scikit-learn", "mne", "errp-bci")


class ModelInfo(BaseModel):
    """All of a decoder that isn't a large array; the metadata of its file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    format: Literal[4] = FORMAT_VERSION
    participant: str
    channels: tuple[str, ...]
    """All that it takes from a stream, EOG channels too."""
    n_sources: int = Field(ge=0)
    """Ocular sources that are regressed out; 0 where the eyes are left in."""
    eyes: str
    """On the ocular correction, in words."""
    ocular: dict[str, Any] | None
    """`decoder.calibration.Scores` of contiguous folds on the ocular sources alone: what the eyes would tell."""
    sfreq: float = Field(gt=0)
    """Rate of the raw EEG, Hz."""
    unit: Literal["uV"] = "uV"
    n_before: int = Field(ge=0)
    n_after: int = Field(ge=1)
    chain: ChainConfig
    classifier: ClassifierConfig
    n_error: int
    n_correct: int
    n_rejected: int
    tenfold: dict[str, Any]
    """`decoder.calibration.Scores` of stratified cross-validation; `blocked` of contiguous folds."""
    blocked: dict[str, Any]
    evidence: Evidence
    """From the log odds of contiguous folds, as `blocked`."""
    recording_sha256: str
    """Of the calibration it was fitted on, or empty."""
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class DecoderModel:
    """A decoder ready to use.

    Attributes
    ----------
    info : what it was made from, and how good it is.
    operator : float64, (n_raw, n_windows).
    classifier : weights and bias on the features of `decoder.operator.features`.
    eyes : what is regressed out before, or None.
    held_out_log_odds : float64, (n_epochs,), from contiguous folds, in the order of the calibration.
    held_out_error : bool, (n_epochs,), the truth about them.
    """

    info: ModelInfo
    operator: Array
    classifier: LinearClassifier
    eyes: Eyes | None
    held_out_log_odds: Array
    held_out_error: NDArray[np.bool_]


def make_model(
    calibration: Calibration,
    error: NDArray[np.bool_],
    chain: Chain,
    classifier: ClassifierConfig,
    *,
    participant: str,
    channels: Sequence[str],
    n_rejected: int,
    eyes: Eyes | None = None,
    on_eyes: str = "",
    ocular: Scores | None = None,
    recording_sha256: str = "",
) -> DecoderModel:
    """Put a model together from a calibration and the chain its features came from.

    ``eyes`` were regressed out of them, ``on_eyes`` says why or why not, and ``ocular`` is what they tell alone.
    """
    info = ModelInfo(
        participant=participant,
        channels=tuple(channels),
        n_sources=len(eyes.sources) if eyes else 0,
        eyes=on_eyes,
        ocular=ocular.as_dict() if ocular else None,
        sfreq=chain.sfreq,
        n_before=chain.n_before,
        n_after=chain.n_after,
        chain=chain.config,
        classifier=classifier,
        n_error=calibration.tenfold.n_error,
        n_correct=calibration.tenfold.n_correct,
        n_rejected=n_rejected,
        tenfold=calibration.tenfold.as_dict(),
        blocked=calibration.blocked.as_dict(),
        evidence=calibrate_evidence(calibration.blocked_log_odds, error),
        recording_sha256=recording_sha256,
        versions={"python": platform.python_version(), **{name: _version(name) for name in _LIBRARIES}},
    )
    return DecoderModel(info, chain_operator(chain), calibration.classifier, eyes, calibration.blocked_log_odds, error)


def save(model: DecoderModel, path: Path) -> None:
    """Write a new file. Raises SetupError when there is one already: a decoder is never overwritten."""
    tensors = {
        "operator": model.operator,
        "weights": model.classifier.weights,
        "bias": np.array([model.classifier.bias]),
        "held_out_log_odds": model.held_out_log_odds,
        "held_out_error": model.held_out_error,
    }
    if model.eyes:
        tensors |= {"ocular_sources": model.eyes.sources, "ocular_weights": model.eyes.weights}
    contents = seal(lambda words: save_tensors(tensors, metadata=words), _KEY, model.info.model_dump_json())
    try:
        write_new(path, contents)
    except FileExistsError as error:
        raise SetupError(
            f"There is a decoder {path} already, and decoders are never overwritten. Choose another name or move it."
        ) from error
    except OSError as error:
        raise SetupError(f"Can't write the decoder {path}: {error.strerror}. Free or unlock the disk.") from error


def load(path: Path) -> DecoderModel:
    """Read a model file. Raises SetupError for anything but a whole decoder of a known format."""
    try:
        contents = path.read_bytes()
    except OSError as error:
        raise SetupError(f"Can't read the decoder {path}: {error}. Calibrate first, or give another path.") from error
    if contents.startswith(_RECORDING):
        raise SetupError(
            f"{path} is a recording, not a decoder. `bci-app fit` of a calibration writes one beside it "
            f"(..._decoder{SUFFIX}): name that."
        )
    try:
        # A damaged file is told from one of an older format, which has no checksum.
        info = ModelInfo.model_validate_json(_metadata(contents))
        card_of(contents, _KEY)
        return _assemble(info, load_tensors(contents))
    except (SafetensorError, ValidationError, Damaged, KeyError, TypeError, ValueError, RecursionError) as error:
        older = _older_format(error)
        if older is not None:
            raise SetupError(
                f"{path} is a decoder of format {older}, which doesn't tell all that is needed; this bci-app reads "
                f"format {FORMAT_VERSION}. Run `bci-app fit` on the calibration again."
            ) from error
        reason = _first_line(error)
        raise SetupError(
            f"{path} is no decoder of format {FORMAT_VERSION}, or is damaged ({reason}). Use the bci-app version that "
            "wrote it, or recalibrate."
        ) from error


def fit_stream(model: DecoderModel, name: str, channels: Sequence[str], sfreq: float) -> NDArray[np.int64]:
    """Where the decoder's channels are in a stream: indices into its channels, in the decoder's order.

    A stream with more, differently ordered or differently spelt channels fits. Raises SetupError for one that lacks a
    channel or has another rate.
    """
    info = model.info
    if sfreq != info.sfreq:
        raise SetupError(
            f"Stream '{name}' runs at {sfreq:g} Hz; the decoder of {info.participant} was calibrated at "
            f"{info.sfreq:g} Hz. Set the amplifier to {info.sfreq:g} Hz or recalibrate."
        )
    indices, missing = match_channels(info.channels, channels)
    if missing:
        raise SetupError(
            f"Stream '{name}' has {len(channels)} channels; the decoder of {info.participant} was calibrated on "
            f"{len(info.channels)} (missing: {', '.join(missing)}). Fix the montage or recalibrate."
        )
    return np.array(indices, dtype=np.int64)


def _assemble(info: ModelInfo, tensors: dict[str, NDArray[Any]]) -> DecoderModel:
    n_windows, n_epochs = info.chain.n_windows, info.n_error + info.n_correct
    operator = _checked(tensors, "operator", "float64", (info.n_before + info.n_after, n_windows))
    n_channels = len(info.channels)
    weights = _checked(tensors, "weights", "float64", (len(eeg_outputs(info.channels)) * n_windows,))
    bias = _checked(tensors, "bias", "float64", (1,))
    log_odds = _checked(tensors, "held_out_log_odds", "float64", (n_epochs,))
    error = _checked(tensors, "held_out_error", "bool", (n_epochs,))
    eyes = None
    if info.n_sources:
        sources = _checked(tensors, "ocular_sources", "float64", (info.n_sources, n_channels))
        eyes = Eyes(sources, _checked(tensors, "ocular_weights", "float64", (n_channels, info.n_sources)))
    return DecoderModel(info, operator, LinearClassifier(weights, float(bias[0])), eyes, log_odds, error)


def _checked(tensors: dict[str, NDArray[Any]], name: str, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    tensor = tensors[name]
    if tensor.dtype != dtype or tensor.shape != shape or not np.isfinite(tensor).all():
        raise ValueError(f"'{name}' should be finite {dtype} of shape {shape}, is {tensor.dtype} of {tensor.shape}")
    return np.array(tensor, order="C", copy=True)  # aligned as NumPy does it: the same bits for the same samples


def _metadata(contents: bytes) -> str:
    """The JSON text in a safetensors header: 8 bytes of length, then the header."""
    header = json.loads(contents[8 : 8 + int.from_bytes(contents[:8], "little")])
    return str(header["__metadata__"][_KEY])


def _version(name: str) -> str:
    try:
        return version(name)
    except ImportError:
        return "unknown"


def _older_format(error: Exception) -> int | None:
    """The format of a file that an older version wrote."""
    if not isinstance(error, ValidationError):
        return None
    for each in error.errors(include_url=False):
        if each["loc"] == ("format",) and each["input"] in range(1, FORMAT_VERSION):
            return int(each["input"])
    return None


def _first_line(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    return f"{type(error).__name__}: {error}".splitlines()[0]
