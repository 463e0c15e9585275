"""How far a run has come: its episode, its block, what must be repeated, the action of the coming move.

It knows no time: `stimulus.paradigm` moves it on, and `stimulus.recollection` brings a fresh one to where another's
process died.
"""

from typing import Literal

from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, GridWorld
from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    MoveOnset,
    Truth,
    Verdict,
)
from stimulus.episodes import Plan, Walk
from stimulus.repeats import Repeats

Reason = Literal["goal", "limit", "block", "aborted"]


class Course:
    """One run's course.

    Attributes
    ----------
    running : whether an episode is under way.
    walk : that episode, or the last.
    block : the block under way, or to come in a break.
    is_enough : no block (online: no episode) is to come after the one under way.
    light : whether the photodiode's patch is lit; it changes with each jump.
    """

    def __init__(self, world: GridWorld, plan: Plan) -> None:
        self.world, self.plan = world, plan
        self.session = plan.opening.session
        self.running = self.is_enough = self.light = False
        self.block, self._block_moves = plan.begin.block, 0
        self._moves = 0  # without those that must be repeated
        self._repeats = Repeats(plan.moves_per_block)
        # Until one begins.
        self.walk = Walk(world, self.session, number=plan.begin.episode - 1, cell=0, goal=0, max_steps=0)
        self._action: int | None = None  # of the coming move
        self._last_action: tuple[int, int, str] | None = None  # episode, step and what it is

    @property
    def has_blocks(self) -> bool:
        """True for a run in blocks, where moves whose epochs are rejected are repeated."""
        return self._repeats.is_on

    @property
    def progress(self) -> str:
        """How far the run is, for status lines."""
        opening = self.plan.opening
        if opening.n_moves is not None:
            return f"{self._moves} of {opening.n_moves} moves"
        return f"episode {self.walk.number + 1} of {opening.n_episodes}, {self.walk.steps} moves"

    @property
    def done_of(self) -> tuple[int, int]:
        """Blocks, or online episodes, that are over, and how many there are."""
        if self.has_blocks:
            return self.block, self.plan.n_blocks
        return self.walk.number + 1, self.plan.opening.n_episodes or 0

    # Blocks.

    def begin_block(self) -> BlockStart | None:
        """A block's moves are counted from here; its message, where a run has blocks."""
        self._begin_count(self.block)
        if self.plan.moves_per_block is None:
            return None
        n_moves = self.plan.moves_per_block - self._block_moves
        return BlockStart(session=self.session, block=self.block, n_moves=n_moves)

    def end_block(self) -> BlockEnd:
        """The block is over."""
        self.block += 1
        return BlockEnd(session=self.session, block=self.block - 1, n_moves=self._block_moves)

    def _begin_count(self, block: int) -> None:
        """Of the moves of a block, which may have some from a run before."""
        begin = self.plan.begin
        self.block, self._block_moves = block, begin.moves_done if block == begin.block else 0
        self._repeats.begin()

    @property
    def is_block_over(self) -> bool:
        """Whether the block has all its moves, with those that must be repeated by what is known so far."""
        return self._is_block_full() and not self._repeats.any_left

    @property
    def is_undecided(self) -> bool:
        """Whether the block is over unless a verdict that is awaited says otherwise."""
        return self.is_block_over and self._repeats.is_undecided

    @property
    def is_last(self) -> bool:
        """Whether nothing is to come after the block that is over."""
        return self.is_enough or (self.has_blocks and self.block == self.plan.n_blocks)

    @property
    def is_break_due(self) -> bool:
        """Whether a rest follows an online episode that is over."""
        done, total = self.done_of
        every = self.plan.break_every
        return bool(every) and not self.has_blocks and 0 < done < total and done % every == 0

    def _is_block_full(self) -> bool:
        """Whether the block has all its moves, if none must be repeated."""
        per_block = self.plan.moves_per_block
        return per_block is not None and self._block_moves >= per_block

    def judged(self, verdict: Verdict) -> str | None:
        """Hear whether a move's epoch is valid. A sentence when no more of this block will be repeated."""
        found = self._repeats.judged((verdict.episode, verdict.step), verdict.outcome, verdict.by_time)
        self._moves -= found in ("again", "last")
        if found != "last":
            return None
        most, what = self._repeats.most[verdict.by_time], "EEG's connection" if verdict.by_time else "electrodes"
        return f"{most} moves of block {self.block} had to be repeated; no more of these will be. Look at the {what}."

    def miss_verdicts(self) -> int:
        """Take those that stay away for valid; returns how many."""
        return self._repeats.give_up()

    # Episodes.

    def begin_episode(self) -> tuple[EpisodeStart, EpisodeGoal] | None:
        """The next episode; None when there is none."""
        episode = next(self.plan.episodes, None)
        if episode is None:
            return None
        self.running = True
        self.walk = Walk(
            self.world, self.session, self.walk.number + 1, episode.start, episode.goal, self.plan.max_steps
        )
        return self.walk.start_messages()

    def end_reason(self) -> Literal["goal", "limit", "block"] | None:
        """Why the episode is over; None while it isn't."""
        return self.walk.over() or ("block" if self.is_block_over else None)

    def end_episode(self, reason: Reason) -> EpisodeEnd:
        """The episode under way is over."""
        self.running = False
        return self.walk.end_message(reason)

    # Moves.

    def jump(self) -> bool:
        """Make the move, which counts once `landed`; False where its action is missing."""
        if self.plan.choose is not None:
            kind = self._kind_to_repeat()
            self._action = self.plan.choose(self.walk.cell, self.walk.goal, kind)
        if self._action is None:
            return False
        self.walk.go(self._action)
        self._action = None
        self.light = not self.light
        return True

    def landed(self) -> tuple[MoveOnset, Truth]:
        """The move has been seen, and counts."""
        self.walk.steps += 1
        self._moves += 1
        self._block_moves += 1
        onset, truth = self.walk.move_messages()
        self._repeats.made((truth.episode, truth.step), truth.error)
        return onset, truth

    def _kind_to_repeat(self) -> bool | None:
        """Whether the next move must be an error; None while it needn't repeat another."""
        return self._repeats.take() if self._is_block_full() else None

    def take_action(self, action: Action) -> None:
        """The policy's action for the coming move, which `refusal` has nothing against."""
        self._action = ACTIONS.index(action.action)
        self._last_action = action.episode, action.step, action.action

    def is_known(self, action: Action) -> bool:
        """Whether the same action was taken before: said twice, by a policy that was started again."""
        return action.session == self.session and (action.episode, action.step, action.action) == self._last_action

    def refusal(self, action: Action, awaiting_flip: bool) -> str | None:
        """Why an action can't be taken, in a sentence; None if it can."""
        found = f"found an action for step {action.step} of episode {action.episode}"
        if self.plan.choose is not None:
            return f"expected no action in a calibration; {found}"
        if action.session != self.session:
            return f"expected session '{self.session}'; {found} of session '{action.session}'"
        if not self.running or self.end_reason() or awaiting_flip:
            return f"expected no action now ({self.progress}); {found}"
        step = self.walk.steps + 1
        if (action.episode, action.step) != (self.walk.number, step):
            return f"expected an action for step {step} of episode {self.walk.number}; {found}"
        if self._action is not None:
            return f"step {step} of episode {self.walk.number} has its action, {ACTIONS[self._action]}; {found} again"
        if not self.world.legal[self.walk.cell, ACTIONS.index(action.action)]:
            where = self.walk.position(self.walk.cell)
            return f"expected a legal action; {found}: {action.action} of {where} is no free cell"
        return None

    # What was said before, by a stimulus that died.

    def remember_block(self, start: BlockStart) -> None:
        """A block had begun."""
        self._begin_count(start.block)

    def remember_start(self, start: EpisodeStart) -> None:
        """An episode had begun. Raises SetupError where it isn't this run's."""
        episode = next(self.plan.episodes, None)
        if episode is None or self.walk.position(episode.start) != start.position:
            raise SetupError(
                f"Episode {start.episode} of the session began at {start.position}, which isn't what this stimulus's "
                "seed, map and configuration give. Start it with those of the one before."
            )
        self.running = True
        self.walk = Walk(self.world, self.session, start.episode, episode.start, episode.goal, start.max_steps)

    def remember_move(self, onset: MoveOnset) -> None:
        """A move had been made. Chance goes on where it was."""
        if self.plan.choose is not None:
            self.plan.choose(self.walk.cell, self.walk.goal, self._kind_to_repeat())
        self.walk.go(ACTIONS.index(onset.action))
        self.walk.steps = onset.step
        self.light = not self.light
        self._moves += 1
        self._block_moves += 1
        self._repeats.made((onset.episode, onset.step), self.walk.was_error())
