"""A head start from the lab's earlier participants, as much of it as this participant's own cross-validation bears out.

What errors add to the EEG resembles from person to person, and a short calibration knows it badly. So the difference
of the two class means is shrunk towards the lab's, as if some pseudo-epochs of an average participant had been seen:

    difference = (n * own + n_pseudo * lab) / (n + n_pseudo)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ClassifierConfig
from bci_app.errors import SetupError
from decoder.calibration import contiguous_folds
from decoder.classifier import fit
from decoder.learning_curve import point

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

CHOICES = (0, 50, 150, 500)
"""Numbers of pseudo-epochs to choose from (decided: from half a block to nearly a whole calibration)."""
N_FOLDS = 5
"""Contiguous stretches, each left out once to choose (decided)."""


@dataclass(frozen=True, eq=False)
class Lab:
    """What earlier participants have in common.

    Attributes
    ----------
    difference : float64, (n_features,), uV, the mean over participants of error minus correct.
    n_participants : how many.
    """

    difference: Array
    n_participants: int


@dataclass(frozen=True)
class WarmStart:
    """What was taken over, for the result to tell: how many pseudo-epochs of how many earlier participants.

    `separations` are those of the held-out log odds with each of `CHOICES`, which it was chosen by.
    """

    n_pseudo: int
    n_participants: int
    separations: tuple[float, ...]


def difference(features: Array, error: Labels) -> Array:
    """Error minus correct, mean features in uV: (n_features,) of (n_epochs, n_features)."""
    own: Array = features[error].mean(axis=0) - features[~error].mean(axis=0)
    return own


def lab(differences: Sequence[Array]) -> Lab:
    """The lab, of each earlier participant's `difference` on the same channels. Raises SetupError without any."""
    if not differences:
        raise SetupError("A warm start takes earlier participants; there is none. Calibrate from scratch.")
    return Lab(np.mean(differences, axis=0), len(differences))


def warmed(features: Array, error: Labels, known: Lab, n_pseudo: int) -> Array:
    """Features (n_epochs, n_features) with class means that differ by what own and pseudo-epochs say together.

    Both classes are moved by half of it in opposite directions: covariances within a class stay, and so does the middle
    between the classes. A decoder fitted on them is the warm-started one; others' epochs are never to be moved.
    """
    share = n_pseudo / (len(error) + n_pseudo)
    shift = share * (known.difference - difference(features, error)) / 2
    moved: Array = features + np.where(error, 1.0, -1.0)[:, None] * shift
    return moved


def choose(features: Array, error: Labels, config: ClassifierConfig, known: Lab) -> WarmStart:
    """The number of pseudo-epochs with which held-out log odds separate the classes best; 0 is among them.

    Parameters
    ----------
    features : float64, (n_epochs, n_features), uV, in the order of recording.
    error : bool, (n_epochs,), the truth.
    """
    folds = contiguous_folds(error, config.model_copy(update={"n_folds": N_FOLDS}))
    separations = []
    for n_pseudo in CHOICES:
        log_odds = np.empty(len(error))
        for train, test in folds:
            moved = warmed(features[train], error[train], known, n_pseudo)
            classifier = fit(moved, error[train], config.prior_error)
            log_odds[test] = features[test] @ classifier.weights + classifier.bias
        separations.append(point(log_odds, error, len(error)).separation)
    return WarmStart(CHOICES[int(np.argmax(separations))], known.n_participants, tuple(separations))
