"""What is measured of a machine, against its limits; and the set-up file that comes of it."""

from pathlib import Path

import numpy as np
import pytest

from bci_app import certificate, certification, set_up
from bci_app.certification import Finding, light, light_delays, may_run
from bci_app.certify import PARTICIPANT, Wanted, _channel, _ledger, _noise_decoder, _stream, examine
from bci_app.config import Config, changed
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.protocol import Action, MoveOnset, Verdict
from bci_app.recording import Recording, Stamped
from decoder.model import load
from decoder.photodiode import Photodiode
from stimulus.pace import Flips

GOOD = Flips(16.67, 0.1, 17.0, 600, 0, True)


def flips_at(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 2.0 + np.arange(n) * 3.0 + rng.uniform(0, 0.02, n)


def channel(delay_ms: float, sfreq: float, applied_ms: float = 0.0, n: int = 40) -> tuple[np.ndarray, ...]:
    """The simulated photodiode's samples in chunks as it plays them, its times, and the flips."""
    config = changed(Config(), {"simulation": {"photodiode_ms": delay_ms}, "stimulus": {"photon_delay_ms": applied_ms}})
    diode, flips = Photodiode(config, 0.0, sfreq), flips_at(n)
    for flip in flips:
        diode.jump(float(flip) + applied_ms / 1e3)
    n_times, step = int((flips[-1] + 2) * sfreq), int(10 * sfreq)
    parts = [diode.render(start, min(step, n_times - start)) for start in range(0, n_times, step)]
    return np.concatenate(parts)[:, 0], np.arange(n_times) / sfreq, flips


@pytest.mark.parametrize("delay_ms", [0.0, 4.0, 23.0, 61.5])
@pytest.mark.parametrize("sfreq", [250.0, 500.0, 1000.0])
def test_a_known_offset_is_found(delay_ms: float, sfreq: float) -> None:
    samples, times, flips = channel(delay_ms, sfreq)
    found = light_delays(samples, times, flips)
    assert np.isfinite(found).all()
    assert found.mean() == pytest.approx(delay_ms, abs=0.35e3 / sfreq)
    assert found.std() < 0.5e3 / sfreq


def test_what_the_stimulus_adds_to_its_stamps_is_no_light() -> None:
    """The simulated light follows the flip, whatever the stamp says."""
    samples, times, flips = channel(23.0, 500.0, applied_ms=23.0)
    assert light_delays(samples, times, flips).mean() == pytest.approx(23.0, abs=0.7)
    stamps = flips + 0.023
    assert light_delays(samples, times, stamps).mean() == pytest.approx(0.0, abs=0.7)


@pytest.mark.parametrize("kind", ["slow screen", "without direct current", "drifting", "upside down", "dim"])
def test_real_photodiodes_are_read_too(kind: str) -> None:
    samples, times, flips = channel(30.0, 1000.0)
    wanted = 30.0
    match kind:
        case "slow screen":  # 10 ms from dark to light: the middle counts
            samples, wanted = np.convolve(samples, np.full(10, 0.1))[: len(samples)], 34.5
        case "without direct current":
            keep, level = np.exp(-1 / 1000 / 0.5), 0.0
            filtered = np.empty(len(samples))
            for number, sample in enumerate(samples):
                filtered[number] = sample - level
                level = keep * level + (1 - keep) * sample
            samples = filtered
        case "drifting":
            samples = samples + 2000 * np.sin(times / 7)
        case "upside down":
            samples = -samples
        case "dim":
            samples = samples / 1000 * 60 + np.random.default_rng(1).normal(0, 3, len(samples))
    found = light_delays(samples, times, flips)
    assert np.isfinite(found).mean() > 0.95
    assert np.nanmean(found) == pytest.approx(wanted, abs=1.0)


def test_a_photodiode_that_isnt_on_the_patch_is_said() -> None:
    rng = np.random.default_rng(0)
    times = np.arange(60_000) / 500
    nothing = light_delays(rng.normal(0, 5, len(times)), times, flips_at(30))
    finding = light(nothing, None)
    assert finding.ok is False
    assert "on the patch" in finding.found
    assert not len(light_delays(np.zeros(10), np.arange(10) / 500, np.empty(0)))
    assert np.isnan(light_delays(np.zeros(10), np.arange(10) / 500, np.array([40.0]))).all()


def test_light_before_its_flip_or_at_any_time_is_beyond_the_limit() -> None:
    rng = np.random.default_rng(0)
    assert light(rng.normal(20, 3, 50), 16.0).ok
    assert light(rng.normal(20, 3, 50), 16.0).figures["key_ms"] == pytest.approx(36, abs=2)
    early = light(rng.normal(-8, 1, 50), None)
    assert early.ok is False
    assert "stamps are early" in early.found
    assert light(rng.normal(20, 15, 50), None).ok is False
    assert light(rng.normal(300, 1, 50), None).ok is False


def test_screens_and_onsets_have_their_limits() -> None:
    assert certification.screen(GOOD, 60.0).ok
    assert certification.screen(Flips(16.67, 4.0, 30.0, 600, 0, True), 60.0).ok is False
    assert certification.screen(Flips(16.67, 0.1, 40.0, 600, 7, True), None).ok is False
    assert certification.screen(Flips(2.0, 5.0, 9.0, 600, 0, False), None).ok
    assert certification.onsets(GOOD, None).ok
    assert certification.onsets(GOOD, np.random.default_rng(0).normal(20, 14, 99)).ok is False
    assert certification.onsets(Flips(2.0, 0.1, 9.0, 600, 0, False), None).figures["sd_ms"] == pytest.approx(4.81, 1e-2)
    assert certification.late_jumps(1, 30).ok
    assert certification.late_jumps(2, 30).ok is False


def test_a_marker_before_its_flip_is_never_allowed() -> None:
    assert certification.markers(np.array([0.2, 1.0])).ok
    assert certification.markers(np.array([0.2, -0.01])).ok is False
    assert certification.markers(np.array([0.2, 150.0])).ok is False
    assert certification.markers(np.empty(0)).ok is False


def message_at(stamp: float, kind: str, step: int, **fields: object) -> Stamped:
    common = {"session": "s", "episode": 0, "step": step, **fields}
    kinds = {"onset": MoveOnset, "verdict": Verdict, "action": Action}
    return Stamped(stamp, kinds[kind].model_validate(common))


class Ear:
    def __init__(self) -> None:
        self.moves, self.actions = {(0, 1): 10.001, (0, 2): 13.002}, {(0, 2): 10.66}


def test_the_ledger_of_a_run() -> None:
    where = {"position": (1, 1), "sensed": (False,) * 5, "action": "north"}
    chosen = {"action": "north", "probabilities": (1, 0, 0, 0), "verdict": "error"}
    eeg = EegDescription("A", "", "", ("Cz",), ("uV",), ("EEG",), 500.0)
    messages = (
        message_at(10.0, "onset", 1, **where),
        message_at(10.65, "verdict", 1, outcome="error", clock_offset=0.0, latency_ms=1.5),
        message_at(10.655, "action", 2, **chosen),
        message_at(13.0, "onset", 2, **where),
    )
    recording = Recording(Path("r.xdf"), eeg, np.empty((0, 1)), np.empty(0), messages, ())
    ledger = _ledger(recording, Ear())  # type: ignore[arg-type]
    assert ledger["verdict"].tolist() == [1.5]
    assert ledger["action"] == pytest.approx([5.0])
    assert ledger["way"] == pytest.approx([5.0])
    assert ledger["left"] == pytest.approx([2340.0])
    assert all(finding.ok for finding in certification.stages(ledger))
    slow = {**ledger, "left": np.array([200.0])}
    assert [finding.ok for finding in certification.stages(slow)] == [True, True, True, False]


def test_the_page_says_it_in_one_sentence_and_needs_nothing_else(tmp_path: Path) -> None:
    findings = [certification.screen(GOOD, 60.0), certification.UNSEEN]
    assert may_run(findings)
    assert certificate.sentence(findings) == "This machine may run this experiment. Not measured: flip to light."
    page = certificate.html(findings, {"computer": "<lab & Co>"})
    assert "&lt;lab &amp; Co&gt;" in page
    assert "http" not in page
    bad = [*findings, Finding("late jumps in a run", "9 of 30", "1%", "why", False)]
    assert "may not run" in certificate.sentence(bad)
    assert "late jumps" in certificate.sentence(bad)
    certificate.write(page, tmp_path / "deep" / "page.html")
    with pytest.raises(SetupError, match="--out"):
        certificate.write(page, tmp_path / "deep" / "page.html")


# The photodiode's channel, and the set-up file

LAB = EegDescription("Lab", "", "", ("Cz", "Photo1", "AUX"), ("uV",) * 3, ("EEG", "MISC", "EEG"), 500.0)


def test_the_photodiodes_channel_is_found_by_its_name_or_named() -> None:
    assert _channel(LAB, None) == "Photo1"
    assert _channel(EegDescription("Lab", "", "", ("Cz",), ("uV",), ("EEG",), 500.0), None) is None
    with pytest.raises(SetupError, match="has no channel PD; it has Cz, Photo1, AUX"):
        _channel(LAB, "PD")
    with pytest.raises(SetupError, match="is taken for EEG"):
        _channel(LAB, "AUX")


def test_a_simulated_set_up_has_its_photodiode_and_a_decoder_fits_it(tmp_path: Path) -> None:
    config = changed(Config(), {"simulation": {"photodiode_ms": 23}})
    eeg = _stream(Wanted(config, 10, True, None, tmp_path / "page.html"))
    assert eeg.channels[-1] == "PHOTO"
    assert "PHOTO" not in eeg.picked
    assert load(_noise_decoder(config, eeg, tmp_path)).info.participant == PARTICIPANT


def test_a_page_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("older", encoding="utf-8")
    with pytest.raises(SetupError, match="is there already"):
        examine(Wanted(Config(), 10, True, None, tmp_path / "page.html"), lambda *_: None)
    with pytest.raises(SetupError, match="Can't write"):
        examine(Wanted(Config(), 10, True, None, tmp_path / "page.html" / "other.html"), lambda *_: None)


def written(folder: Path, **stimulus: object) -> Config:
    """A configuration that names the set-up file measured on `stimulus`."""
    config = changed(Config(), {"stimulus": stimulus})
    set_up.write(set_up.describe(config, "LiveAmp", "PHOTO", 30, 21.5, 1.2), folder / "set-up.json")
    return changed(config, {"stimulus": {"set_up": str(folder / "set-up.json")}})


def test_a_set_up_file_is_applied_on_its_own_set_up_only(tmp_path: Path) -> None:
    config = written(tmp_path, display=1, fullscreen=True)
    assert set_up.applied(Config()) == Config()
    assert set_up.applied(config).stimulus.photon_delay_ms == 21.5
    assert set_up.applied(set_up.applied(config)).stimulus.photon_delay_ms == 21.5
    with pytest.raises(SetupError, match="measured with display = 1, and now it is 0"):
        set_up.applied(changed(config, {"stimulus": {"display": 0}}))
    other = "the EEG stream 'LiveAmp', not with 'Other'"
    with pytest.raises(SetupError, match=other):
        set_up.applied(changed(config, {"eeg": {"stream_name": "Other"}}))
    # Where no stream is named it is known once it is found.
    set_up.check_stream(config, "LiveAmp")
    set_up.check_stream(Config(), "Other")
    with pytest.raises(SetupError, match=other):
        set_up.check_stream(config, "Other")
    set_up.write(set_up.describe(config, None, "PHOTO", 1, 1.0, 0.0), tmp_path / "simulated.json")
    with pytest.raises(SetupError, match="a simulated amplifier, not with 'Other'"):
        set_up.check_stream(changed(config, {"stimulus": {"set_up": str(tmp_path / "simulated.json")}}), "Other")
    with pytest.raises(SetupError, match="Leave out one of them"):
        set_up.applied(changed(config, {"stimulus": {"photon_delay_ms": 5}}))
    with pytest.raises(SetupError, match="Can't write the set-up file"):
        set_up.write(set_up.describe(config, None, "PHOTO", 1, 1.0, 0.0), tmp_path / "set-up.json")


@pytest.mark.parametrize("text", ["{", '{"photon_delay_ms": 3}', "[1]"])
def test_what_is_no_set_up_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "set-up.json").write_text(text, encoding="utf-8")
    with pytest.raises(SetupError, match="is no set-up file"):
        set_up.applied(changed(Config(), {"stimulus": {"set_up": str(tmp_path / "set-up.json")}}))
    with pytest.raises(SetupError, match="Can't read the set-up file"):
        set_up.applied(changed(Config(), {"stimulus": {"set_up": str(tmp_path / "absent.json")}}))
