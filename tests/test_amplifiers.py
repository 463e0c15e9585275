"""Amplifiers as they come, live: odd ones are understood, wrong ones refused, and losses told."""

import json
import signal
import subprocess
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pylsl
import pytest
from lsl_peers import LABELS, ForeignAmplifier, ForeignStimulus, Listener, lab_config, process, until

from bci_app import set_up
from bci_app.config import ChainConfig, Config
from decoder.chain import design
from decoder.montage import MONTAGE_64, canonical, template

AWAY_S = 1000
SECOND_HOST = (*f"unshare --time --monotonic {AWAY_S} --uts sh -c".split(), 'hostname second; exec "$@"', "sh")
"""What comes after runs on this machine, but under another name and with a clock that is ahead (Linux, as root)."""


def flatten(samples: np.ndarray) -> None:
    samples[:] = 7.0


def spelled_otherwise() -> list[str]:
    """Eight electrodes as amplifiers write them."""
    return ["EEG FZ", "Fcz.", "CZ-REF", "EEG C3-LE", "c4", "EEG T3", "PZ", "eeg oz"]


def without_counter(samples: np.ndarray) -> None:
    """A counter that begins anew is a jump too large for EEG."""
    samples[:, 0] = samples[:, 1] + np.random.default_rng(len(samples)).normal(0, 1, len(samples))


def cap_of_256() -> list[str]:
    """Electrodes of the 10-05 system, each once."""
    return list({canonical(name): name for name in (*MONTAGE_64, *template().ch_names)}.values())[:256]


@pytest.mark.trouble("App-WearableSensing #4: samples 10 us apart, then 35 ms")
@pytest.mark.parametrize(
    ("labels", "sfreq", "unit", "on_arrival"),
    [
        (spelled_otherwise, 128.0, "millivolts", True),
        (cap_of_256, 2000.0, "volts", False),
    ],
)
def test_any_amplifier_gives_epochs_at_their_place(
    tmp_path: Path, labels: Callable[[], list[str]], sfreq: float, unit: str, on_arrival: bool
) -> None:
    """From 8 channels at 128 Hz to 256 at 2000 Hz, in any unit, stamped as it may be."""
    name = f"Amp{sfreq:.0f}"
    stimulus = ForeignStimulus(name)
    amplifier = ForeignAmplifier(name, labels(), sfreq, unit, spoil=without_counter, on_arrival=on_arrival)
    config = named(tmp_path, name)
    with closing(amplifier), process("decoder", "--session", name, "--config", config) as decoder:
        verdicts = stimulus.listen("bci-verdicts")
        until(verdicts.is_ready, 60, "the decoder", amplifier.play)
        onsets = stimulus.walk(3, amplifier.play_for)
        until(lambda: len(verdicts.of("Verdict")) == 3, 60, "three verdicts", amplifier.play)
        stimulus.say("SessionEnd", reason="complete")
        until(lambda: decoder.poll() is not None, 60, "the decoder to end", amplifier.play)
    # In a wrong unit all of them would be nearly flat, or far too large.
    assert [electrodes["bad"] for electrodes in verdicts.of("Electrodes")] == [{}], str(verdicts.of("Verdict"))
    n_before = design(ChainConfig(), sfreq).n_before
    for onset, verdict in zip(onsets, verdicts.of("Verdict"), strict=True):
        assert verdict["outcome"] == "unjudged", str(verdict)
        # A stamp of arrival is late by up to a chunk; where it is cut is known to the millisecond.
        within = 0.045 if on_arrival else 0.5 / sfreq + 1e-9
        assert verdict["first_time"] + n_before / sfreq == pytest.approx(onset, abs=within)


@pytest.mark.trouble("liblsl #282, App-LabRecorder #147: a stream is missing, doubled or empty and nobody is told")
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (list, "No EEG stream"),
        (lambda: [ForeignAmplifier("AmpA"), ForeignAmplifier("AmpB")], "2 EEG streams fit"),
        (lambda: [ForeignAmplifier(unit=None)], "gives no unit"),
        (lambda: [ForeignAmplifier(labels=["Cz", "Cz"])], "not unique"),
        (lambda: [ForeignAmplifier(delivered=1e-9)], "is there but delivers no samples"),
        (lambda: [ForeignAmplifier(delivered=200.0)], "says 250 Hz but delivers 200"),
        (lambda: [ForeignAmplifier(spoil=flatten)], "flat line on all channels"),
        (lambda: [ForeignAmplifier(clock_s=1e5)], "from LSL's clock"),
    ],
)
def test_a_wrong_amplifier_is_refused_before_anything_starts(
    tmp_path: Path, make: Callable[[], list[ForeignAmplifier]], says: str
) -> None:
    words = ("calibrate", "--participant", "P1", "--config", lab_config(tmp_path), "--headless")
    with ExitStack() as stack, process(*words) as running:
        amplifiers = [stack.enter_context(closing(amplifier)) for amplifier in make()]
        until(
            lambda: running.poll() is not None, 60, "the refusal", lambda: [amp.play() for amp in amplifiers] and None
        )
        assert running.returncode == 2
        _, said = running.communicate()
        assert says in said
        assert "Traceback" not in said


def test_a_simulated_amplifier_that_is_alone_is_like_any_other(tmp_path: Path) -> None:
    """For a doctor without hardware: it plays on while it looks for a stimulus that never comes."""
    config = tmp_path / "alone.toml"
    config.write_text('[eeg]\nsource_id = "bci-app/alone/eeg"\n', encoding="utf-8")
    stimulus = ForeignStimulus("beside")
    with (
        process("amplifier", "--session", "alone"),
        process("decoder", "--session", "beside", "--config", config) as decoder,
    ):
        verdicts = stimulus.listen("bci-verdicts")
        until(lambda: verdicts.is_ready() or decoder.poll() is not None, 90, "the decoder")
        stimulus.walk(0, lambda _seconds: None)
        for step in range(1, 5):
            stimulus.move(step)
            until(lambda step=step: len(verdicts.of("Verdict")) == step, 45, "a verdict")
    assert {verdict["outcome"] for verdict in verdicts.of("Verdict")} == {"unjudged"}
    assert not [note for note in verdicts.of("Note") if "No EEG" in note["text"]]


@pytest.mark.parametrize(
    ("session", "more"),
    [("sub-P1_ses-S001_task-online_run-001-0a1b2c", ("--session", "lab")), ("lab", ("--session", "lab"))],
)
def test_a_second_session_of_the_same_person_is_refused_before_anything_starts(
    tmp_path: Path, session: str, more: tuple[str, ...]
) -> None:
    info = pylsl.StreamInfo("bci-session", "Events", 1, 0.0, "string", f"bci-app/{session}/bci-session")
    words = ("calibrate", "--participant", "P1", "--config", lab_config(tmp_path), "--headless", *more)
    with ExitStack() as stack, closing(ForeignAmplifier()) as amplifier, process(*words) as running:
        first = [pylsl.StreamOutlet(info)]
        stack.callback(first.clear)  # off the network, even where this fails and the outlet is still known by name
        until(lambda: running.poll() is not None, 60, "the refusal", amplifier.play)
        assert running.returncode == 2
        said = " ".join(running.communicate()[1].split())
        assert f"Session {session} is running on this computer already." in said
    assert not (tmp_path / "recordings").exists()


@pytest.mark.trouble("labstreaminglayer #102, pyxdf #137: clocks that are far apart")
def test_a_second_hosts_clock_a_thousand_seconds_away_moves_no_epoch(tmp_path: Path) -> None:
    try:
        subprocess.run([*SECOND_HOST, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"a second clock needs Linux's time namespaces and the right to make one: {error}")
    config = lab_config(tmp_path)
    config.write_text(config.read_text(encoding="utf-8").replace("= 40", "= 3"), encoding="utf-8")
    words = ("--session", "apart", "--config", config)
    with (
        closing(ForeignAmplifier()) as amplifier,
        process("decoder", *words),
        process("stimulus", *words, "--participant", "P", "--task", "calibration", host=SECOND_HOST) as stimulus,
    ):
        verdicts, moves = (Listener(f"bci-{name}", "apart") for name in ("verdicts", "stimulus"))
        until(lambda: len(verdicts.of("Verdict")) == 3, 60, "three verdicts", amplifier.play)
        until(lambda: moves.of("SessionEnd"), 60, "the session's end", amplifier.play)
        until(lambda: stimulus.poll() is not None, 60, "the stimulus to end", amplifier.play)
    onsets = [stamp for stamp, message in moves.heard if message["type"] == "MoveOnset"]
    n_before = design(ChainConfig(), 250.0).n_before
    for onset, verdict in zip(onsets, verdicts.of("Verdict"), strict=True):
        assert verdict["outcome"] == "unjudged"
        assert verdict["clock_offset"] == pytest.approx(-AWAY_S, abs=2e-3)  # LSL measures it to 0.2 ms
        here = onset + verdict["clock_offset"]
        assert verdict["first_time"] + n_before / 250 == pytest.approx(here, abs=0.5 / 250 + 1e-9)


def named(folder: Path, stream: str) -> Path:
    """A configuration that takes one stream of several on the network."""
    path = folder / f"{stream}.toml"
    path.write_text(f'[eeg]\nstream_name = "{stream}"\npatience_s = 10\n', encoding="utf-8")
    return path


@pytest.mark.trouble("mne-rt: a reordering of channels isn't noticed")
def test_missing_channels_are_refused_and_reordered_ones_mended(tmp_path: Path, any_decoder: Path) -> None:
    all_but_one = [label for label in LABELS if label != "FCz"]
    otherwise = [label.upper() for label in reversed(LABELS)]
    words = ("doctor", "--model", any_decoder, "--moves", "--headless", "--json", "--config")
    refused = named(tmp_path, "AmpC")
    set_up.write(set_up.describe(Config(), "LiveAmp", "PHOTO", 30, 21.5, 1.2), tmp_path / "set-up.json")
    with refused.open("a", encoding="utf-8") as file:
        file.write(f'[stimulus]\nset_up = "{(tmp_path / "set-up.json").as_posix()}"\n')
    with (
        closing(ForeignAmplifier("AmpC", labels=all_but_one)) as missing,
        closing(ForeignAmplifier("AmpD", labels=otherwise)) as shuffled,
        process(*words, refused) as refusing,
        process(*words, named(tmp_path, "AmpD")) as mending,
    ):

        def play() -> None:
            missing.play()
            shuffled.play()

        until(lambda: refusing.poll() is not None and mending.poll() is not None, 120, "both doctors", play)
        assert refusing.returncode == 2
        troubles = {check["check"]: check["text"] for check in json.loads(refusing.communicate()[0])["checks"]}
        assert "missing: FCz" in " ".join(troubles.values())
        assert "measured with the EEG stream 'LiveAmp', not with 'AmpC'" in troubles["set-up file"]
        said = mending.communicate()
        assert mending.returncode == 0, said
        result = json.loads(said[0])
        assert result["fit"]
        found = {check["check"]: check for check in result["checks"]}
        assert found["LSL finds streams"]["ok"]
        assert "GB needed" in found["room for a session on the disk"]["text"]
        assert found["the recording replays to the bit"]["ok"]
        assert "action" in found["a verdict is soon there"]["text"]


def test_a_decoder_that_is_started_again_refuses_another_amplifier(tmp_path: Path) -> None:
    words = ("decoder", "--session", "again", "--config", named(tmp_path, "AmpAgain"), "--returning", "--eeg")
    with closing(ForeignAmplifier("AmpAgain")) as amplifier, process(*words, "0123456789abcdef") as decoder:
        until(lambda: decoder.poll() is not None, 90, "the refusal", amplifier.play)
        assert decoder.returncode == 2
        assert "Stream 'AmpAgain' isn't what the run began with" in decoder.communicate()[1]


@pytest.mark.trouble("pylsl #88: the loss of a stream is invisible; liblsl #201, #220: and closing it then hangs")
def test_an_amplifier_that_fails_in_the_middle_ends_the_decoder(tmp_path: Path) -> None:
    """One drifts, one dies, one comes back with another cap, and each decoder says which."""
    faults = {
        "drifts": (2, "drifted from 250 Hz"),
        "dies": (3, "No EEG sample"),
        "changes": (2, "Stream 'Ampchanges' came back changed: expected"),
    }
    with ExitStack() as stack:
        amplifiers = {fault: stack.enter_context(closing(ForeignAmplifier(f"Amp{fault}"))) for fault in faults}
        stimuli = {fault: ForeignStimulus(fault) for fault in faults}
        decoders = {
            fault: stack.enter_context(
                process("decoder", "--session", fault, "--config", named(tmp_path, f"Amp{fault}"))
            )
            for fault in faults
        }
        verdicts = {fault: stimuli[fault].listen("bci-verdicts") for fault in faults}

        def play() -> None:
            for amplifier in amplifiers.values():
                amplifier.play()

        until(lambda: all([heard.is_ready() for heard in verdicts.values()]), 90, "the decoders", play)
        amplifiers["drifts"].change_rate(240.0)
        amplifiers["changes"].close()
        heard = verdicts["changes"]
        until(lambda: any("No EEG" in note["text"] for note in heard.of("Note")), 45, "word of it")
        changed = stack.enter_context(closing(ForeignAmplifier("Ampchanges", labels=LABELS[::-1])))

        def play_on() -> None:
            amplifiers["drifts"].play()
            changed.play()

        until(
            lambda: all([decoder.poll() is not None for decoder in decoders.values()]),
            60,
            "the decoders to end",
            play_on,
        )
        for fault, (code, says) in faults.items():
            assert decoders[fault].returncode == code
            assert says in decoders[fault].communicate()[1]
            assert any(note["level"] == "error" for note in verdicts[fault].of("Note"))


@pytest.mark.trouble("pylsl #88: a stream's loss is invisible, and what came while it was away is gone")
def test_an_amplifier_that_comes_back_costs_the_moves_it_missed_and_no_other(tmp_path: Path) -> None:
    stimulus = ForeignStimulus("back")
    amplifier = ForeignAmplifier("AmpBack")
    with closing(amplifier), process("decoder", "--session", "back", "--config", named(tmp_path, "AmpBack")):
        verdicts = stimulus.listen("bci-verdicts")
        until(verdicts.is_ready, 90, "the decoder", amplifier.play)
        stimulus.walk(1, amplifier.play_for)
        until(lambda: len(verdicts.of("Verdict")) == 1, 45, "a verdict", amplifier.play)
        amplifier.close()
        until(lambda: any("No EEG" in note["text"] for note in verdicts.of("Note")), 45, "word of it", amplifier.play)
        stimulus.move(2)
        amplifier.connect()
        until(lambda: any("is back" in note["text"] for note in verdicts.of("Note")), 45, "its return", amplifier.play)
        amplifier.play_for(design(ChainConfig(), 250.0).n_before / 250)
        third = stimulus.move(3)
        until(lambda: len(verdicts.of("Verdict")) == 3, 45, "three verdicts", amplifier.play)
        # What came before the stimulus went on may not be in the recording, and isn't looked at.
        stimulus.say("Pause", reason="The decoder waits for EEG.")
        resumed = pylsl.local_clock()
        stimulus.say("Resume", resumed)
        amplifier.play_for(6)
        stimulus.say("EpisodeStart", episode=1, position=[5, 0], sensed=[False] * 5, max_steps=60)
        until(lambda: len(verdicts.of("Electrodes")) == 2, 45, "a look at the electrodes", amplifier.play)
        # A stimulus that was started again says its last words once more: they are known.
        stimulus.move(3, third)
        stimulus.say("EpisodeStart", episode=1, position=[5, 0], sensed=[False] * 5, max_steps=60)
        stimulus.move(1, episode=1)
        until(lambda: len(verdicts.of("Verdict")) == 4, 45, "the next verdict", amplifier.play)
    assert len(verdicts.of("Electrodes")) == 2
    assert not any("announced twice" in note["text"] for note in verdicts.of("Note"))
    look = verdicts.of("Electrodes")[1]
    assert look["last_time"] - (look["n_samples"] - 1) / 250 >= resumed
    assert look["n_samples"] > 4 * 250
    outcomes = [verdict["outcome"] for verdict in verdicts.of("Verdict")]
    assert outcomes == ["unjudged", "rejected", "unjudged", "unjudged"]


@pytest.mark.trouble("BciPy #308, #321: a buffer overflows while nobody reads, and data vanish")
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="a process can't be stopped here")
def test_a_decoder_that_was_stopped_for_a_while_loses_nothing(tmp_path: Path) -> None:
    """Longer than what it takes for silence: it hasn't listened, which isn't the amplifier's silence."""
    stimulus = ForeignStimulus("slow")
    amplifier = ForeignAmplifier("AmpSlow")
    config = named(tmp_path, "AmpSlow")
    with closing(amplifier), process("decoder", "--session", "slow", "--config", config) as decoder:
        verdicts = stimulus.listen("bci-verdicts")
        until(verdicts.is_ready, 90, "the decoder", amplifier.play)
        stimulus.walk(1, amplifier.play_for)
        decoder.send_signal(signal.SIGSTOP)
        for step in (2, 3, 4):
            amplifier.play_for(4.0)
            stimulus.move(step)
        decoder.send_signal(signal.SIGCONT)
        until(lambda: len(verdicts.of("Verdict")) == 4, 45, "four verdicts", amplifier.play)
    assert {verdict["outcome"] for verdict in verdicts.of("Verdict")} == {"unjudged"}
    assert not [note for note in verdicts.of("Note") if note["level"] == "error"]
