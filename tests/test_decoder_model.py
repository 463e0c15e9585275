"""The model file and how a stream is fitted to it."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.errors import SetupError
from decoder.calibration import calibrate
from decoder.chain import design
from decoder.evidence import calibrate_evidence
from decoder.model import FORMAT_VERSION, DecoderModel, fit_stream, load, make_model, save
from decoder.montage import MONTAGE_64, canonical, directions
from decoder.operator import features
from decoder.spatial import common_average


@pytest.fixture(scope="module")
def model() -> DecoderModel:
    rng = np.random.default_rng(0)
    channels = ("Fz", "FCz", "Cz", "Pz")
    error = rng.permutation(np.arange(100) < 30)
    calibration = calibrate(rng.normal(error[:, None], 1, (100, 60)), error, ClassifierConfig())
    chain = design(ChainConfig(), 500.0)
    details = {"participant": "P003", "channels": channels, "n_rejected": 2}
    return make_model(calibration, error, chain, ClassifierConfig(), **details)


@pytest.fixture
def file(model: DecoderModel, tmp_path: Path) -> Path:
    path = tmp_path / "decoder.safetensors"
    save(model, path)
    return path


def test_what_is_saved_comes_back_to_the_bit(model: DecoderModel, file: Path) -> None:
    loaded = load(file)
    assert loaded.info == model.info
    epoch = np.random.default_rng(1).normal(0, 20, (model.info.n_before + model.info.n_after, 4))
    before = model.classifier.log_odds(features(epoch, model.operator, common_average(4)))
    assert loaded.classifier.log_odds(features(epoch, loaded.operator, common_average(4))) == before
    np.testing.assert_array_equal(loaded.held_out_log_odds, model.held_out_log_odds)
    np.testing.assert_array_equal(loaded.held_out_error, model.held_out_error)


def test_it_says_what_it_was_made_from(file: Path) -> None:
    info = load(file).info
    assert (info.participant, info.unit, info.n_error, info.n_correct, info.n_rejected) == ("P003", "uV", 30, 70, 2)
    assert info.versions["numpy"] == np.__version__
    assert 0 <= info.tenfold["balanced_accuracy"]["low"] <= info.tenfold["balanced_accuracy"]["value"] <= 1


def test_it_says_what_its_verdicts_are_worth(file: Path) -> None:
    loaded = load(file)
    assert loaded.info.evidence == calibrate_evidence(loaded.held_out_log_odds, loaded.held_out_error)
    assert loaded.info.evidence.slope > 0


@pytest.mark.parametrize("wrong", ['\\"hit\\":NaN', '\\"hit\\":1.0', '\\"hat\\":0.5'])
def test_impossible_evidence_is_refused(file: Path, wrong: str) -> None:
    contents = file.read_bytes()
    found = re.search(rb'\\"hit\\":[0-9.]+', contents)
    assert found
    file.write_bytes(contents.replace(found[0], wrong.ljust(len(found[0])).encode()))  # as long: a whole file
    with pytest.raises(SetupError, match=r"evidence\.h[ai]t: "):
        load(file)


def test_half_a_file_is_never_left_under_its_name(model: DecoderModel, tmp_path: Path) -> None:
    """A kill or a full disk in the middle of writing leaves a .partial, and the next fit can write."""
    path = tmp_path / "d.safetensors"
    path.with_name("d.safetensors.partial").write_bytes(b"half")
    save(model, path)
    assert load(path).info == model.info
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_it_is_never_overwritten(model: DecoderModel, file: Path) -> None:
    contents = file.read_bytes()
    with pytest.raises(SetupError, match="never overwritten"):
        save(model, file)
    assert file.read_bytes() == contents


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_refused(file: Path, tmp_path: Path, data: st.DataObject) -> None:
    contents = bytearray(file.read_bytes())
    if data.draw(st.booleans()):
        del contents[data.draw(st.integers(0, len(contents) - 1)) :]
    else:
        place = data.draw(st.integers(0, len(contents) - 1))
        contents[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "damaged.safetensors"
    path.write_bytes(contents)
    with pytest.raises(SetupError, match=r"damaged|is a decoder of format"):
        load(path)


@pytest.mark.parametrize("contents", [b"", b"not a decoder", b"PK\x03\x04" * 100])
def test_other_files_are_refused(tmp_path: Path, contents: bytes) -> None:
    path = tmp_path / "other"
    path.write_bytes(contents)
    with pytest.raises(SetupError, match=f"no decoder of format {FORMAT_VERSION}"):
        load(path)
    with pytest.raises(SetupError, match="Calibrate first"):
        load(tmp_path / "missing")


def test_a_future_format_is_refused(file: Path) -> None:
    contents = file.read_bytes().replace(b'{\\"format\\":4', b'{\\"format\\":5')
    file.write_bytes(contents)
    with pytest.raises(SetupError, match=r"damaged \(format: .*Use the bci-app version that wrote it"):
        load(file)


def test_an_older_format_is_to_be_fitted_again(file: Path) -> None:
    contents = file.read_bytes().replace(b'{\\"format\\":4', b'{\\"format\\":2')
    file.write_bytes(contents)
    with pytest.raises(SetupError, match=r"format 2, .*Run `bci-app fit` on the calibration again\.$"):
        load(file)


def test_reordered_and_respelt_channels_are_mended(model: DecoderModel) -> None:
    found = fit_stream(model, "LiveAmp", ["AUX", "EEG PZ", "Cz..", "fcz", "FZ-Ref"], 500.0)
    np.testing.assert_array_equal(found, [4, 3, 2, 1])


def test_missing_channels_another_rate_and_twins_are_refused(model: DecoderModel) -> None:
    with pytest.raises(SetupError) as error:
        fit_stream(model, "LiveAmp", ["Fz", "Cz", "Pz"], 500.0)
    assert str(error.value) == (
        "Stream 'LiveAmp' has 3 channels; the decoder of P003 was calibrated on 4 (missing: FCz). "
        "Fix the montage or recalibrate."
    )
    with pytest.raises(SetupError, match="runs at 250 Hz"):
        fit_stream(model, "LiveAmp", ["Fz", "FCz", "Cz", "Pz"], 250.0)
    with pytest.raises(SetupError, match="same electrode"):
        fit_stream(model, "LiveAmp", ["Fz", "FCz", "Cz", "Pz", "FZ."], 500.0)


@pytest.mark.parametrize("name", ["Fcz.", "FCZ", "EEG FCz", "eeg-fcz", "FCz-REF", " fcz "])
def test_spellings_of_one_electrode(name: str) -> None:
    assert canonical(name) == "fcz"


def test_the_montage_is_symmetric_and_known() -> None:
    assert len({canonical(name) for name in MONTAGE_64}) == 64
    where = dict(zip(MONTAGE_64, directions(MONTAGE_64), strict=True))
    assert where["Fz"][1] > 0.6 > -0.6 > where["Pz"][1]
    assert where["T8"][0] > 0.9
    np.testing.assert_allclose(where["C3"] * (-1, 1, 1), where["C4"], atol=0.1)
    assert np.isnan(directions(["EOG"])).all()


def test_a_recording_is_told_to_be_one(tmp_path: Path) -> None:
    path = tmp_path / "sub-P001_ses-S001_task-calibration_run-001_eeg.xdf"
    path.write_bytes(b"XDF:\x01\x02")
    with pytest.raises(SetupError, match=r"is a recording, not a decoder\. `bci-app fit` .*_decoder\.safetensors"):
        load(path)
