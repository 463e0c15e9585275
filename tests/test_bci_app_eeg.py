"""What an EEG stream must say about itself."""

from dataclasses import replace

import numpy as np
import pytest

from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from decoder.eyes import eeg_outputs, ocular_sources

GOOD = EegDescription("Amp", "amp-1", "host", ("Fz", "Cz"), ("uV", "microvolts"), ("EEG", ""), 500.0)


@pytest.mark.parametrize(
    ("description", "says"),
    [
        (replace(GOOD, units=("", "")), "gives no unit"),
        (replace(GOOD, units=("uV", "ADC")), "unit 'ADC'"),
        (replace(GOOD, channels=("Cz", "Cz")), "not unique: 'Cz'"),
        (replace(GOOD, channels=("", "")), "no labels"),
        (replace(GOOD, sfreq=0.0), "no fixed sampling rate"),
    ],
)
def test_an_unusable_stream_is_refused(description: EegDescription, says: str) -> None:
    with pytest.raises(SetupError, match="Stream 'Amp'") as error:
        description.check()
    assert says in str(error.value)


def test_units_are_scaled_and_other_channels_left_out() -> None:
    stream = EegDescription("Amp", "", "", ("Fz", "Trigger", "Cz"), ("V", "", "mV"), ("EEG", "TRIG", "EEG"), 500.0)
    stream.check()
    assert stream.picked == ["Fz", "Cz"]
    wire = np.array([[1e-6, 7, 2e-3]], dtype=np.float32)
    np.testing.assert_allclose(stream.in_microvolts(wire), [[1.0, 2.0]], rtol=1e-6)


def test_eog_channels_are_taken_and_say_so() -> None:
    kinds = ("EEG", "EOG", "eog", "AUX", "")
    stream = EegDescription("Amp", "", "", ("Fz", "Left", "VEOG", "x", "HEOG"), ("uV",) * 5, kinds, 500.0)
    stream.check()
    assert stream.picked == ["Fz", "EOG Left", "VEOG", "HEOG"]
    names = tuple(stream.picked)
    assert eeg_outputs(names).tolist() == [0]
    assert ocular_sources(names)[0] == names[1:]


def test_what_is_in_microvolts_already_is_not_copied() -> None:
    wire = np.ones((5, 2), dtype=np.float32)
    assert GOOD.in_microvolts(wire) is wire
