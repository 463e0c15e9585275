"""The experiment as a state machine in session time: what is on the screen, what is sent, when it changes next.

It reads no clock and draws nothing. The shell asks `next_due`, calls `update`, draws `scene`, flips, reports a jump's
flip with `flipped`, and sends `take_messages`. One step (paper V.A.1) is countdown, jump, arrow, rest, counted from
the onset, which is the flip that showed the jump::

    READY (-> PAGE, PRACTICE) (-> EYES) -> LOOK -> COUNTDOWN -> JUMP -> ARROW -> REST -> COUNTDOWN ... -> DONE
                                             |    ^                        |
                                             HOLD-' (no action yet)        '-> LOOK (next episode) or BREAK -> KEY

A calibration's block goes on until it has its moves without those whose epochs were rejected: each of these is repeated
at the end of the block, by a move of the same kind (`stimulus.repeats`).

A paradigm that takes the place of one whose process died goes through what was said (`remember`) and is paused then.
How far the run is, is kept by `stimulus.course`; here is when it moves on.
"""

from collections.abc import Iterable
from typing import Literal, Self

from bci_app.config import Config, StimulusConfig
from bci_app.gridworld import GridWorld
from bci_app.protocol import Action, Continued, Note, Pause, Resume, RunSeed, Said, SessionEnd, Verdict
from stimulus.course import Course
from stimulus.episodes import FROM_THE_START, Begin, Plan, calibration_plan, online_plan
from stimulus.guide import Guide, has_person, opening_note, unguided
from stimulus.lead_in import LeadIn
from stimulus.phases import AT_ONCE, TIMED, Outbox, Outgoing, Phase
from stimulus.recollection import relive
from stimulus.scene import Scene, countdown_at
from stimulus.showing import move_scene, screen_of, text_scene


class Paradigm:
    """A whole run. Times are session seconds; `now` must not decrease from call to call.

    Onsets are stamped with their flip, and `photon_delay_ms` later where that is measured, everything else with the
    `now` of the call that brought it about.
    """

    def __init__(self, times: StimulusConfig, world: GridWorld, plan: Plan, guide: Guide | None = None) -> None:
        self.world = world
        self.session = plan.opening.session
        self._times, self._plan = times, plan
        guide = guide or unguided()
        self._texts = guide.texts
        self._course = Course(world, plan)
        self._outbox = Outbox()
        self._phase = Phase.READY
        self._due = 0.0
        self._lead_in = LeadIn(times, world, guide, plan.seed, plan.eye_movements_s)
        self._pause: Pause | None = None  # the last
        self._has_returned = False  # and not gone on yet
        self._last_said: tuple[Outgoing, ...] = ()
        self._pause_to_come: Pause | None = None
        self._paused_in = Phase.READY
        self._closing = "end"

    @classmethod
    def calibration(
        cls,
        cfg: Config,
        world: GridWorld,
        session: str,
        participant: str,
        seed: int,
        begin: Begin = FROM_THE_START,
        guide: Guide | None = None,
    ) -> Self:
        """A calibration run; a key ends the breaks where there is somebody to press it."""
        wait_for_key = has_person(cfg) and cfg.calibration.wait_for_key
        plan = calibration_plan(cfg.calibration, world, session, participant, seed, wait_for_key, begin)
        return cls(cfg.stimulus, world, plan, guide)

    @classmethod
    def online(
        cls,
        cfg: Config,
        world: GridWorld,
        session: str,
        participant: str,
        seed: int,
        begin: Begin = FROM_THE_START,
        guide: Guide | None = None,
    ) -> Self:
        """An online run; `seed` orders the episodes."""
        plan = online_plan(cfg.online, world, session, participant, seed, begin, has_person(cfg))
        return cls(cfg.stimulus, world, plan, guide)

    # What the shell asks.

    @property
    def done(self) -> bool:
        """True once SessionEnd is among the messages."""
        return self._phase is Phase.DONE

    @property
    def awaiting_flip(self) -> bool:
        """True when the scene shows a jump whose flip must be reported with `flipped`."""
        return self._phase is Phase.JUMP

    @property
    def waiting_for(self) -> Literal["start", "action", "verdict", "key", "resume"] | None:
        """What from outside the run waits for; None while time or a flip moves it on."""
        match self._phase:
            case Phase.READY:
                return "start"
            case Phase.HOLD:
                return "action"
            case Phase.VERDICT:
                return "verdict"
            case Phase.KEY | Phase.PAGE:
                return "key"
            case Phase.PAUSED:
                return "resume"
        return None

    @property
    def needs_actions(self) -> bool:
        """True for an online run, whose moves come from outside."""
        return self._plan.choose is None

    @property
    def needs_verdicts(self) -> bool:
        """True for a run in blocks, where moves whose epochs are rejected are repeated."""
        return self._course.has_blocks

    @property
    def progress(self) -> str:
        """How far the run is, for status lines."""
        return self._course.progress

    @property
    def place(self) -> tuple[int, int]:
        """The episode under way, or the last, and the steps made in it; episode -1 before the first."""
        return self._course.walk.number, self._course.walk.steps

    def next_due(self) -> float | None:
        """Session time of the next change that time brings; None while waiting for something else."""
        return self._due if self._phase in TIMED else None

    def take_messages(self) -> list[Outgoing]:
        """What must be sent now, in order; handed out once."""
        return self._outbox.take()

    def scene(self, now: float) -> Scene:
        """What belongs on the screen at `now`."""
        practised = self._lead_in.practice_scene(now, self._course.light) if self._phase is Phase.PRACTICE else None
        if practised is not None:
            return practised
        name = screen_of(self._phase, self._lead_in, self._course, self.is_paused_by_person, self._closing)
        if name is not None:
            return text_scene(name, self._texts, self.world, self._course)
        return move_scene(self._phase, self.world, self._course, self._countdown(now))

    def _countdown(self, now: float) -> float | None:
        if self._phase is Phase.HOLD:
            return 1.0
        if self._phase is not Phase.COUNTDOWN:
            return None
        return countdown_at(now, self._due, self._times.countdown_s)

    # What the shell reports.

    def start(self, now: float) -> None:
        """Begin; does nothing once begun."""
        if self._phase is not Phase.READY:
            return
        self._outbox.put(self._plan.opening, now)
        self._outbox.put(RunSeed(session=self.session, seed=self._plan.seed), now, "truth")
        if delay_ms := self._times.photon_delay_ms:
            self._note("info", opening_note(self._plan.opening, delay_ms), now)
        self._lead(self._lead_in.next(now), now)

    def key_start(self, now: float) -> None:
        """The key that turns a page or ends a break; does nothing before the break's shortest time is over."""
        if self._phase is Phase.KEY:
            self._begin_block(now)
        elif self._phase is Phase.PAGE:
            self._lead(self._lead_in.next(now), now)

    def update(self, now: float, lead: float = 0.0) -> None:
        """Go through everything due at `now` (or within `lead` s, for a picture that is shown only then), up to a jump:
        then draw the scene, flip, and report the flip."""
        while self._phase in TIMED and now + lead >= self._due:
            self._advance(now)

    def flipped(self, onset: float) -> None:
        """Report the flip that showed the jump: the onset, from which all times of this step count."""
        if not self.awaiting_flip:
            raise RuntimeError(f"expected a jump's flip only while awaiting_flip; found one in {self._phase.name}")
        self._outbox.put_pair(self._course.landed(), onset + self._times.photon_delay_ms / 1e3)
        self._wait(Phase.ARROW, onset + self._times.arrow_s)

    def offer_action(self, action: Action) -> str | None:
        """Take the policy's action for the coming move. None when taken, else a sentence why it is refused.

        The same action said twice, by a policy that was started again, is no trouble.
        """
        if self._course.is_known(action):
            return None
        problem = self._course.refusal(action, self.awaiting_flip)
        if problem is None:
            self._course.take_action(action)
            if self._phase is Phase.HOLD:
                self._phase = Phase.COUNTDOWN  # its time is over, so the next update jumps
        return problem

    def take_verdict(self, verdict: Verdict, now: float) -> None:
        """Hear whether a move's epoch is valid; one of this block that was rejected is repeated at its end."""
        sentence = self._course.judged(verdict)
        if sentence is not None:
            self._note("warning", sentence, now)
        self._after_verdict(now)

    def miss_verdicts(self, now: float) -> int:
        """Take those that stay away for valid; returns how many."""
        n_missing = self._course.miss_verdicts()
        self._after_verdict(now)
        return n_missing

    def pause(self, now: float, reason: str, by_person: bool = False) -> None:
        """Pause as soon as that spoils no epoch: at once, or after the move or break that is under way.

        Does nothing before the start, after the end, and in a pause, but that a person's pause stays one.
        """
        pause = Pause(session=self.session, reason=reason, by_person=by_person)
        if self._phase in AT_ONCE:
            self._enter_pause(now, pause)
        elif self._phase in (Phase.EYES, Phase.JUMP, Phase.ARROW, Phase.REST, Phase.BREAK):
            if self._pause_to_come is None or by_person:
                self._pause_to_come = pause
        elif self._phase is Phase.PAUSED and by_person and not self.is_paused_by_person:
            self._pause = pause
            self._outbox.put(pause, now)

    @property
    def is_paused_by_person(self) -> bool:
        """Whether only a person's key ends the pause, now or to come."""
        pause = self._pause if self._phase is Phase.PAUSED else self._pause_to_come
        return pause is not None and pause.by_person

    def release(self, now: float) -> None:
        """A person's pause is over as far as the person is concerned; `resume` goes on once all else is well."""
        if self._pause_to_come is not None:
            self._pause_to_come = self._pause_to_come.model_copy(update={"by_person": False})
        if self._phase is Phase.PAUSED and self.is_paused_by_person:
            self._pause = Pause(session=self.session, reason="The person is ready again.")
            self._outbox.put(self._pause, now)

    def resume(self, now: float) -> None:
        """Go on after a pause, with time to look and a full countdown; calls off a pause still to come."""
        self._pause_to_come = None
        if self._phase is not Phase.PAUSED:
            return
        if self._has_returned:  # once more: by now everybody hears it
            self._has_returned = False
            self.tell_where(now)
            self._outbox.again(self._last_said)
        self._outbox.put(Resume(session=self.session), now)
        match self._paused_in:
            case Phase.PAGE | Phase.PRACTICE | Phase.EYES:
                self._lead(self._lead_in.again(now), now)
            case Phase.KEY:
                self._phase = Phase.KEY
            case Phase.BREAK:
                self._after_break(now)
            case _ if self._course.is_undecided:
                self._phase = Phase.VERDICT
            case _ if not self._course.running:
                self._after_episode(now)
            case _ if reason := self._course.end_reason():
                self._end_episode(now, reason)
            case _:
                self._wait(Phase.LOOK, now + self._times.rest_s)

    def remember(self, said: Iterable[Said], now: float) -> None:
        """Take the place of a paradigm whose process died: go through what was said, and wait, paused, to go on.

        Chance goes on where it was; whoever died before the first block begins with the instructions again. Raises
        SetupError where what was said isn't of this run.
        """
        found = relive(self._course, said)
        self._outbox.not_before(found.last_stamp)
        self._phase, self._paused_in = found.phase, found.paused_in
        if self._phase is not Phase.PAUSED:
            return
        reason = "The stimulus was started again."
        self._pause = Pause(session=self.session, reason=reason, by_person=found.by_person)
        self._has_returned, self._last_said = True, found.last_said
        self.tell_where(now)
        self._outbox.put(self._pause, now)

    def tell_where(self, now: float) -> None:
        """Say after which move the run goes on, and its seed: what a stimulus announced that died before is void."""
        episode, steps = self.place
        step = steps if self._course.running else None
        self._outbox.put(Continued(session=self.session, episode=episode, step=step), now)
        self._outbox.put(RunSeed(session=self.session, seed=self._plan.seed), now, "truth")

    def finish(self, now: float) -> None:
        """Let the block or the online episode under way be the last; between two, the run is complete at once."""
        self._course.is_enough = True
        where = self._paused_in if self._phase is Phase.PAUSED else self._phase
        if where in (Phase.BREAK, Phase.KEY):
            self._complete(now)

    def stop(self, now: float, reason: Literal["interrupted", "failed"], text: str = "") -> None:
        """End the run at any moment; a jump whose flip was not reported has not happened."""
        if self._phase is Phase.DONE:
            return
        if self._course.running:
            self._outbox.put(self._course.end_episode("aborted"), now)
        self._closing = "stopped"
        self._outbox.put(SessionEnd(session=self.session, reason=reason, text=text), now)
        self._phase = Phase.DONE

    # How it moves on.

    def _advance(self, now: float) -> None:
        match self._phase:
            case Phase.PRACTICE:
                self._lead(self._lead_in.go_on(now), now)
            case Phase.LOOK:
                self._wait(Phase.COUNTDOWN, self._due + self._times.countdown_s)
            case Phase.COUNTDOWN:
                self._phase = Phase.JUMP if self._course.jump() else Phase.HOLD
            case Phase.ARROW:
                self._wait(Phase.REST, self._due + self._times.rest_s)
            case _ if self._pause_to_come is not None:
                self._enter_pause(now, self._pause_to_come)
            case Phase.EYES:
                self._lead(self._lead_in.go_on(now), now)
            case Phase.REST if self._course.is_undecided:
                self._phase = Phase.VERDICT
            case Phase.REST if reason := self._course.end_reason():
                self._end_episode(now, reason)
            case Phase.REST:
                self._wait(Phase.COUNTDOWN, self._due + self._times.countdown_s)
            case Phase.BREAK:
                self._after_break(now)

    def _wait(self, phase: Phase, due: float) -> None:
        self._phase, self._due = phase, due

    def _lead(self, phase: Phase, now: float) -> None:
        """On the way to the first part, and into it."""
        if phase is Phase.LOOK:
            self._begin_block(now)
            return
        if phase is Phase.EYES:
            self._note("info", f"Eye movements: {self._lead_in.eye_movement}.", now)
        self._wait(phase, self._lead_in.due)

    def _begin_block(self, now: float) -> None:
        start = self._course.begin_block()
        if start is not None:
            self._outbox.put(start, now)
        self._begin_episode(now)

    def _begin_episode(self, now: float) -> None:
        messages = self._course.begin_episode()
        if messages is None:
            self._complete(now)
            return
        self._outbox.put_pair(messages, now)
        self._wait(Phase.LOOK, now + self._times.rest_s)

    def _end_episode(self, now: float, reason: Literal["goal", "limit", "block"]) -> None:
        self._outbox.put(self._course.end_episode(reason), now)
        self._after_episode(now)

    def _after_episode(self, now: float) -> None:
        if self._course.is_block_over:
            self._outbox.put(self._course.end_block(), now)
            if not self._course.is_last:
                self._wait(Phase.BREAK, now + self._plan.break_s)
                return
        elif self._course.has_blocks or not self._course.is_last:
            if self._course.is_break_due:
                self._phase = Phase.KEY
            else:
                self._begin_episode(now)
            return
        self._complete(now)

    def _after_break(self, now: float) -> None:
        if self._course.is_last:
            self._complete(now)
        elif self._plan.wait_for_key:
            self._phase = Phase.KEY
        else:
            self._begin_block(now)

    def _after_verdict(self, now: float) -> None:
        if self._phase is Phase.VERDICT and not self._course.is_undecided:
            self._wait(Phase.REST, now)

    def _enter_pause(self, now: float, pause: Pause) -> None:
        self._pause, self._pause_to_come, self._paused_in = pause, None, self._phase
        self._phase = Phase.PAUSED
        self._outbox.put(pause, now)

    def _complete(self, now: float) -> None:
        self._outbox.put(SessionEnd(session=self.session, reason="complete"), now)
        self._phase = Phase.DONE

    def _note(self, level: Literal["info", "warning"], text: str, now: float) -> None:
        self._outbox.put(Note(session=self.session, role="stimulus", level=level, text=text), now)
