"""The stimulus process: input, update, draw, flip, and only then the marker that says when the flip was.

It owns the world and the truth. Where flips wait for the screen, frames are counted: a change comes with the flip
nearest to when it is due. Elsewhere a round waits no longer than until the next change is due, so a jump is drawn when
it is due and not a frame later.
"""

from dataclasses import replace

from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.lsl import MarkerOutlet, MessageInlet, MessageOutlet, local_clock
from bci_app.peer import HEARTBEAT_S, Peer
from bci_app.protocol import (
    ACTIONS_STREAM,
    MARKERS,
    SESSION,
    STIMULUS,
    TRUTH,
    VERDICTS,
    Action,
    Command,
    LateFrame,
    Screen,
    SessionEnd,
    Status,
    Verdict,
    marker_code,
)
from stimulus.guide import Guide
from stimulus.keyboard import Keyboard
from stimulus.pace import Pace
from stimulus.paradigm import Paradigm
from stimulus.scene import Scene
from stimulus.screen import measure
from stimulus.view import View

FRAME_S = 1 / 60
"""Real seconds between two pictures of the running countdown where the screen doesn't pace the flips."""
POLL_S = 0.002
"""Longest real time between two looks at keyboard, commands and actions."""


def run(
    config: Config,
    clock: Clock,
    paradigm: Paradigm,
    commanded: bool,
    parent: int | None = None,
    returning: bool = False,
    guide: Guide | None = None,
) -> None:
    """Show one run.

    Parameters
    ----------
    paradigm : the run, ready to start; it knows its session.
    commanded : bci-app says when to begin; otherwise a key does, or, headless, the peers' being there.
    parent : process id of the program that started this one, if it must end with it.
    returning : the session has begun already, with a stimulus that is gone.
    guide : what the participant reads; checked on the screen before anything begins.

    Raises SetupError for a screen that isn't there, or a text that doesn't fit on it.
    """
    session = paradigm.session
    peer = Peer(STIMULUS, "stimulus", session, clock, parent)
    view = View(config.stimulus, f"ErrP {session}")
    try:
        if guide is not None and not config.stimulus.headless:
            view.check(guide.texts)
        shell = _Shell(config, peer, paradigm, view)
        shell.find_pace()
        shell.connect(commanded)
        if returning:
            shell.recall()
        if not commanded and config.stimulus.headless:
            shell.await_peers()
            paradigm.start(clock.now())
        while not paradigm.done:
            shell.frame()
        peer.linger()
    except KeyboardInterrupt:
        paradigm.stop(clock.now(), "interrupted", "The stimulus was interrupted.")
        shell.send()
        raise
    finally:
        view.close()


class _Shell:
    """The frame loop's connections and what it remembers from frame to frame."""

    def __init__(self, config: Config, peer: Peer, paradigm: Paradigm, view: View) -> None:
        self._config = config
        self._peer = peer
        self._clock = peer.clock
        self._paradigm = paradigm
        self._view = view
        self._truth = MessageOutlet(TRUTH, peer.session)
        self._markers = MarkerOutlet(MARKERS, peer.session)
        self._actions: MessageInlet | None = None
        self._verdicts: MessageInlet | None = None
        self._commands: MessageInlet | None = None
        self._keyboard = Keyboard(paradigm, peer.clock)
        self._shown: Scene | None = None
        self._drawn_at = 0.0
        self._since_flip_s = 0.0  # between the last two
        self._pace = Pace(FRAME_S, paced=False)
        # Faster than real time, or without a screen, no picture is ever due at a certain frame.
        self._counts_frames = peer.clock.speed == 1.0 and not config.stimulus.headless
        self._screen_note: str | None = None
        self._news: list[tuple[float, Screen | LateFrame]] = []  # what was seen, and is to be said
        self._held_since: float | None = None
        self._paused_for_action = False
        self._has_returned = False
        self._told_where_at = 0.0

    def find_pace(self) -> None:
        """Measure how the screen paces the flips, before anybody looks at it."""
        if self._counts_frames:
            flips = measure(self._view, self._paradigm.scene(self._clock.now()))
            self._pace = Pace(flips.interval_ms / 1e3 if flips.paced else FRAME_S, flips.paced)
            paced = "the screen paces them" if flips.paced else "nothing paces them"
            text = f"Flips {flips.interval_ms:.2f} ms apart (SD {flips.sd_ms:.2f}), {paced}; {self._view.driver}."
            self._screen_note = text

    def connect(self, commanded: bool) -> None:
        """Find whom this run listens to: the policy when moves come from outside, else the decoder; bci-app if it
        leads."""
        if self._paradigm.needs_actions:
            self._actions = self._peer.wait_for(ACTIONS_STREAM)
        if self._paradigm.needs_verdicts:
            self._verdicts = self._peer.wait_for(VERDICTS)
        if commanded:
            self._commands = self._peer.wait_for(SESSION)

    def await_peers(self) -> None:
        """Without bci-app and without a key, begin once decoder and policy say that they hear this process."""
        verdicts = self._verdicts or self._peer.wait_for(VERDICTS)
        for inlet in (verdicts, self._actions):
            while inlet is not None and not any(
                isinstance(item.message, Status) and item.message.state == "ready"
                for item in self._peer.hear(inlet, POLL_S)
            ):
                self._peer.say("waiting", "for decoder and policy to be ready")

    def recall(self) -> None:
        """Go on where a stimulus before this one ended."""
        self._paradigm.remember(self._peer.remember().said, self._clock.now())
        self._has_returned = True

    def frame(self) -> None:
        """Input, update, draw, flip, then the messages that tell of it, then wait for what comes next."""
        self._peer.say("ready" if self._paradigm.waiting_for == "start" else "running", self._paradigm.progress)
        self._hear()
        now = self._clock.now()
        ahead = self._pace.aim(now) - now if self._counts_frames else 0.0
        self._paradigm.update(now, ahead + self._pace.lead)
        self._hold(now)
        self._tell_where(now)
        has_flipped = self._show(self._paradigm.scene(now + ahead))
        self.send()
        self._wait(has_flipped)

    def send(self) -> None:
        """Publish what the paradigm has to say, each message with its own stamp.

        The message that makes a move known comes last: no move is known whose truth or marker was never sent.
        """
        messages = self._paradigm.take_messages()
        if any(isinstance(out.message, SessionEnd) for out in messages):
            self._tell_news()  # nothing comes after the end
        for out in messages:
            if out.stream == "truth":
                self._truth.push(out.message, out.stamp)
        for out in messages:
            if out.stream != "truth":
                code = marker_code(out.message)
                if code is not None:
                    self._markers.push(code, out.stamp)
                self._peer.push(out.message, out.stamp)
        self._tell_news()
        if self._screen_note and self._paradigm.waiting_for != "start":  # only now it is recorded
            self._peer.note("info", self._screen_note)
            self._screen_note = None

    def _tell_news(self) -> None:
        news, self._news = self._news, []
        for stamp, message in news:
            self._peer.push(message, stamp)

    def _hear(self) -> None:
        now = self._clock.now()
        for key in self._view.events():
            self._paused_for_action &= key != "pause"
            self._keyboard.pressed(key, now, commanded=self._commands is not None)
        for item in self._peer.hear(self._commands) if self._commands else ():
            match item.message:
                case Command(command="start"):
                    self._paradigm.start(now)
                case Command(command="pause", text=text, by_person=by_person):
                    self._paused_for_action &= not by_person
                    self._paradigm.pause(now, text, by_person)
                case Command(command="resume", by_person=True) if self._paradigm.is_paused_by_person:
                    self._paradigm.release(now)
                case Command(command="resume", by_person=False) if not self._paradigm.is_paused_by_person:
                    self._paradigm.resume(now)
                case Command(command="finish"):
                    self._paradigm.finish(now)
                case Command(command="stop"):
                    self._paradigm.stop(now, "interrupted", "Stopped by the experimenter.")
        for item in self._peer.hear(self._actions) if self._actions else ():
            if isinstance(item.message, Action):
                self._offer(item.message)
        for item in self._peer.hear(self._verdicts) if self._verdicts else ():
            if isinstance(item.message, Verdict):
                self._paradigm.take_verdict(item.message, now)

    def _offer(self, action: Action) -> None:
        refusal = self._paradigm.offer_action(action)
        if refusal is not None:
            self._peer.note("warning", f"Action refused: {refusal}")
        elif self._paused_for_action:
            self._paused_for_action = False
            self._paradigm.resume(self._clock.now())

    def _hold(self, now: float) -> None:
        """An action that is missing holds the countdown; when it stays away the run pauses and says why. Verdicts that
        are missing hold a block's end; when they stay away their moves aren't repeated."""
        waiting_for = self._paradigm.waiting_for
        if waiting_for != "resume":
            self._paused_for_action = False
        if waiting_for not in ("action", "verdict"):
            self._held_since = None
            return
        self._held_since = self._held_since or local_clock()
        hold_s = self._config.stimulus.hold_s
        if local_clock() - self._held_since <= hold_s:
            return
        if waiting_for == "verdict":
            n_missing = self._paradigm.miss_verdicts(now)
            self._peer.note("warning", f"No verdict from the decoder on {n_missing} moves for {hold_s:g} s.")
        else:
            reason = f"No action from the policy for {hold_s:g} s."
            self._peer.note("error", reason)
            self._paradigm.pause(now, reason)
            self._paused_for_action = True

    def _tell_where(self, now: float) -> None:
        """In a pause of a stimulus that took a dead one's place: whoever is started again later must hear it as well,
        and truth is told at no other time then."""
        is_due = self._has_returned and self._paradigm.waiting_for == "resume"
        if is_due and local_clock() - self._told_where_at >= HEARTBEAT_S:
            self._told_where_at = local_clock()
            self._paradigm.tell_where(now)

    def _show(self, scene: Scene) -> bool:
        """Draw what changed, of the running countdown no more than a frame's worth; whether there was something."""
        if scene == self._shown:
            return False
        only_countdown = self._shown is not None and replace(scene, countdown=self._shown.countdown) == self._shown
        if only_countdown and not self._pace.paced and local_clock() - self._drawn_at < FRAME_S:
            return False
        self._view.draw(scene)
        self._view.flip()
        onset = self._clock.now()
        before, self._shown, now = self._shown, scene, local_clock()
        self._since_flip_s, self._drawn_at = now - self._drawn_at, now
        is_jump = self._paradigm.awaiting_flip
        if is_jump:
            self._paradigm.flipped(onset)
        if self._counts_frames:
            late_ms = self._pace.flipped(onset, running=_is_running(scene))
            if late_ms is not None:
                self._tell_late(onset, late_ms, is_jump)
        if scene.screen is not None and (before is None or before.screen != scene.screen):
            self._news.append((onset, Screen(session=self._peer.session, name=scene.screen)))
        return True

    def _tell_late(self, at: float, late_ms: float, is_jump: bool) -> None:
        episode, step = self._paradigm.place
        late = LateFrame(session=self._peer.session, episode=episode, step=step if is_jump else None, late_ms=late_ms)
        self._news.append((at, late))

    def _wait(self, has_flipped: bool) -> None:
        waits = self._pace.paced and self._since_flip_s > self._pace.interval / 2  # a covered window's doesn't
        if has_flipped and waits and self._shown is not None and _is_running(self._shown):
            return  # the next flip waits for the screen
        due = self._paradigm.next_due()
        self._peer.rest(min(POLL_S, POLL_S if due is None else self._clock.real_until(due)))


def _is_running(scene: Scene) -> bool:
    """Whether another picture is to follow at the next flip; a full countdown waits for its action."""
    return scene.countdown is not None and scene.countdown < 1.0
