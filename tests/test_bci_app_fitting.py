"""What a fit tells beside cross-validation."""

from collections import Counter

import numpy as np
import pytest

from bci_app.config import validated
from bci_app.fitting import Labelled, _by_block, _session
from bci_app.ocular import Learnt
from decoder.calibration import calibrate


@pytest.fixture
def config():
    return validated({"calibration": {"moves_per_block": 80, "n_blocks": 3}, "online": {"expected_moves": 100}}, "here")


@pytest.fixture
def epochs() -> Labelled:
    rng = np.random.default_rng(0)
    error = np.tile(np.arange(10) < 3, 20)
    features = rng.normal(0, 1, (200, 30)) + 0.4 * error[:, None]
    return Labelled([], Counter(), [], features, error, Learnt(None, "", None), np.empty(0))


def test_a_session_is_predicted_for_the_moves_of_the_configuration(epochs: Labelled, config) -> None:
    result = calibrate(epochs.features, epochs.error, config.classifier, config.chain.n_windows)
    found = _session(result, epochs.error, config)
    assert (found["n_moves"], found["error_share"]) == (100, 0.3)
    assert found["accuracy"]["low"] < result.blocked.accuracy.value < found["accuracy"]["high"]
    assert found["accuracy"]["low"] < result.blocked.accuracy.low  # Wilson's knows nothing of the session's own chance


def test_the_learning_curve_goes_block_by_block_to_the_last_whole_one(epochs: Labelled, config) -> None:
    found = _by_block(epochs, config)
    assert list(found) == ["after_80", "after_160"]
    assert found["after_80"]["total_gain"]["value"] > found["after_160"]["total_gain"]["value"] > 0
    assert found["after_160"]["sentence"].startswith("After 160 epochs")
