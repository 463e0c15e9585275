"""Conduct one run: start the processes, wait until all are ready, record, watch, and close in order.

bci-app touches no data in the loop. It listens to the processes' streams for progress, and tells the stimulus when to
begin and when to stop.
"""

import logging
import secrets
import signal
from collections.abc import Callable
from dataclasses import asdict, dataclass
from os import getpid
from pathlib import Path
from typing import Any, Literal

from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.crew import END_TIMEOUT_S, Crew
from bci_app.errors import LinkLost, SetupError
from bci_app.heard import Heard, Outcome
from bci_app.lookout import Look, Lookout, Seen
from bci_app.lsl import MessageInlet, describe, find_eeg, local_clock, session_clock
from bci_app.peer import Peer
from bci_app.progress import Progress
from bci_app.protocol import (
    ACTIONS_STREAM,
    AMPLIFIER_NOTES,
    MARKERS,
    SESSION,
    STIMULUS,
    TRUTH,
    VERDICTS,
    Command,
    Role,
    StreamSpec,
    simulated_source_id,
)
from bci_app.recorder import Recorder
from bci_app.recording import read
from bci_app.runs import Run, checksum, versions, write_sidecar, write_sums

READY_TIMEOUT_S = 90.0
"""Real seconds all processes may take to be ready (the slowest loads torch)."""
GROW_TIMEOUT_S = 10.0
"""Real seconds after which a file that doesn't grow is not being written."""
HEARTBEAT_TIMEOUT_S = 10.0
"""Real seconds without a word from a process that speaks every second: it hangs, or its machine is gone."""
LEAD_CYCLES = 4.5
"""EEG recorded before the first move, in periods of the chain's lowest frequency: its FIR is 3.3 long (MNE's rule)."""
LEAD_S = 8.0
"""Session seconds of EEG recorded before the first message, at least: the electrodes are judged on the last six."""
REJECTED_IN_A_ROW = 10
"""Moves in a row without a valid epoch after which going on would only waste the participant's time (decided)."""
ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
TAIL_S = 1.5
"""Real seconds between the last message and closing the file: LabRecorder writes in batches of half a second."""
STREAM_OF: dict[Role, StreamSpec] = {
    "stimulus": STIMULUS,
    "decoder": VERDICTS,
    "policy": ACTIONS_STREAM,
    "amplifier": AMPLIFIER_NOTES,
}
Task = Literal["calibration", "online"]


@dataclass(frozen=True)
class Plan:
    """Everything one run needs to know.

    Attributes
    ----------
    run : where its files go.
    config : resolved configuration.
    task, map, seed : what the stimulus shows.
    simulate : whether a simulated participant takes part; only then may `speed` differ from 1.
    model, policy : files of the decoder and of the policy; None in a calibration.
    told : what the policy is told of the decoder, as `bci_app.told.Told` in words.
    remote : roles started by hand on other machines.
    session : id the remote processes were started with; drawn when there are none.
    look : how to look at a calibration after each of its blocks.
    """

    run: Run
    config: Config
    task: Task
    map: str
    seed: int
    simulate: bool = False
    speed: float = 1.0
    model: Path | None = None
    policy: Path | None = None
    told: str | None = None
    remote: frozenset[Role] = frozenset()
    session: str | None = None
    look: Look | None = None

    @property
    def roles(self) -> tuple[Role, ...]:
        """The processes that take part."""
        roles: list[Role] = ["amplifier"] if self.simulate else []
        roles += ["decoder", "policy", "stimulus"] if self.task == "online" else ["decoder", "stimulus"]
        return tuple(roles)


def conduct(plan: Plan, progress: Progress) -> Outcome:
    """Conduct a run from start to closed and verified recording.

    Raises SetupError or LinkLost; KeyboardInterrupt passes through after everything is closed. In each case what was
    recorded until then is readable and its sidecar says how the run ended.
    """
    _log_to(plan.run.logs / "session.log")
    clock = session_clock(plan.speed)
    session = plan.session or f"{plan.run.stem.name}-{secrets.token_hex(3)}"
    config = _for_session(plan, session)
    conductor = _Conductor(plan, config, session, clock, progress)
    try:
        conductor.prepare()
        conductor.watch()
    except KeyboardInterrupt:
        conductor.interrupt()
        raise
    except (SetupError, LinkLost) as error:
        conductor.fail(str(error))
        raise
    finally:
        conductor.close()
    if conductor.missing:
        raise LinkLost(f"{plan.run.xdf} is not what was heard while it was recorded: {' '.join(conductor.missing)}")
    return conductor.outcome()


def _log_to(path: Path) -> None:
    """bci-app's own log goes where those of the processes are; what concerns the user is printed."""
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def _for_session(plan: Plan, session: str) -> Config:
    if not plan.simulate:
        return plan.config
    eeg = plan.config.eeg.model_copy(
        update={"stream_type": "EEG", "stream_name": None, "source_id": simulated_source_id(session)}
    )
    simulation = plan.config.simulation.model_copy(update={"run": plan.seed})
    calibration = plan.config.calibration.model_copy(update={"wait_for_key": False})
    return plan.config.model_copy(update={"eeg": eeg, "calibration": calibration, "simulation": simulation})


class _Conductor:
    """One run in progress."""

    def __init__(self, plan: Plan, config: Config, session: str, clock: Clock, progress: Progress) -> None:
        self.plan = plan
        self.config = config
        self.session = session
        self.clock = clock
        self.progress = progress
        self.peer = Peer(SESSION, "session", session, clock)
        self.crew = Crew(plan.run.logs)
        self.inlets: dict[Role, MessageInlet] = {}
        self.heard = Heard(plan.roles)
        self.recorder: Recorder | None = None
        self.sidecar: dict[str, Any] = {}
        self.last_word: dict[Role, float] = {}
        self.size = 0
        self.grew_at = 0.0
        self.lookout = Lookout(plan.look, plan.run.xdf, config) if plan.look else None
        self.blocks = 0
        self.seen: list[Seen] = []
        self.missing: list[str] = []
        """What was heard and is not in the file, in sentences; known once it is closed."""

    # Before the first move.

    def prepare(self) -> None:
        """Start everything, wait until every process is ready, then start recording and check that it grows.

        The first move's epoch reaches back some seconds, and those must be in the file too, or no replay were exact.
        """
        self._save_sidecar(state="starting")
        for role in self.plan.roles:
            if role not in self.plan.remote:
                self.crew.start(role, self._arguments(role))
        self._await(lambda: len(self.inlets) == len(self.plan.roles), self._connect, "processes to appear")
        self._await(self.heard.all_ready, lambda: None, "processes to be ready")
        self._record()
        lead_until = self.clock.now() + max(LEAD_CYCLES / self.config.chain.low_hz, LEAD_S)
        self._await(lambda: self.clock.now() > lead_until, lambda: None, "EEG before the first move")

    def _arguments(self, role: Role) -> list[str]:
        path = self.plan.run.logs / "config.json"
        if not path.exists():
            path.write_text(self.config.model_dump_json(indent=2), encoding="utf-8")
        arguments = ["--session", self.session, "--config", str(path), "--parent", str(getpid())]
        arguments += ["--speed", repr(self.clock.speed), "--origin", repr(self.clock.origin)]
        match role:
            case "stimulus":
                arguments += ["--task", self.plan.task, "--map", self.plan.map, "--seed", str(self.plan.seed)]
                arguments += ["--participant", self.plan.run.participant, "--commanded"]
            case "decoder" if self.plan.model is not None:
                arguments += ["--model", str(self.plan.model)]
            case "policy":
                arguments += ["--map", self.plan.map, "--policy", str(self.plan.policy)]
                arguments += ["--told", self.plan.told] if self.plan.told else []
        return arguments

    def _connect(self) -> None:
        for role in self.plan.roles:
            if role not in self.inlets:
                inlet = MessageInlet.find(STREAM_OF[role], self.session, timeout=1.0)
                if inlet is not None:
                    self.inlets[role] = inlet

    def _await(
        self, condition: Callable[[], bool], act: Callable[[], None], what: str, timeout: float = READY_TIMEOUT_S
    ) -> None:
        started = local_clock()
        while not condition():
            self.progress(f"waiting for {what}", 0, 1)
            act()
            self._listen(timeout=0.02)
            self.crew.check()
            if local_clock() - started > timeout:
                raise LinkLost(
                    f"Waited {timeout:g} s in vain for {what}: {self.heard.whereabouts()} "
                    f"Look into {self.plan.run.logs}; streams that don't find each other are a firewall's doing, or of "
                    "too many LSL sessions on one machine (ports 16572-16603)."
                )

    def _record(self) -> None:
        eeg = describe(find_eeg(self.config.eeg, timeout=5.0))
        specs = [STIMULUS, TRUTH, MARKERS, VERDICTS, SESSION]
        specs += [ACTIONS_STREAM] if self.plan.task == "online" else []
        specs += [AMPLIFIER_NOTES] if self.plan.simulate else []
        streams = [{"source_id": spec.source_id(self.session)} for spec in specs]
        streams.append({"name": eeg.name, "type": self.config.eeg.stream_type, "source_id": eeg.source_id})
        recorder = self.recorder = Recorder(self.plan.run.xdf, streams)
        recorder.start()
        size, self.grew_at = recorder.size(), local_clock()
        self._await(lambda: recorder.size() > size, lambda: None, f"{self.plan.run.xdf} to grow", GROW_TIMEOUT_S)
        self._save_sidecar(state="recording", eeg={"name": eeg.name, "sfreq": eeg.sfreq, "channels": eeg.channels})

    # While it runs.

    def watch(self) -> None:
        """Tell the stimulus to begin, then follow until its last message."""
        while self.heard.end is None:
            if self.heard.start is None:
                self.peer.push(Command(session=self.session, command="start"))
            self.peer.say("running")
            self._listen(timeout=0.1)
            self._check()
            self._look_ahead()
            what, done, total = self.heard.progress()
            self.progress(f"{what}, {self.seen[-1].short}" if self.seen and self.seen[-1].short else what, done, total)
        if self.heard.end.reason == "complete":
            self._await(self.heard.all_judged, lambda: None, "the last verdict", END_TIMEOUT_S)

    def _listen(self, timeout: float) -> None:
        for number, (role, inlet) in enumerate(self.inlets.items()):
            received = self.peer.hear(inlet, timeout if number == len(self.inlets) - 1 else 0.0)
            if received:
                self.last_word[role] = local_clock()
            for item in received:
                self.heard.take(item.message)

    def _look_ahead(self) -> None:
        """After each block of a calibration, tell what more would be worth; end it if that is little, and so wanted."""
        if self.lookout is None or self.heard.end is not None:
            return
        if self.heard.blocks > self.blocks and self.lookout.begin():
            self.blocks = self.heard.blocks
        seen = self.lookout.take()
        if seen is None:
            return
        self.seen.append(seen)
        self.peer.note("info", seen.sentence)
        if seen.is_clear and self.config.calibration.stop_when_clear:
            self.peer.note("info", "That is enough: the calibration ends after the block under way.")
            self.peer.push(Command(session=self.session, command="finish"))

    def _check(self) -> None:
        """Raise when something the run needs is lost, though nobody said so."""
        self.crew.check()
        now = local_clock()
        for role, spoke_at in self.last_word.items():
            if now - spoke_at > HEARTBEAT_TIMEOUT_S:
                raise LinkLost(
                    f"No word from the {role} process for {HEARTBEAT_TIMEOUT_S:g} s: it hangs or is cut off."
                )
        if self.recorder is None or not self.recorder.alive:
            raise LinkLost(f"LabRecorder died; {self.plan.run.xdf} holds what it had written until then.")
        size = self.recorder.size()
        if size > self.size:
            self.size, self.grew_at = size, now
        if now - self.grew_at > GROW_TIMEOUT_S:
            raise LinkLost(
                f"{self.plan.run.xdf} has stopped growing at {size} bytes: the disk is full or LabRecorder hangs."
            )
        if self.heard.rejected_in_a_row >= REJECTED_IN_A_ROW:
            raise LinkLost(
                f"The last {REJECTED_IN_A_ROW} moves gave no valid epoch ({self.heard.last_reason}). Look at the EEG."
            )

    # However it ends.

    def interrupt(self) -> None:
        """Ctrl-C: the stimulus says so in the record and ends; the rest follows in order."""
        self.heard.ending = ("interrupted", "Interrupted at bci-app.")
        self._stop_stimulus("Interrupted; closing the recording.")

    def fail(self, text: str) -> None:
        """Something is lost: say it in the record, and stop the stimulus if it still listens."""
        self.heard.ending = ("failed", text)
        self.peer.note("error", text)
        self._stop_stimulus(text)

    def _stop_stimulus(self, text: str) -> None:
        self.progress(text, 0, 1)
        started = local_clock()
        while self.heard.start is not None and self.heard.end is None and local_clock() - started < END_TIMEOUT_S:
            self.peer.push(Command(session=self.session, command="stop"))
            self._listen(timeout=0.1)
            if "stimulus" in self.crew.ended():
                return

    def close(self) -> None:
        """Let the recorder have the tail, close the file, end the processes, and write down how it ended."""
        # All of this is bounded in time; a second Ctrl-C would only leave a recording without its end.
        handlers = {number: signal.signal(number, signal.SIG_IGN) for number in ENDINGS}
        try:
            if self.recorder is not None and self.recorder.alive:
                self.peer.rest(TAIL_S)
                self.progress("closing the recording", 0, 1)
                self.recorder.stop()
        finally:
            if self.lookout is not None:
                self.lookout.close()
            self.inlets.clear()
            self.crew.end()
            self._save_sidecar(**self._closing())
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _closing(self) -> dict[str, Any]:
        path = self.plan.run.xdf
        told = asdict(self.outcome(), dict_factory=_plain) | {"state": "closed"}
        if not path.exists():
            return told
        self.progress("checking the recording", 0, 1)
        try:
            self.missing = self.heard.missing_in(read(path, True, self.config.eeg.stream_type))
        except SetupError as error:
            self.missing = [str(error)]
        write_sums(path)
        return told | {"sha256": checksum(path), "bytes": path.stat().st_size, "missing": self.missing}

    def outcome(self) -> Outcome:
        """How the run went, by what was heard."""
        return self.heard.outcome(self.plan.run.xdf, tuple(seen.sentence for seen in self.seen))

    def _save_sidecar(self, **news: Any) -> None:
        """The sidecar is there from the start, so that even a run that dies tells what it was."""
        if not self.sidecar:
            plan = self.plan
            self.sidecar = {
                "session": self.session,
                "task": plan.task,
                "participant": plan.run.participant,
                "map": plan.map,
                "seed": plan.seed,
                "simulated": plan.simulate,
                "speed": self.clock.speed,
                "model": _file(plan.model),
                "policy": _file(plan.policy),
                "told": plan.told,
                "config": self.config.model_dump(mode="json"),
                "versions": versions(),
            }
        self.sidecar |= news
        write_sidecar(self.plan.run.sidecar, self.sidecar)


def _file(path: Path | None) -> dict[str, str] | None:
    return {"path": str(path), "sha256": checksum(path)} if path else None


def _plain(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {key: str(value) if isinstance(value, Path) else value for key, value in items}
