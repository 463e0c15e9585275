"""How large a rehearsed ErrP must be for the decoder to reach the accuracy it had on the person."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ClassifierConfig
from bci_app.errors import SetupError
from decoder.calibration import contiguous_folds, held_out_log_odds, score
from decoder.epochs import Epoch, Rejection, Shape
from decoder.rehearsal import Likeness, Rehearsed

Array = NDArray[np.float64]
Features = Callable[[int, Epoch], Array | Rejection]
"""From a move's number and its epoch to its features."""

SCALES = (0.0, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
"""Sizes tried, in the estimated one (decided)."""
N_DRAWS = 3
"""Rehearsals tried: one of 600 moves has a standard error of two points (decided)."""
FIRST_RUN = 2**31
"""Number of the first rehearsal tried: no run has it, so none is one that the size was found on."""
LEAD_S = 8.0
"""Seconds of EEG before the first move, as in a run."""


@dataclass(frozen=True, eq=False)
class Watch:
    """What a rehearsal is tried on.

    Attributes
    ----------
    onsets, error : of the moves, (n_moves,), s, and the truth.
    shape : of the decoder's epochs.
    features : the decoder's.
    """

    onsets: Sequence[float]
    error: NDArray[np.bool_]
    shape: Shape
    features: Features


def watched(likeness: Likeness, watch: Watch, seed: int, run: int) -> tuple[Array, NDArray[np.bool_]]:
    """Features, (n_valid, n_features), and truth of the moves as the rehearsed person answers them."""
    person = Rehearsed(likeness, seed, run=run)
    onsets = [onset - watch.onsets[0] + LEAD_S for onset in watch.onsets]
    for onset, error in zip(onsets, watch.error.tolist(), strict=True):
        person.respond(onset, error)
    rows, kept = [], []
    for number, onset in enumerate(onsets):
        first = round(onset * person.sfreq) - watch.shape.n_before
        data = person.render(first, watch.shape.n_raw).astype(np.float64)
        row = watch.features(number, Epoch(data, first / person.sfreq, (first + len(data) - 1) / person.sfreq))
        if not isinstance(row, Rejection):
            rows.append(row)
            kept.append(number)
    if not rows:
        raise SetupError("No move of a rehearsal of this recording can be judged. Is its EEG all artefacts?")
    return np.stack(rows), watch.error[kept]


def scale_for(
    likeness: Likeness, accuracy: float, watch: Watch, config: ClassifierConfig, n_windows: int, seed: int
) -> tuple[float, dict[float, float]]:
    """The size of the ErrP, in the estimated one, and the balanced accuracy of each size tried.

    Parameters
    ----------
    accuracy : balanced, over contiguous folds, to be reached by a decoder calibrated on as many moves.
    n_windows : of each channel's features.
    seed : of the rehearsals tried.
    """
    reached = {size: 0.0 for size in SCALES}
    for draw in range(N_DRAWS):
        # An ErrP of another size is the same plus a multiple of the mean one: features are linear.
        without, error = watched(replace(likeness, scale=0.0), watch, seed, FIRST_RUN + draw)
        once, again = watched(replace(likeness, scale=1.0), watch, seed, FIRST_RUN + draw)
        if len(error) != len(again):
            raise SetupError(
                "An estimated response of this recording is so large that the decoder takes it for an artefact."
            )
        folds = contiguous_folds(error, config)
        for size in SCALES:
            log_odds = held_out_log_odds(without + size * (once - without), error, config, folds, n_windows)
            reached[size] += score(log_odds, error).balanced_accuracy.value / N_DRAWS
    rising = np.maximum.accumulate(list(reached.values()))
    return float(np.interp(accuracy, rising, SCALES)) if accuracy > rising[0] else 0.0, reached
