"""Each process alone, against programs that know only docs/protocol.md; and whole runs that don't go smoothly."""

import json
import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pylsl
import pytest
from lsl_peers import ForeignAmplifier, ForeignStimulus, Listener, lab_config, process, until

from bci_app.gridworld import load_map
from bci_app.protocol import BlockEnd, Electrodes, EpisodeStart, SessionEnd
from bci_app.recording import read
from bci_app.runs import read_sidecar
from policy.cards import choose_told

TOLD = "0.7:0.8:0.2"  # hit, correct rejection, bits


MOVE = {"type": "MoveOnset", "episode": 0, "step": 1, "action": "east", "position": [5, 1], "sensed": [False] * 5}
GARBAGE = (
    "this is no message",
    "",
    "[" * 100_000,
    json.dumps({"protocol": 5, "session": "neighbour", **MOVE}),
    json.dumps({"protocol": 99, "session": "foreign", **MOVE}),
    json.dumps({"protocol": 5, "session": "foreign", **MOVE, "step": -1}),
)


@pytest.mark.trouble("liblsl #282: two labs on one network, or a stranger on our stream, and nobody is told")
def test_a_foreign_stimulus_works_with_our_decoder_and_policy_and_nobody_opens_the_truth(any_decoder: Path) -> None:
    """Decoder and policy answer a program built on docs/protocol.md; neither ever subscribes to the truth, hears the
    lab next door, or acts on what is no message of this session."""
    stimulus, neighbour = ForeignStimulus("foreign"), ForeignStimulus("neighbour")
    policy_file = choose_told(load_map("open")).path
    with (
        closing(ForeignAmplifier()) as amplifier,
        process("decoder", "--session", "foreign", "--model", any_decoder) as decoder,
        process("policy", "--session", "foreign", "--map", "open", "--policy", policy_file, "--told", TOLD) as policy,
    ):
        verdicts, actions = stimulus.listen("bci-verdicts"), stimulus.listen("bci-actions")
        until(lambda: verdicts.is_ready() and actions.is_ready(), 90, "decoder and policy", amplifier.play)
        layout = ["." * 11] * 11
        stimulus.say("SessionStart", task="online", participant="P", map="open", layout=layout, n_episodes=1)
        neighbour.walk(2, amplifier.play_for, every_s=0.1)
        for text in GARBAGE:
            stimulus.raw(text)
        cell, nothing = [5, 5], [False] * 5
        moves = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
        stimulus.say("EpisodeStart", episode=0, position=cell, sensed=nothing, max_steps=3)
        for step in (1, 2, 3):
            action = until(
                lambda step=step: [a for a in actions.of("Action") if a["step"] == step], 45, "action", amplifier.play
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
        until(lambda: decoder.poll() is not None and policy.poll() is not None, 45, "both to end", amplifier.play)
        assert (decoder.returncode, policy.returncode) == (0, 0), decoder.communicate()[1]
        assert len(actions.of("Action")) == 3  # none for a step after the limit
        told = [(kind, said["step"]) for _, said in actions.heard if (kind := said["type"]) in ("Action", "Belief")]
        assert told == [(kind, step) for step in (1, 2, 3) for kind in ("Action", "Belief")]  # no action waits for it
        assert all(len(belief["goal"]) == 121 for belief in actions.of("Belief"))
        refusals = [note["text"] for listener in (verdicts, actions) for note in listener.of("Note")]
        assert sum("Refused a sample on bci-stimulus" in text for text in refusals) == 2 * len(GARBAGE)
        assert [verdict["step"] for verdict in verdicts.of("Verdict")] == [1, 2, 3]


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


@pytest.mark.trouble("mne-realtime #41: strings are refused as markers")
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
        until(lambda: eeg.n_new_samples > 500, 60, "EEG through mne-lsl")
        assert np.isfinite(eeg.get_data(winsize=1)[0]).all()
        until(lambda: markers.n_new_samples >= 3, 90, "markers through mne-lsl")
        codes = markers.get_data()[0].astype(int).ravel()
        assert set(codes[codes > 0].tolist()) <= {1, 2, 3, 4, 20, 21, 22, 23, 24, 100, 110}
        eeg.disconnect()
        markers.disconnect()


class Clenching:
    """F3 is off; and at two moves somebody clenches their jaw so hard that the epoch can't be judged."""

    def __init__(self) -> None:
        self.amplifier = ForeignAmplifier(spoil=self.spoil)
        self._resolver = pylsl.ContinuousResolver(
            pred="name='bci-stimulus' and starts-with(source_id,'bci-app/sub-')"  # bci-app's: no other test's stimulus
        )
        self._stimulus: Listener | None = None
        self.clenched: list[int] = []  # at which moves, counted from 1
        self._left = 0  # samples still to be spoilt

    def play(self) -> None:
        if self._stimulus is None and (found := self._resolver.results()):
            self._stimulus = Listener("bci-stimulus", found[0].source_id().split("/")[1])
        elif self._stimulus is not None and len(self.clenched) < 2:
            n_moves = len(self._stimulus.of("MoveOnset"))
            onset = max((stamp for stamp, said in self._stimulus.heard if said["type"] == "MoveOnset"), default=0.0)
            # Never two moves running, nor one that a busy machine heard of too late to spoil what is judged, or for
            # which it has samples to catch up on.
            in_time = abs(self.amplifier.next_stamp - onset) < 0.3
            if n_moves > 1 + max(self.clenched, default=0) and in_time:
                self.clenched, self._left = [*self.clenched, n_moves], 125
        self.amplifier.play()

    def spoil(self, samples: np.ndarray) -> None:
        samples[:, 3] = np.nan
        spoilt, self._left = samples[: self._left], max(0, self._left - len(samples))
        spoilt[:, 5:9] += 3000 * np.sin(spoilt[:, :1] / 5)  # at 8 Hz


def test_a_bad_channel_is_repaired_a_rejected_move_repeated_and_both_replayed(tmp_path: Path) -> None:
    config = lab_config(tmp_path)
    config.write_text(config.read_text(encoding="utf-8").replace("= 40", "= 5"), encoding="utf-8")
    # A walk that stays in one episode: at the start of another the electrodes would be judged by the clenched jaw.
    words = ("calibrate", "--participant", "P1", "--config", config, "--headless", "--json", "--seed", 3)
    participant = Clenching()
    with closing(participant.amplifier), process(*words) as running:
        until(lambda: running.poll() is not None, 150, "the calibration", participant.play)
        said, problems = running.communicate()
    assert running.returncode == 0, problems
    told = json.loads(said)
    assert len(participant.clenched) == 2, "the machine was too busy for a move to be spoilt in time"
    assert told["verdicts"] == {"unjudged": 5, "rejected": 2}
    assert told["moves"] == 7
    assert any("Channel F3 is bad: not finite." in note for note in told["notes"])
    recording = read(Path(told["recording"]))
    decisions = [decision for _, decision in recording.of(Electrodes)]
    assert len(decisions) == len(recording.of(EpisodeStart)) == 1
    assert all(decision.bad["F3"] == ["not finite"] for decision in decisions)
    (end,) = [end for _, end in recording.of(BlockEnd)]
    assert end.n_moves == told["moves"]
    with process("replay", told["recording"], "--json") as replaying:
        counts = json.loads(replaying.communicate(timeout=60)[0])["replay"]
    assert counts["electrodes"] == counts["electrodes_equal"] == len(decisions)
    assert counts["verdicts"] == counts["verdicts_equal"] == told["moves"]


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
        said = running.communicate()[1]
        assert "Traceback" not in said
        assert ("--resume goes on" in said) == (moment == "while running")
    told = read_sidecar(sidecar.with_suffix(".xdf"))
    assert told["state"] == "closed"
    if moment == "while running":
        recording = read(sidecar.with_suffix(".xdf"))
        assert not recording.damage
        assert told["reason"] == "interrupted"
        assert [end.reason for _, end in recording.of(SessionEnd)] == ["interrupted"]
