"""A scikit-learn estimator of the researcher's own as the decoder's classifier, as long as it is linear.

A decoder's file holds numbers and no code, so that it can be read anywhere and replayed to the bit. An estimator is
therefore only asked to fit; what is kept are its weights and bias.
"""

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError

Array = NDArray[np.float64]

_EXAMPLE = "sklearn.linear_model:LogisticRegression"


def estimator_weights(name: str, features: Array, error: NDArray[np.bool_]) -> tuple[Array, float]:
    """Weights, (n_features,), log odds a uV, and bias of a new estimator fitted on (n_epochs, n_features) uV.

    ``name`` is "module:factory", where calling ``factory()`` gives an estimator. It is fitted on bool labels, True for
    error, and is expected to have ``coef_`` and ``intercept_`` then. Raises SetupError for anything else.
    """
    estimator = make_estimator(name)
    try:
        estimator.fit(features, error)
    except (ValueError, TypeError) as failure:
        raise SetupError(f"The estimator {name} can't be fitted on {len(error)} epochs: {failure}.") from failure
    coef, intercept = getattr(estimator, "coef_", None), getattr(estimator, "intercept_", None)
    if coef is None or intercept is None:
        raise SetupError(
            f"The estimator {name} is a {type(estimator).__name__} without coef_ and intercept_ after its fit. A "
            "decoder's file holds a weight a feature and a bias, so classifier.estimator must be linear, such as "
            f"{_EXAMPLE}; one that scales or projects before has to fold that into its coef_."
        )
    weights, bias = np.array(coef, dtype=np.float64), np.array(intercept, dtype=np.float64)
    n_features = features.shape[1]
    if weights.shape not in ((1, n_features), (n_features,)) or bias.size != 1:
        raise SetupError(
            f"The estimator {name} should have one weight for each of {n_features} features and one bias; its coef_ "
            f"has the shape {weights.shape}, its intercept_ {bias.shape}. Give a classifier of two classes."
        )
    if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
        raise SetupError(f"The estimator {name} has weights that are not finite numbers. Regularise it more.")
    return weights.reshape(-1), float(bias.reshape(()))


def make_estimator(name: str) -> Any:
    """A new estimator from "module:factory". Raises SetupError where there is none."""
    # Only a researcher with an estimator of their own needs it, and it takes a second to import.
    from sklearn.base import is_classifier

    module_name, _, attribute = name.partition(":")
    if not (module_name and attribute):
        raise SetupError(f"classifier.estimator should be module:factory, such as {_EXAMPLE}; found {name!r}.")
    try:
        module = import_module(module_name)
    except (ImportError, TypeError) as error:
        raise SetupError(
            f"Can't import the module of the estimator {name}: {error}. Install it beside bci-app, or put its folder "
            "on PYTHONPATH."
        ) from error
    factory = getattr(module, attribute, None)
    if factory is None:
        raise SetupError(
            f"The module {module_name} has no {attribute!r}, which classifier.estimator names. Correct it."
        )
    try:
        estimator = factory()
    except TypeError as error:
        raise SetupError(
            f"The estimator {name} can't be made by a call without arguments: {error}. Give a function that makes it."
        ) from error
    if not callable(getattr(estimator, "fit", None)) or isinstance(estimator, type):
        raise SetupError(f"{name}() gives a {type(estimator).__name__}, which has no fit: it is no estimator.")
    if not is_classifier(estimator):
        kind = type(estimator).__name__
        raise SetupError(
            f"{name}() gives a {kind}, which is no classifier: its coef_ would be no log odds. Give one, such as "
            f"{_EXAMPLE}."
        )
    return estimator
