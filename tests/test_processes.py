"""Each process alone, against programs that know only docs/protocol.md; and sessions whose set-up is wrong."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
import pylsl
import pytest
from lsl_peers import LABELS, ForeignAmplifier, ForeignStimulus, Listener, until

from bci_app.config import ChainConfig
from bci_app.gridworld import load_map
from bci_app.protocol import BlockEnd, Electrodes, EpisodeStart, SessionEnd
from bci_app.recording import read
from bci_app.runs import read_sidecar
from decoder.chain import design
from policy.checkpoint import choose_told

TOLD = "0.7:0.8:0.2"  # hit, correct rejection, bits


AWAY_S = 1000
SECOND_HOST = (*f"unshare --time --monotonic {AWAY_S} --uts sh -c".split(), 'hostname second; exec "$@"', "sh")
"""What comes after runs on this machine, but under another name and with a clock that is ahead (Linux, as root)."""


@contextmanager
def process(*words: object, host: tuple[str, ...] = ()) -> Iterator[subprocess.Popen[str]]:
    """A bci-app process that is gone when the block ends."""
    command = [*host, sys.executable, "-m", "bci_app", *map(str, words)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield running
    finally:
        running.kill()
        running.communicate()


def test_a_foreign_stimulus_works_with_our_decoder_and_policy_and_nobody_opens_the_truth(any_decoder: Path) -> None:
    """Decoder and policy answer a program built on docs/protocol.md; neither ever subscribes to the truth."""
    stimulus = ForeignStimulus("foreign")
    policy_file = choose_told(load_map("open")).path
    with (
        closing(ForeignAmplifier()) as amplifier,
        process("decoder", "--session", "foreign", "--model", any_decoder) as decoder,
        process("policy", "--session", "foreign", "--map", "open", "--policy", policy_file, "--told", TOLD) as policy,
    ):
        verdicts, actions = stimulus.listen("bci-verdicts"), stimulus.listen("bci-actions")
        until(lambda: verdicts.is_ready() and actions.is_ready(), 40, "decoder and policy", amplifier.play)
        layout = ["." * 11] * 11
        stimulus.say("SessionStart", task="online", participant="P", map="open", layout=layout, n_episodes=1)
        stimulus.raw("this is no message")
        cell, nothing = [5, 5], [False] * 5
        moves = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
        stimulus.say("EpisodeStart", episode=0, position=cell, sensed=nothing, max_steps=3)
        for step in (1, 2, 3):
            action = until(
                lambda step=step: [a for a in actions.of("Action") if a["step"] == step], 15, "action", amplifier.play
            )[0]
            dr, dc = moves[action["action"]]
            cell = [cell[0] + dr, cell[1] + dc]
            # Verdicts need half a second of samples after the onset; the marker may come before them.
            stimulus.say("MoveOnset", episode=0, step=step, action=action["action"], position=cell, sensed=nothing)
            heard = until(
                lambda step=step: [v for v in verdicts.of("Verdict") if v["step"] == step],
                15,
                "verdict",
                amplifier.play,
            )
            assert heard[0]["outcome"] in ("error", "correct"), heard
        stimulus.say("EpisodeEnd", episode=0, steps=3, reason="limit")
        assert not stimulus.truth.have_consumers()
        listener = stimulus.listen("bci-truth")  # the check above can fail: this is what a consumer looks like
        assert stimulus.truth.wait_for_consumers(5.0)
        del listener
        stimulus.say("SessionEnd", reason="complete")
        until(lambda: decoder.poll() is not None and policy.poll() is not None, 15, "both to end", amplifier.play)
        assert (decoder.returncode, policy.returncode) == (0, 0), decoder.communicate()[1]
        assert len(actions.of("Action")) == 3  # none for a step after the limit
        refusals = [note["text"] for listener in (verdicts, actions) for note in listener.of("Note")]
        assert sum("Refused a sample on bci-stimulus" in text for text in refusals) == 2


def test_four_processes_started_by_hand_run_a_session(tmp_path: Path) -> None:
    """What the README says for several machines: no bci-app leads, nobody commands."""
    config = tmp_path / "hand.toml"
    config.write_text(
        '[eeg]\nsource_id = "bci-app/hand/eeg"\n[stimulus]\nheadless = true\n'
        "[calibration]\nn_blocks = 1\nmoves_per_block = 2\n",
        encoding="utf-8",
    )
    common = ("--session", "hand", "--config", config)
    with (
        process("stimulus", *common, "--participant", "P1", "--task", "calibration") as stimulus,
        process("decoder", *common) as decoder,
        process("amplifier", *common) as amplifier,
    ):
        verdicts = Listener("bci-verdicts", "hand")
        until(lambda: len(verdicts.of("Verdict")) == 2, 60, "two verdicts")
        assert {verdict["outcome"] for verdict in verdicts.of("Verdict")} == {"unjudged"}
        for running in (stimulus, decoder, amplifier):
            assert running.wait(20) == 0


def test_mne_lsl_reads_eeg_and_markers_while_the_session_runs(tmp_path: Path) -> None:
    from mne_lsl.stream import StreamLSL

    config = tmp_path / "mne.toml"
    config.write_text(
        '[eeg]\nsource_id = "bci-app/mne/eeg"\n[stimulus]\nheadless = true\n'
        "[calibration]\nn_blocks = 1\nmoves_per_block = 30\n",
        encoding="utf-8",
    )
    common = ("--session", "mne", "--config", config, "--speed", 4, "--origin", pylsl.local_clock())
    with (
        process("stimulus", *common, "--participant", "P1", "--task", "calibration"),
        process("decoder", *common),
        process("amplifier", *common),
    ):
        Listener("bci-markers", "mne")._inlet.close_stream()
        eeg = StreamLSL(10, source_id="bci-app/mne/eeg").connect(timeout=20)
        markers = StreamLSL(60, source_id="bci-app/mne/bci-markers").connect(timeout=20)
        assert eeg.info["sfreq"] == 500
        assert "FCz" in eeg.ch_names
        until(lambda: eeg.n_new_samples > 500, 30, "EEG through mne-lsl")
        assert np.isfinite(eeg.get_data(winsize=1)[0]).all()
        until(lambda: markers.n_new_samples >= 3, 40, "markers through mne-lsl")
        codes = markers.get_data()[0].astype(int).ravel()
        assert set(codes[codes > 0].tolist()) <= {1, 2, 3, 4, 20, 21, 22, 23, 24, 100, 110}
        eeg.disconnect()
        markers.disconnect()


def lab_config(folder: Path) -> Path:
    path = folder / "lab.toml"
    path.write_text(
        f'recordings = "{(folder / "recordings").as_posix()}"\n[stimulus]\nheadless = true\n'
        "[calibration]\nn_blocks = 1\nmoves_per_block = 40\n",
        encoding="utf-8",
    )
    return path


def flatten(samples: np.ndarray) -> None:
    samples[:] = 7.0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (list, "No EEG stream"),
        (lambda: [ForeignAmplifier("AmpA"), ForeignAmplifier("AmpB")], "2 EEG streams fit"),
        (lambda: [ForeignAmplifier(unit=None)], "gives no unit"),
        (lambda: [ForeignAmplifier(labels=["Cz", "Cz"])], "not unique"),
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
        until(lambda: moves.of("SessionEnd"), 30, "the session's end", amplifier.play)
        until(lambda: stimulus.poll() is not None, 30, "the stimulus to end", amplifier.play)
    onsets = [stamp for stamp, message in moves.heard if message["type"] == "MoveOnset"]
    n_before = design(ChainConfig(), 250.0).n_before
    for onset, verdict in zip(onsets, verdicts.of("Verdict"), strict=True):
        assert verdict["outcome"] == "unjudged"
        assert verdict["clock_offset"] == pytest.approx(-AWAY_S, abs=2e-3)  # LSL measures it to 0.2 ms
        here = onset + verdict["clock_offset"]
        assert verdict["first_time"] + n_before / 250 == pytest.approx(here, abs=0.5 / 250 + 1e-9)


class Clenching:
    """F3 is off; and at two moves somebody clenches their jaw so hard that the epoch can't be judged."""

    def __init__(self) -> None:
        self.amplifier = ForeignAmplifier(spoil=self.spoil)
        self._resolver = pylsl.ContinuousResolver(
            pred="name='bci-stimulus' and starts-with(source_id,'bci-app/sub-')"  # bci-app's: no other test's stimulus
        )
        self._stimulus: Listener | None = None
        self._spoilt = 0
        self._left = 0  # samples still to be spoilt

    def play(self) -> None:
        if self._stimulus is None and (found := self._resolver.results()):
            self._stimulus = Listener("bci-stimulus", found[0].source_id().split("/")[1])
        elif self._stimulus is not None and self._spoilt < 2:
            n_moves = len(self._stimulus.of("MoveOnset"))
            if n_moves > 2 * self._spoilt + 1:
                self._spoilt, self._left = self._spoilt + 1, 125
        self.amplifier.play()

    def spoil(self, samples: np.ndarray) -> None:
        samples[:, 3] = np.nan
        spoilt, self._left = samples[: self._left], max(0, self._left - len(samples))
        spoilt[:, 5:9] += 3000 * np.sin(spoilt[:, :1] / 5)  # at 8 Hz


def test_a_bad_channel_is_repaired_a_rejected_move_repeated_and_both_replayed(tmp_path: Path) -> None:
    config = lab_config(tmp_path)
    config.write_text(config.read_text(encoding="utf-8").replace("= 40", "= 5"), encoding="utf-8")
    words = ("calibrate", "--participant", "P1", "--config", config, "--headless", "--json")
    participant = Clenching()
    with closing(participant.amplifier), process(*words) as running:
        until(lambda: running.poll() is not None, 150, "the calibration", participant.play)
        said, problems = running.communicate()
    assert running.returncode == 0, problems
    told = json.loads(said)
    assert told["verdicts"] == {"unjudged": 5, "rejected": 2}
    assert told["moves"] == 7
    assert any("Channel F3 is bad: not finite." in note for note in told["notes"])
    recording = read(Path(told["recording"]))
    decisions = [decision for _, decision in recording.of(Electrodes)]
    assert len(decisions) == len(recording.of(EpisodeStart))
    assert all(decision.bad["F3"] == ["not finite"] for decision in decisions)
    (end,) = [end for _, end in recording.of(BlockEnd)]
    assert end.n_moves == told["moves"]
    with process("replay", told["recording"], "--json") as replaying:
        counts = json.loads(replaying.communicate(timeout=60)[0])["replay"]
    assert counts["electrodes"] == counts["electrodes_equal"] == len(decisions)
    assert counts["verdicts"] == counts["verdicts_equal"] == told["moves"]


def named(folder: Path, stream: str) -> Path:
    """A configuration that takes one stream of several on the network."""
    path = folder / f"{stream}.toml"
    path.write_text(f'[eeg]\nstream_name = "{stream}"\n', encoding="utf-8")
    return path


def test_missing_channels_are_refused_and_reordered_ones_mended(tmp_path: Path, any_decoder: Path) -> None:
    all_but_one = [label for label in LABELS if label != "FCz"]
    otherwise = [label.upper() for label in reversed(LABELS)]
    words = ("doctor", "--model", any_decoder, "--json", "--config")
    with (
        closing(ForeignAmplifier("AmpC", labels=all_but_one)) as missing,
        closing(ForeignAmplifier("AmpD", labels=otherwise)) as shuffled,
        process(*words, named(tmp_path, "AmpC")) as refusing,
        process(*words, named(tmp_path, "AmpD")) as mending,
    ):

        def play() -> None:
            missing.play()
            shuffled.play()

        until(lambda: refusing.poll() is not None and mending.poll() is not None, 40, "both doctors", play)
        assert refusing.returncode == 2
        assert "missing: FCz" in refusing.communicate()[0]
        said = mending.communicate()
        assert mending.returncode == 0, said
        assert json.loads(said[0])["fit"]


def test_an_amplifier_that_fails_in_the_middle_ends_the_decoder(tmp_path: Path) -> None:
    """One drifts, one dies, and each decoder says which."""
    faults = {"drifts": (2, "drifted from 250 Hz"), "dies": (3, "No EEG sample")}
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

        until(lambda: all([heard.is_ready() for heard in verdicts.values()]), 40, "the decoders", play)
        amplifiers["drifts"].change_rate(240.0)
        until(
            lambda: all([decoder.poll() is not None for decoder in decoders.values()]),
            60,
            "the decoders to end",
            amplifiers["drifts"].play,
        )
        for fault, (code, says) in faults.items():
            assert decoders[fault].returncode == code
            assert says in decoders[fault].communicate()[1]
            assert any(note["level"] == "error" for note in verdicts[fault].of("Note"))


@pytest.mark.parametrize("moment", ["while starting", "while running"])
def test_ctrl_c_closes_the_recording(tmp_path: Path, moment: str) -> None:
    config = lab_config(tmp_path)
    words = ("calibrate", "--participant", "P1", "--config", config, "--simulate", "--speed", 20)
    folder = tmp_path / "recordings" / "sub-P1" / "ses-S001" / "eeg"
    sidecar = folder / "sub-P1_ses-S001_task-calibration_run-001_eeg.json"
    awaited = "starting" if moment == "while starting" else "recording"
    with process(*words) as running:
        until(lambda: sidecar.exists() and json.loads(sidecar.read_text())["state"] == awaited, 60, awaited)
        if moment == "while running":
            path = folder / "sub-P1_ses-S001_task-calibration_run-001_eeg.xdf"
            size = path.stat().st_size
            until(lambda: path.stat().st_size > size + 3_000_000, 60, "some seconds of EEG")
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 130
        assert "Traceback" not in running.communicate()[1]
    told = read_sidecar(sidecar.with_suffix(".xdf"))
    assert told["state"] == "closed"
    if moment == "while running":
        recording = read(sidecar.with_suffix(".xdf"))
        assert not recording.damage
        assert told["reason"] == "interrupted"
        assert [end.reason for _, end in recording.of(SessionEnd)] == ["interrupted"]
