"""Conduct one run: start the processes, wait until all are ready, record, watch, and close in order.

bci-app touches no data in the loop. It listens to the processes' streams for progress, and tells the stimulus when to
begin and when to stop.
"""

import logging
import secrets
import signal
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

from bci_app.attention import Attention
from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.crew import END_TIMEOUT_S, Crew
from bci_app.errors import LinkLost, SetupError
from bci_app.heard import Heard, Outcome
from bci_app.links import Links
from bci_app.lookout import Lookout, Seen
from bci_app.lsl import LateInlet, MessageInlet, describe, find_eeg, local_clock, session_clock
from bci_app.peer import Peer
from bci_app.plan import Plan, Stage, arguments, described, for_session
from bci_app.progress import Progress
from bci_app.protocol import (
    ACTIONS_STREAM,
    AMPLIFIER_NOTES,
    CONSOLE,
    MARKERS,
    SESSION,
    STIMULUS,
    TRUTH,
    VERDICTS,
    Command,
    Note,
    Returned,
    Role,
)
from bci_app.recorder import Recorder
from bci_app.recording import Recording
from bci_app.runs import free_reserve, reserve, write_sidecar
from bci_app.set_up import check_stream
from bci_app.supervisor import STREAM_OF, Recorded, Supervisor
from bci_app.verifying import verify
from bci_app.vigil import GROW_TIMEOUT_S, Vigil
from bci_app.xdf import Follower

READY_TIMEOUT_S = 90.0
"""Real seconds all processes may take to be ready (the slowest loads torch)."""
RECORDED_WITHIN_S = 8.0
"""Real seconds until every stream that speaks has come into a new file: LabRecorder asks for clocks first."""
HALT_TIMEOUT_S = 10.0
"""Real seconds a move under way may take until the run is stopped without waiting for its end."""
LEAD_CYCLES = 4.5
"""EEG recorded before the first move, in periods of the chain's lowest frequency."""
LEAD_S = 8.0
"""Session seconds of EEG recorded before the first message, at least: the electrodes are judged on the last six."""
REJECTED_IN_A_ROW = 10
"""Moves in a row without a valid epoch after which going on would only waste the participant's time (decided)."""
ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
LINK_S = 1.0
"""Real seconds between two messages on the same link."""
TAIL_S = 1.5
"""Real seconds between the last message and closing the file: LabRecorder writes in batches of half a second."""


def conduct(plan: Plan, progress: Progress) -> tuple[Outcome, Recording]:
    """Conduct a run from start to closed and verified recording; how it went, and the recording as it was read back.

    Raises SetupError or LinkLost; KeyboardInterrupt passes through after everything is closed. In each case what was
    recorded until then is readable and its sidecar says how the run ended.
    """
    _log_to(plan.run.logs / "session.log")
    clock = session_clock(plan.speed)
    session = plan.session or f"{plan.run.stem.name}-{secrets.token_hex(3)}"
    config = for_session(plan, session)
    conductor = _Conductor(plan, config, session, clock, progress)
    failure: SetupError | LinkLost | None = None
    try:
        conductor.prepare()
        conductor.watch()
    except KeyboardInterrupt as interrupt:
        conductor.interrupt()
        if conductor.heard.start is not None:
            interrupt.args = (f"What was recorded until then is {plan.run.xdf}.",)
        raise
    except (SetupError, LinkLost) as error:
        conductor.fail(str(error))
        failure = error
    finally:
        conductor.close()
    if failure is not None:
        raise type(failure)(f"{failure} {conductor.verified}".strip()) from failure
    if conductor.missing:
        raise LinkLost(f"{plan.run.xdf} is not what was heard while it was recorded: {' '.join(conductor.missing)}")
    assert conductor.recording is not None, "what can't be read is missing"
    return conductor.outcome(), conductor.recording


def _log_to(path: Path) -> None:
    """bci-app's own log goes where those of the processes are; what concerns the user is printed."""
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


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
        self.console = LateInlet(CONSOLE, session)
        self.heard = Heard(plan.roles)
        self.links = Links(session, "session")
        self.attention = Attention(local_clock)
        self.linked_at = 0.0
        self.recorder: Recorder | None = None
        self.vigil: Vigil | None = None
        self.sidecar: dict[str, object] = {}
        self.follower = Follower(plan.run.xdf)
        self.supervisor = Supervisor(
            plan.roles,
            plan.remote,
            self._arguments,
            self.peer,
            self.crew,
            self.heard,
            self.follower,
            self.attention,
        )
        self.ended_at: float | None = None
        before = plan.goes_on.recordings if plan.goes_on else ()
        self.lookout = Lookout(plan.look, [*before, plan.run.xdf], config) if plan.look else None
        self.blocks = 0
        self.seen: list[Seen] = []
        self.verified = ""
        self.missing: list[str] = []
        """What was heard and is not in the file, in sentences; known once it is closed."""
        self.recording: Recording | None = None
        """The file, once it is closed."""

    def _lead_s(self, sfreq: float) -> float:
        """Session seconds of EEG that must be recorded before a pause ends: the rest comes until the next move."""
        from decoder.chain import look_back_s  # with SciPy, which no other process of the loop but the decoder's needs
        from decoder.timeline import MAX_JITTER

        stimulus = self.config.stimulus
        until_move = stimulus.rest_s + stimulus.countdown_s
        return max(0.0, look_back_s(self.config.chain, sfreq) - until_move) + MAX_JITTER

    # Before the first move.

    def prepare(self) -> None:
        """Start everything, wait until every process is ready, then start recording and check that it grows.

        The first move's epoch reaches back some seconds, and those must be in the file too, or no replay were exact.
        """
        for recording in self.plan.goes_on.recordings if self.plan.goes_on else ():
            free_reserve(recording)
        reserve(self.plan.run)
        self._save_sidecar(state="starting")
        for role in self.plan.roles:
            if role not in self.plan.remote:
                self.crew.start(role, self._arguments(role))
        self._await(lambda: len(self.inlets) == len(self.plan.roles), self._connect, "processes to appear")
        self._await(self.heard.all_ready, lambda: None, "processes to be ready")
        self._record()
        lead_until = self.clock.now() + max(LEAD_CYCLES / self.config.chain.low_hz, LEAD_S)
        self._await(
            lambda: self.clock.now() > lead_until and self.supervisor.may_begin,
            self.follower.look,
            "EEG before the first move",
        )

    def _arguments(self, role: Role) -> list[str]:
        path = self.plan.run.logs / "config.json"
        if not path.exists():
            path.write_text(self.config.model_dump_json(indent=2), encoding="utf-8")
        return ["--config", str(path), *arguments(self.plan, role, self.session, self.clock)]

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
            self.peer.say("waiting", f"for {what}")
            act()
            self._listen(timeout=0.02)
            self._disturb()
            self.supervisor.mend()
            if local_clock() - started > timeout:
                raise LinkLost(
                    f"Waited {timeout:g} s in vain for {what}: {self.heard.whereabouts()} "
                    f"Look into {self.plan.run.logs}; streams that don't find each other are a firewall's doing, or of "
                    "too many LSL sessions on one machine (ports 16572-16603)."
                )

    def _record(self) -> None:
        eeg = describe(find_eeg(self.config.eeg, timeout=5.0))
        if not self.plan.simulate:
            check_stream(self.config, eeg.name)
        specs = [STIMULUS, TRUTH, MARKERS, VERDICTS, SESSION]
        specs += [ACTIONS_STREAM] if self.plan.task == "online" else []
        specs += [AMPLIFIER_NOTES] if self.plan.simulate else []
        streams = [{"source_id": spec.source_id(self.session)} for spec in specs]
        streams.append({"name": eeg.name, "type": self.config.eeg.stream_type, "source_id": eeg.source_id})
        self.supervisor.eeg = Recorded(eeg.source_id, eeg.sfreq, eeg.fingerprint, self._lead_s(eeg.sfreq))
        recorder = self.recorder = Recorder(self.plan.run.xdf, streams)
        recorder.start()
        sources = [stream["source_id"] for stream in streams if stream["source_id"] not in self._silent_sources()]
        self._await(
            lambda: all(self.follower.n_samples[source] for source in sources),
            self.follower.look,
            f"all streams to come into {self.plan.run.xdf}",
            GROW_TIMEOUT_S + RECORDED_WITHIN_S,
        )
        self.vigil = Vigil(recorder, self.attention.now())
        self._save_sidecar(state="recording", eeg={"name": eeg.name, "sfreq": eeg.sfreq, "channels": eeg.channels})

    def _silent_sources(self) -> set[str]:
        """Source ids of streams on which nothing is said before the first move."""
        return {spec.source_id(self.session) for spec in (TRUTH, MARKERS)}

    # While it runs.

    def watch(self) -> None:
        """Tell the stimulus to begin, then follow until its last message; start again what dies."""
        while not self._is_over():
            if self.heard.start is None and self.supervisor.may_begin:
                self.peer.push(Command(session=self.session, command="start"))
            self.peer.say("running")
            self._listen(timeout=0.05)
            self._follow_console()
            self._disturb()
            self.supervisor.tend()
            self._check()
            self._look_ahead()
            what, done, total = self.heard.progress()
            what += f", {self.seen[-1].short}" if self.seen and self.seen[-1].short else ""
            what = f"{what}; {self.supervisor.waits_for}" if self.supervisor.waits_for else what
            what += f", silent: {' '.join(self.links.silent)}" if self.links.silent else ""
            self.progress(what, done, total)

    def _disturb(self) -> None:
        if self.plan.disturb is not None:
            self.plan.disturb(Stage(self.crew, self.recorder, self.heard, self.supervisor))

    def _is_over(self) -> bool:
        end = self.heard.end
        if end is None:
            return False
        now = self.attention.now()
        self.ended_at = max(self.ended_at or now, self.supervisor.mended_at)
        if end.reason != "complete" or self.heard.all_judged():
            return True
        if now - self.ended_at > END_TIMEOUT_S:
            raise LinkLost(f"Waited {END_TIMEOUT_S:g} s in vain for the last verdict: {self.heard.whereabouts()}")
        return False

    def _listen(self, timeout: float) -> None:
        for number, (role, inlet) in enumerate(self.inlets.items()):
            for item in self.peer.hear(inlet, timeout if number == len(self.inlets) - 1 else 0.0):
                self.links.take(inlet.name, self.attention.now())
                self.supervisor.take(role, item)
                self.heard.take(item.message)
        self._tell_links(self.attention.now())

    def _tell_links(self, now: float) -> None:
        for sentence in self.links.changes(now):
            self.peer.note("warning", sentence)
        if now - self.linked_at < LINK_S:
            return
        self.linked_at = now
        # Only of other machines: one of this is 0, and one whose process is gone can't be asked.
        known = [inlet for role, inlet in self.inlets.items() if role in self.plan.remote]
        offsets = {inlet.name: inlet.clock_correction() for inlet in known if inlet.name not in self.links.silent}
        for link in self.links.told(now, offsets):
            self.peer.push(link)

    def _follow_console(self) -> None:
        """Do what the experimenter asks for at the console, if there is one, and say so, for the record."""
        for item in self.console.pull():
            match item.message:
                case Command(command="pause" | "resume" | "finish" as command, text=text):
                    asked = Command(session=self.session, command=command, text=text, by_person=True)
                    self.supervisor.memory.take(self.clock.now(), asked)
                    self.peer.push(asked)
                case Note(level=level, text=text):
                    self.peer.push(Note(session=self.session, role="console", level=level, text=text))
                case Returned(role="console"):
                    self.peer.push(self.supervisor.memory.recall("console"))

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
            finish = Command(session=self.session, command="finish")
            self.supervisor.memory.take(self.clock.now(), finish)
            self.peer.push(finish)

    def _check(self) -> None:
        """Raise when something the run needs is lost for good, though nobody said so."""
        now = self.attention.now()
        self.follower.look()
        # Messages alone are written only when many kilobytes have come together.
        assert self.vigil is not None, "it is watched only once it is recorded"
        lost = self.vigil.lost(self.follower.n_bytes, now, may_stand=self.supervisor.lacks_eeg)
        if lost is not None:
            self._halt(lost)
        if self.heard.rejected_in_a_row >= REJECTED_IN_A_ROW:
            raise LinkLost(
                f"The last {REJECTED_IN_A_ROW} moves gave no valid epoch ({self.heard.last_reason}). Look at the EEG."
            )

    def _halt(self, text: str) -> NoReturn:
        """End the run at the next rest, rather than in the middle of a move."""
        self.peer.note("error", text)
        started = local_clock()
        while not (self.heard.is_paused or self.heard.end) and local_clock() - started < HALT_TIMEOUT_S:
            self.peer.push(Command(session=self.session, command="pause", text=text))
            self._listen(timeout=0.1)
            if "stimulus" in self.crew.ended():
                break
        raise LinkLost(text)

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
            free_reserve(self.plan.run.xdf)
        except SetupError as error:
            self.peer.note("error", str(error))
        try:
            if self.recorder is not None and self.recorder.alive:
                self.peer.rest(TAIL_S)
                self.progress("closing the recording", 0, 1)
                self.recorder.stop()
        finally:
            if self.lookout is not None:
                self.lookout.close()
            self.console.close()
            self.inlets.clear()
            self.crew.end()
            try:
                self._save_sidecar(**self._closing())
            except SetupError as error:  # the recording itself may be whole, and why the run ended matters more
                self.missing.append(str(error))
            self.peer.close()
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _closing(self) -> dict[str, Any]:
        path = self.plan.run.xdf
        found: dict[str, Any] = {}
        if path.exists():
            self.progress("checking the recording", 0, 1)
            is_ours = "stimulus" not in self.plan.remote
            finding = verify(path, self.heard, self.config.eeg.stream_type, is_ours)
            self.verified, self.missing, self.recording = finding.sentence, finding.missing, finding.recording
            found = {"sha256": finding.sha256, "bytes": path.stat().st_size, "missing": self.missing}
        return asdict(self.outcome(), dict_factory=_plain) | {"state": "closed"} | found

    def outcome(self) -> Outcome:
        """How the run went, by what was heard."""
        return self.heard.outcome(self.plan.run.xdf, self.verified, tuple(seen.sentence for seen in self.seen))

    def _save_sidecar(self, **news: Any) -> None:
        """The sidecar is there from the start, so that even a run that dies tells what it was."""
        if not self.sidecar:
            self.sidecar = described(self.plan, self.config, self.session, self.clock)
        self.sidecar |= news
        write_sidecar(self.plan.run.sidecar, self.sidecar)


def _plain(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {key: str(value) if isinstance(value, Path) else value for key, value in items}
