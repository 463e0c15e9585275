"""What acts across channels, as one matrix: `features(epoch, operator, spatial)` applies it after the time operator.

    spatial = common average @ ocular correction @ repair of bad channels @ choice of the stream's channels

Read from the right. Bad channels are repaired first, for every later step draws on all channels: one bad electrode
would leak into the ocular sources, and through the average into everything. The average comes last, so that what is
left adds up to nothing over the channels whatever went before. The matrix stays the same for a whole block.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError
from decoder.montage import canonical, template

Array = NDArray[np.float64]

MAX_BAD_SHARE = 0.25
"""Share of channels that may be bad (decided). On a 64-channel recording of eegmmidb (1-50 Hz, common average) a
repaired channel correlates with what was measured there 0.96 in the median and 0.84 in the worst twentieth while 4 are
bad, 0.95 and 0.75 with 16, 0.88 and 0.66 with 48. A repaired channel tells nothing that the others don't: beyond a
quarter the decoder would work on much less than it was calibrated on, and lost electrodes are mostly neighbours."""
MIN_GOOD = 4
"""Fewest good channels of known place to repair others from: four points fix the sphere that the splines lie on."""
_DECIMALS = 12  # of repairing weights: the solver's last bits differ between machines, a replay's features must not


def common_average(n_channels: int) -> Array:
    """Subtract the mean over channels: (n_channels, n_channels)."""
    matrix: Array = np.eye(n_channels) - 1 / n_channels
    return matrix


def ocular(weights: Array, sources: Array) -> Array:
    """Take ocular sources out of every channel: (n_channels, n_channels), the identity less ``weights @ sources``.

    Parameters
    ----------
    weights : (n_channels, n_sources), uV for 1 of a source, how strongly each source is seen in each channel.
    sources : (n_sources, n_channels), how the sources are made of the channels.
    """
    matrix: Array = np.eye(len(weights)) - weights @ sources
    return matrix


def interpolation(channels: Sequence[str], bad: Sequence[str]) -> Array:
    """Replace bad channels by spherical splines through the good ones, as MNE does (doi:10.1016/0013-4694(89)90180-6).

    Parameters
    ----------
    channels : names, any spelling that `decoder.montage.canonical` understands.
    bad : those to replace. Good channels of unknown place stay as they are and repair nothing.

    Returns
    -------
    float64, (n_channels, n_channels). Columns of bad channels are zero: what they deliver is not looked at.

    Raises SetupError where a bad channel has no known place, or where too few good ones are left.
    """
    is_bad = _is_bad(channels, bad)
    if not is_bad.any():
        return np.eye(len(channels))
    places = _places()
    known = np.array([_is_placed(name) for name in channels])
    _check(channels, is_bad, known)
    matrix = np.eye(len(channels))
    names = [places[canonical(channels[index])] for index in np.flatnonzero(known).tolist()]
    matrix[np.ix_(known, known)] = _through_mne(names, is_bad[known])
    return matrix


def compose(
    n_stream: int,
    order: Sequence[int] | NDArray[np.int64],
    *,
    repair: Array | None = None,
    eyes: Array | None = None,
    outputs: Sequence[int] | NDArray[np.int64] | None = None,
) -> Array:
    """Everything across channels as one matrix, in the order told at the top of this module.

    Parameters
    ----------
    n_stream : channels in an epoch.
    order : (n_channels,), the decoder's channels as indices into the stream's.
    repair : (n_channels, n_channels), from `interpolation`; None where all are good.
    eyes : (n_channels, n_channels), from `ocular`; None to leave the eyes in.
    outputs : the channels, as indices into `order`, that are averaged and become features, all by default; EOG channels
        are to be left out, which correct others but are no EEG.

    Returns
    -------
    float64, (n_outputs, n_stream), C-contiguous.
    """
    identity = np.eye(len(order))
    cleaned = (identity if eyes is None else eyes) @ (identity if repair is None else repair)
    kept = cleaned if outputs is None else cleaned[np.asarray(outputs)]
    matrix = np.zeros((len(kept), n_stream))
    matrix[:, np.asarray(order)] = common_average(len(kept)) @ kept
    return matrix


def repair(channels: Sequence[str], outputs: NDArray[np.int64], bad: Collection[str]) -> Array:
    """(n_channels, n_channels): bad EEG channels, those of `outputs`, from the good ones.

    Of a bad channel that has no neighbours, because it is EOG, its place is not known or too few good ones are left,
    nothing is taken: it is 0. Names in `bad` that aren't among the channels are left alone. Raises SetupError where too
    many EEG channels are bad.
    """
    wrong = {canonical(name) for name in bad}
    matrix = np.diag([float(canonical(name) not in wrong) for name in channels])
    eeg = [channels[index] for index in outputs.tolist()]
    _check_share(eeg, [name for name in eeg if canonical(name) in wrong])
    placed = np.array([index for index in outputs.tolist() if _is_placed(channels[index])], dtype=np.int64)
    names = [channels[index] for index in placed.tolist()]
    lost = [name for name in names if canonical(name) in wrong]
    if lost and len(names) - len(lost) >= MIN_GOOD:
        matrix[np.ix_(placed, placed)] = interpolation(names, lost)
    return matrix


@dataclass(frozen=True, eq=False)
class Montage:
    """A decoder's channels on one stream, and all that acts across them but the repair of bad ones.

    Attributes
    ----------
    n_stream : channels in an epoch.
    channels : names, in the decoder's order.
    order : int64, (n_channels,), the same as indices into the stream's.
    outputs : int64, (n_outputs,), those that become features, as indices into `channels`: all but EOG.
    eyes : (n_channels, n_channels), from `ocular`, or None.
    """

    n_stream: int
    channels: tuple[str, ...]
    order: NDArray[np.int64]
    outputs: NDArray[np.int64]
    eyes: Array | None = None

    def matrix(self, bad: Collection[str] = ()) -> Array:
        """The spatial matrix while these channels are bad: float64, (n_outputs, n_stream). Raises as `repair`."""
        mended = repair(self.channels, self.outputs, bad)
        return compose(self.n_stream, self.order, repair=mended, eyes=self.eyes, outputs=self.outputs)


def _is_bad(channels: Sequence[str], bad: Sequence[str]) -> NDArray[np.bool_]:
    wanted = {canonical(name) for name in bad}
    strange = [name for name in bad if canonical(name) not in {canonical(channel) for channel in channels}]
    if strange:
        raise SetupError(
            f"Bad channels {', '.join(strange)} are not among the {len(channels)} channels ({', '.join(channels)}). "
            "Correct their names."
        )
    return np.array([canonical(name) in wanted for name in channels], dtype=bool)


def _check(channels: Sequence[str], is_bad: NDArray[np.bool_], known: NDArray[np.bool_]) -> None:
    bad = [channels[index] for index in np.flatnonzero(is_bad).tolist()]
    nowhere = [channels[index] for index in np.flatnonzero(is_bad & ~known).tolist()]
    if nowhere:
        raise SetupError(
            f"Bad channels {', '.join(nowhere)} have no place in the 10-05 system, so they can't be repaired from "
            "their neighbours. Give them 10-05 names in the amplifier, or reconnect them."
        )
    _check_share(channels, bad)
    if (n_good := int((~is_bad & known).sum())) < MIN_GOOD:
        raise SetupError(
            f"To repair {', '.join(bad)} takes {MIN_GOOD} good channels with 10-05 names; there are {n_good}. "
            "Reconnect the bad ones."
        )


def _check_share(channels: Sequence[str], bad: Sequence[str]) -> None:
    if len(bad) > MAX_BAD_SHARE * len(channels):
        raise SetupError(
            f"{len(bad)} of {len(channels)} channels are bad ({', '.join(bad)}); up to {MAX_BAD_SHARE:.0%} can be "
            "repaired. Reconnect electrodes."
        )


def _is_placed(name: str) -> bool:
    return canonical(name) in _places()


@lru_cache(maxsize=1)
def _places() -> dict[str, str]:
    """Names of the electrodes whose place is known, as MNE's template spells them."""
    return {canonical(name): name for name in template().ch_names}


def _through_mne(names: list[str], is_bad: NDArray[np.bool_]) -> Array:
    """The identity through MNE's own `interpolate_bads`; `names` as MNE's template spells them."""
    import mne  # slow to import, and most blocks have no bad channel

    raw = mne.io.RawArray(np.eye(len(names)), mne.create_info(names, 1.0, "eeg"), verbose="error")
    raw.set_montage(template(), verbose="error")
    raw.info["bads"] = [name for name, wrong in zip(names, is_bad, strict=True) if wrong]
    raw.interpolate_bads(verbose="error")
    matrix: Array = np.round(raw.get_data(), _DECIMALS)
    return matrix
