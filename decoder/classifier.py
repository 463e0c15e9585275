"""Shrinkage LDA (paper V.A.5), reduced to weights and a bias."""

from dataclasses import dataclass
from math import fsum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearClassifier:
    """A fitted classifier.

    Attributes
    ----------
    weights : float64, (n_features,), natural log odds a uV.
    bias : float, natural log odds.
    """

    weights: Array
    bias: float

    def log_odds(self, features: Array) -> float:
        """Natural log of P(error) / P(correct) for one row of features, (n_features,) in uV.

        The sum is rounded once and exactly (`math.fsum`), so the same features give the same bits on every machine.
        """
        return fsum([*(self.weights * features).tolist(), self.bias])


def fit(features: Array, error: NDArray[np.bool_], prior_error: float = 0.5) -> LinearClassifier:
    """Fit on (n_epochs, n_features) uV and (n_epochs,) labels; True is `error`.

    Notes
    -----
    Ledoit-Wolf shrinkage of each class's covariance on standardised features, that is towards the diagonal. The class
    priors are set, not counted; they also weigh the two classes' covariances.
    """
    # scikit-learn is slow to import, and a decoder that loads a model file never fits.
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    lda = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto", priors=[1 - prior_error, prior_error])
    lda.fit(features, error)
    return LinearClassifier(np.ascontiguousarray(lda.coef_[0]), float(lda.intercept_[0]))
