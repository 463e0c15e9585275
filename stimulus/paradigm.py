"""The experiment as a state machine in session time: what is on the screen, what is sent, when it changes next.

It reads no clock and draws nothing. The shell asks `next_due`, calls `update`, draws `scene`, flips, reports a jump's
flip with `flipped`, and sends `take_messages`. One step (paper V.A.1) is countdown, jump, arrow, rest, counted from
the onset, which is the flip that showed the jump::

    READY (-> EYES) -> LOOK -> COUNTDOWN -> JUMP -> ARROW -> REST -> COUNTDOWN ... -> DONE
                               |    ^                        |
                               HOLD-' (no action yet)        '-> LOOK (next episode), or BREAK -> KEY -> LOOK

A calibration's block goes on until it has its moves without those whose epochs were rejected: each of these is repeated
at the end of the block, by a move of the same kind (`stimulus.repeats`).

A paradigm that takes the place of one whose process died goes through what was said (`remember`) and is paused then.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Literal, Self

from bci_app.config import Config, StimulusConfig
from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, GridWorld
from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    Command,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeStart,
    Message,
    MoveOnset,
    Note,
    Pause,
    Resume,
    RunSeed,
    Said,
    SessionEnd,
    SessionStart,
    Verdict,
)
from stimulus.episodes import FROM_THE_START, Begin, Plan, Walk, calibration_plan, online_plan
from stimulus.repeats import Repeats
from stimulus.scene import Scene

WELCOME = "Watch the red agent on its way to the green goal.\nJudge every move in silence: right or wrong?"
COMPLETE = "Done. Thank you!"
STOPPED = "The session has ended."
LINK_PAUSE = "Pause\nSomething technical. Please wait: it goes on by itself."
EYE_MOVEMENTS = ("Blink", "Look left and right", "Look up and down")


@dataclass(frozen=True)
class Outgoing:
    """A message to send, on which stream, with which stamp (session seconds)."""

    stream: Literal["stimulus", "truth"]
    message: Message
    stamp: float


class Phase(Enum):
    """Where in the paradigm we are."""

    READY = auto()  # until `start`
    EYES = auto()  # the person moves the eyes as told, for the decoder to learn what that looks like
    LOOK = auto()  # a new episode is on the screen: time to find agent and goal
    COUNTDOWN = auto()
    HOLD = auto()  # the countdown is full, the action missing
    JUMP = auto()  # the scene shows the jump, its flip is not reported yet
    ARROW = auto()
    REST = auto()
    VERDICT = auto()  # the block has all its moves, but whether one must be repeated isn't known yet
    BREAK = auto()
    KEY = auto()  # a key may end the break
    PAUSED = auto()
    DONE = auto()


_TIMED = (Phase.EYES, Phase.LOOK, Phase.COUNTDOWN, Phase.ARROW, Phase.REST, Phase.BREAK)


class Paradigm:
    """A whole run. Times are session seconds; `now` must not decrease from call to call.

    Onsets are stamped with their flip, everything else with the `now` of the call that brought it about.
    """

    def __init__(self, times: StimulusConfig, world: GridWorld, plan: Plan) -> None:
        self.world = world
        self._times = times
        self._plan = plan
        self.session = plan.opening.session
        self._phase = Phase.READY
        self._due = 0.0
        self._out: list[Outgoing] = []
        self._last_stamp = float("-inf")
        self._block, self._block_moves = plan.begin.block, 0
        self._moves = 0  # without those that must be repeated
        self._repeats = Repeats(plan.moves_per_block)
        self._walk = Walk(
            world, self.session, number=plan.begin.episode - 1, cell=0, goal=0, max_steps=0
        )  # until one begins
        self._running = False
        self._is_enough = False  # no block is to come after the one under way
        self._eye_task = -1
        self._action: int | None = None  # of the coming move
        self._last_action: tuple[int, int, str] | None = None  # episode, step and what it is
        self._pause: Pause | None = None  # the last
        self._has_returned = False  # and not gone on yet
        self._pause_to_come: Pause | None = None
        self._paused_in = Phase.READY
        self._closing_text = COMPLETE

    @classmethod
    def calibration(
        cls, cfg: Config, world: GridWorld, session: str, participant: str, seed: int, begin: Begin = FROM_THE_START
    ) -> Self:
        """A calibration run; a key ends the breaks where there is a window to press it in."""
        wait = cfg.calibration.wait_for_key and not cfg.stimulus.headless
        plan = calibration_plan(cfg.calibration, world, session, participant, seed, wait, begin)
        return cls(cfg.stimulus, world, plan)

    @classmethod
    def online(
        cls, cfg: Config, world: GridWorld, session: str, participant: str, seed: int, begin: Begin = FROM_THE_START
    ) -> Self:
        """An online run; `seed` orders the episodes."""
        return cls(cfg.stimulus, world, online_plan(cfg.online, world, session, participant, seed, begin))

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
            case Phase.KEY:
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
        return self._repeats.is_on

    @property
    def progress(self) -> str:
        """How far the run is, for status lines."""
        opening = self._plan.opening
        if opening.n_moves is not None:
            return f"{self._moves} of {opening.n_moves} moves"
        return f"episode {self._walk.number + 1} of {opening.n_episodes}, {self._walk.steps} moves"

    def next_due(self) -> float | None:
        """Session time of the next change that time brings; None while waiting for something else."""
        return self._due if self._phase in _TIMED else None

    def take_messages(self) -> list[Outgoing]:
        """What must be sent now, in order; handed out once."""
        out, self._out = self._out, []
        return out

    def scene(self, now: float) -> Scene:
        """What belongs on the screen at `now`."""
        text = self._text()
        if text is not None:
            return Scene(self.world, text=text)
        arrow = self._walk.last_move if self._phase in (Phase.JUMP, Phase.ARROW) else None
        return Scene(
            self.world, self._walk.cell, self._walk.goal, self._countdown(now), arrow, moved=self.awaiting_flip
        )

    def _countdown(self, now: float) -> float | None:
        if self._phase is Phase.HOLD:
            return 1.0
        if self._phase is not Phase.COUNTDOWN:
            return None
        left = (self._due - now) / self._times.countdown_s if self._times.countdown_s else 0.0
        return min(1.0, max(0.0, 1.0 - left))

    def _text(self) -> str | None:
        blocks = f"Break\n{self._block} of {self._plan.n_blocks} blocks are done."
        match self._phase:
            case Phase.READY:
                return WELCOME
            case Phase.EYES:
                return f"{EYE_MOVEMENTS[self._eye_task]}\nagain and again, and keep your head still."
            case Phase.BREAK:
                return f"{blocks}\nRelax, and move if you like."
            case Phase.KEY:
                return f"{blocks}\nPress space when you are ready."
            case Phase.PAUSED:
                return "Pause" if self.is_paused_by_person else LINK_PAUSE
            case Phase.DONE:
                return self._closing_text
        return None

    # What the shell reports.

    def start(self, now: float) -> None:
        """Begin; does nothing once begun."""
        if self._phase is Phase.READY:
            self._send(self._plan.opening, now)
            self._send(RunSeed(session=self.session, seed=self._plan.seed), now, "truth")
            self._next_eye_movement(now)

    def key_start(self, now: float) -> None:
        """The key that ends a break; does nothing before the break's shortest time is over."""
        if self._phase is Phase.KEY:
            self._begin_block(now)

    def update(self, now: float) -> None:
        """Go through everything due at `now`, up to a jump: then draw the scene, flip, and report the flip."""
        while self._phase in _TIMED and now >= self._due:
            self._advance(now)

    def flipped(self, onset: float) -> None:
        """Report the flip that showed the jump: the onset, from which all times of this step count."""
        if not self.awaiting_flip:
            raise RuntimeError(f"expected a jump's flip only while awaiting_flip; found one in {self._phase.name}")
        self._walk.steps += 1
        self._moves += 1
        self._block_moves += 1
        onset_message, truth = self._walk.move_messages()
        self._repeats.made((truth.episode, truth.step), truth.error)
        self._send_pair((onset_message, truth), onset)
        self._wait(Phase.ARROW, onset + self._times.arrow_s)

    def offer_action(self, action: Action) -> str | None:
        """Take the policy's action for the coming move. None when taken, else a sentence why it is refused.

        The same action said twice, by a policy that was started again, is no trouble.
        """
        if action.session == self.session and (action.episode, action.step, action.action) == self._last_action:
            return None
        problem = self._refusal(action)
        if problem is None:
            self._take_action(action)
            if self._phase is Phase.HOLD:
                self._phase = Phase.COUNTDOWN  # its time is over, so the next update jumps
        return problem

    def _take_action(self, action: Action) -> None:
        self._action = ACTIONS.index(action.action)
        self._last_action = action.episode, action.step, action.action

    def take_verdict(self, verdict: Verdict, now: float) -> None:
        """Hear whether a move's epoch is valid; one of this block that was rejected is repeated at its end."""
        found = self._repeats.judged((verdict.episode, verdict.step), verdict.outcome)
        if found == "known":
            return
        self._moves -= found in ("again", "last")
        if found == "last":
            most = self._repeats.most
            text = f"{most} moves of block {self._block} had to be repeated; no more will be. Look at the electrodes."
            self._send(Note(session=self.session, role="stimulus", level="warning", text=text), now)
        self._after_verdict(now)

    def miss_verdicts(self, now: float) -> int:
        """Take those that stay away for valid; returns how many."""
        n_missing = self._repeats.give_up()
        self._after_verdict(now)
        return n_missing

    def pause(self, now: float, reason: str, by_person: bool = False) -> None:
        """Pause as soon as that spoils no epoch: at once, or after the move or break that is under way.

        Does nothing before the start, after the end, and in a pause, but that a person's pause stays one.
        """
        pause = Pause(session=self.session, reason=reason, by_person=by_person)
        if self._phase in (Phase.LOOK, Phase.COUNTDOWN, Phase.HOLD, Phase.VERDICT, Phase.KEY):
            self._enter_pause(now, pause)
        elif self._phase in (Phase.EYES, Phase.JUMP, Phase.ARROW, Phase.REST, Phase.BREAK):
            if self._pause_to_come is None or by_person:
                self._pause_to_come = pause
        elif self._phase is Phase.PAUSED and by_person and not self.is_paused_by_person:
            self._pause = pause
            self._send(pause, now)

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
            self._send(self._pause, now)

    def resume(self, now: float) -> None:
        """Go on after a pause, with time to look and a full countdown; calls off a pause still to come."""
        self._pause_to_come = None
        if self._phase is not Phase.PAUSED:
            return
        if self._has_returned:  # once more: by now everybody hears it
            self._has_returned = False
            self.tell_where(now)
        self._send(Resume(session=self.session), now)
        if self._paused_in is Phase.EYES:
            self._next_eye_movement(now)
        elif self._paused_in is Phase.BREAK:
            self._after_break(now)
        elif self._paused_in is Phase.KEY:
            self._phase = Phase.KEY
        elif self._is_undecided():
            self._phase = Phase.VERDICT
        elif not self._running:
            self._after_episode(now)
        elif reason := self._end_reason():
            self._end_episode(now, reason)
        else:
            self._wait(Phase.LOOK, now + self._times.rest_s)

    def remember(self, said: Iterable[Said], now: float) -> None:
        """Take the place of a paradigm whose process died: go through what was said, and wait, paused, to go on.

        Chance goes on where it was. Raises SetupError where what was said isn't of this run.
        """
        actions: dict[tuple[int, int], Action] = {}
        before: Pause | None = None
        for item in said:
            if not isinstance(item.message, Verdict | Action | Electrodes | Command):  # those are of other clocks
                self._last_stamp = max(self._last_stamp, item.stamp)
            match item.message:
                case SessionStart():
                    self._phase, self._paused_in = Phase.PAUSED, Phase.EYES
                case BlockStart() as block:
                    self._paused_in = Phase.REST
                    self._begin_count(block.block)
                case EpisodeStart() as start:
                    self._paused_in = Phase.REST
                    self._remember_start(start)
                case MoveOnset() as onset:
                    self._remember_move(onset)
                case Verdict() as verdict:
                    found = self._repeats.judged((verdict.episode, verdict.step), verdict.outcome)
                    self._moves -= found in ("again", "last")
                case Action() as action:
                    actions[action.episode, action.step] = action
                case EpisodeEnd():
                    self._running = False
                case BlockEnd() as block:
                    self._block, self._paused_in = block.block + 1, Phase.BREAK
                case Pause() as pause:
                    before = pause
                case Resume():
                    before = None
                case Command(command="finish"):
                    self._is_enough = True
                case SessionEnd():
                    self._phase = Phase.DONE
        if self._phase is not Phase.PAUSED:
            return
        reason = "The stimulus was started again."
        by_person = before is not None and before.by_person
        self._pause = Pause(session=self.session, reason=reason, by_person=by_person)
        action_to_come = actions.get((self._walk.number, self._walk.steps + 1))
        if self._running and action_to_come is not None and not self._end_reason():
            self._take_action(action_to_come)
        self._has_returned = True
        self.tell_where(now)
        self._send(self._pause, now)

    def tell_where(self, now: float) -> None:
        """Say after which move the run goes on, and its seed: what a stimulus announced that died before is void."""
        step = self._walk.steps if self._running else None
        self._send(Continued(session=self.session, episode=self._walk.number, step=step), now)
        self._send(RunSeed(session=self.session, seed=self._plan.seed), now, "truth")

    def _remember_start(self, start: EpisodeStart) -> None:
        episode = next(self._plan.episodes, None)
        if episode is None or self._walk.position(episode.start) != start.position:
            raise SetupError(
                f"Episode {start.episode} of the session began at {start.position}, which isn't what this stimulus's "
                "seed, map and configuration give. Start it with those of the one before."
            )
        self._running = True
        self._walk = Walk(self.world, self.session, start.episode, episode.start, episode.goal, start.max_steps)

    def _remember_move(self, onset: MoveOnset) -> None:
        if self._plan.choose is not None:
            self._plan.choose(self._walk.cell, self._walk.goal, self._kind_to_repeat())
        self._walk.go(ACTIONS.index(onset.action))
        self._walk.steps = onset.step
        self._moves += 1
        self._block_moves += 1
        self._repeats.made((onset.episode, onset.step), self._walk.was_error())

    def finish(self, now: float) -> None:
        """Let the block under way be the last, or online the episode; between two, the run is complete at once."""
        self._is_enough = True
        where = self._paused_in if self._phase is Phase.PAUSED else self._phase
        if where in (Phase.BREAK, Phase.KEY):
            self._complete(now)

    def stop(self, now: float, reason: Literal["interrupted", "failed"], text: str = "") -> None:
        """End the run at any moment; a jump whose flip was not reported has not happened."""
        if self._phase is Phase.DONE:
            return
        if self._running:
            self._send_episode_end(now, "aborted")
        self._closing_text = STOPPED
        self._send(SessionEnd(session=self.session, reason=reason, text=text), now)
        self._phase = Phase.DONE

    # How it moves on.

    def _advance(self, now: float) -> None:
        match self._phase:
            case Phase.LOOK:
                self._wait(Phase.COUNTDOWN, self._due + self._times.countdown_s)
            case Phase.COUNTDOWN:
                self._jump()
            case Phase.ARROW:
                self._wait(Phase.REST, self._due + self._times.rest_s)
            case _ if self._pause_to_come is not None:
                self._enter_pause(now, self._pause_to_come)
            case Phase.EYES:
                self._next_eye_movement(now)
            case Phase.REST if self._is_undecided():
                self._phase = Phase.VERDICT
            case Phase.REST if reason := self._end_reason():
                self._end_episode(now, reason)
            case Phase.REST:
                self._wait(Phase.COUNTDOWN, self._due + self._times.countdown_s)
            case Phase.BREAK:
                self._after_break(now)

    def _wait(self, phase: Phase, due: float) -> None:
        self._phase, self._due = phase, due

    def _jump(self) -> None:
        if self._plan.choose is not None:
            self._action = self._plan.choose(self._walk.cell, self._walk.goal, self._kind_to_repeat())
        if self._action is None:
            self._phase = Phase.HOLD
            return
        self._walk.go(self._action)
        self._action = None
        self._phase = Phase.JUMP

    def _end_reason(self) -> Literal["goal", "limit", "block"] | None:
        return self._walk.over() or ("block" if self._is_block_over() else None)

    def _kind_to_repeat(self) -> bool | None:
        """Whether the next move must be an error; None while it needn't repeat another."""
        return self._repeats.take() if self._is_block_full() else None

    def _is_block_full(self) -> bool:
        """Whether the block has all its moves, if none must be repeated."""
        per_block = self._plan.moves_per_block
        return per_block is not None and self._block_moves >= per_block

    def _is_block_over(self) -> bool:
        """Whether it also has those that must be repeated by what is known so far."""
        return self._is_block_full() and not self._repeats.any_left

    def _is_undecided(self) -> bool:
        return self._is_block_over() and self._repeats.is_undecided

    def _after_verdict(self, now: float) -> None:
        if self._phase is Phase.VERDICT and not self._is_undecided():
            self._wait(Phase.REST, now)

    def _next_eye_movement(self, now: float) -> None:
        """Ask for the next, or begin the first block after the last."""
        self._eye_task += 1
        if self._eye_task >= len(EYE_MOVEMENTS) or not self._plan.eye_movements_s:
            self._begin_block(now)
            return
        task = EYE_MOVEMENTS[self._eye_task]
        self._send(Note(session=self.session, role="stimulus", level="info", text=f"Eye movements: {task}."), now)
        self._wait(Phase.EYES, now + self._plan.eye_movements_s / len(EYE_MOVEMENTS))

    def _begin_block(self, now: float) -> None:
        self._begin_count(self._block)
        if self._plan.moves_per_block is not None:
            n_moves = self._plan.moves_per_block - self._block_moves
            self._send(BlockStart(session=self.session, block=self._block, n_moves=n_moves), now)
        self._begin_episode(now)

    def _begin_count(self, block: int) -> None:
        """Of the moves of a block, which may have some from a run before."""
        begin = self._plan.begin
        self._block, self._block_moves = block, begin.moves_done if block == begin.block else 0
        self._repeats.begin()

    def _begin_episode(self, now: float) -> None:
        episode = next(self._plan.episodes, None)
        if episode is None:
            self._complete(now)
            return
        number = self._walk.number + 1
        self._running = True
        self._walk = Walk(self.world, self.session, number, episode.start, episode.goal, self._plan.max_steps)
        self._send_pair(self._walk.start_messages(), now)
        self._wait(Phase.LOOK, now + self._times.rest_s)

    def _end_episode(self, now: float, reason: Literal["goal", "limit", "block"]) -> None:
        self._send_episode_end(now, reason)
        self._after_episode(now)

    def _after_episode(self, now: float) -> None:
        if self._is_enough and self._plan.moves_per_block is None:
            self._complete(now)
            return
        if not self._is_block_over():
            self._begin_episode(now)
            return
        self._send(BlockEnd(session=self.session, block=self._block, n_moves=self._block_moves), now)
        self._block += 1
        if self._is_last_block():
            self._complete(now)
        else:
            self._wait(Phase.BREAK, now + self._plan.break_s)

    def _send_episode_end(self, now: float, reason: Literal["goal", "limit", "block", "aborted"]) -> None:
        self._running = False
        self._send(self._walk.end_message(reason), now)

    def _is_last_block(self) -> bool:
        return self._block == self._plan.n_blocks or self._is_enough

    def _after_break(self, now: float) -> None:
        if self._is_last_block():
            self._complete(now)
        elif self._plan.wait_for_key:
            self._phase = Phase.KEY
        else:
            self._begin_block(now)

    def _enter_pause(self, now: float, pause: Pause) -> None:
        self._pause, self._pause_to_come, self._paused_in = pause, None, self._phase
        self._phase = Phase.PAUSED
        self._send(pause, now)

    def _complete(self, now: float) -> None:
        self._send(SessionEnd(session=self.session, reason="complete"), now)
        self._phase = Phase.DONE

    # What it tells.

    def _refusal(self, action: Action) -> str | None:
        found = f"found an action for step {action.step} of episode {action.episode}"
        if self._plan.choose is not None:
            return f"expected no action in a calibration; {found}"
        if action.session != self.session:
            return f"expected session '{self.session}'; {found} of session '{action.session}'"
        if not self._running or self._end_reason() or self.awaiting_flip:
            return f"expected no action now ({self.progress}); {found}"
        step = self._walk.steps + 1
        if (action.episode, action.step) != (self._walk.number, step):
            return f"expected an action for step {step} of episode {self._walk.number}; {found}"
        if self._action is not None:
            return f"step {step} of episode {self._walk.number} has its action, {ACTIONS[self._action]}; {found} again"
        if not self.world.legal[self._walk.cell, ACTIONS.index(action.action)]:
            where = self._walk.position(self._walk.cell)
            return f"expected a legal action; {found}: {action.action} of {where} is no free cell"
        return None

    def _send_pair(self, messages: tuple[Message, Message], stamp: float) -> None:
        """A message and what the truth stream says at the same time."""
        self._send(messages[0], stamp)
        self._send(messages[1], stamp, "truth")

    def _send(self, message: Message, stamp: float, stream: Literal["stimulus", "truth"] = "stimulus") -> None:
        # A flip may be dated a little after the `now` that follows it: stamps must still not decrease. Onsets, the
        # latest time there is when they are reported, are never changed by this.
        stamp = self._last_stamp = max(stamp, self._last_stamp)
        self._out.append(Outgoing(stream, message, stamp))
