"""The paradigm with a fake clock: its timing to the second, its messages, and what it does when things go wrong."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, GridWorld, compile_map, load_map
from bci_app.protocol import (
    Action,
    BlockEnd,
    BlockStart,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Note,
    Pause,
    Resume,
    RunSeed,
    SessionEnd,
    SessionStart,
    Truth,
    Verdict,
)
from stimulus.paradigm import Outgoing, Paradigm

CONFIG = Config.model_validate({"stimulus": {"headless": True}})
OPEN = load_map("open")
LINE = compile_map("...", "three")


def calibration(config: Config = CONFIG, world: GridWorld = OPEN, wait_for_key: bool = False) -> Paradigm:
    window = {"stimulus": config.stimulus.model_copy(update={"headless": not wait_for_key})}
    return Paradigm.calibration(config.model_copy(update=window), world, "s", "P001", 7)


def online(config: Config = CONFIG, world: GridWorld = OPEN, seed: int = 7) -> Paradigm:
    return Paradigm.online(config, world, "s", "P001", seed)


def short(n_blocks: int, moves: int, **keys: float) -> Config:
    return Config.model_validate(
        {"stimulus": {"headless": True}, "calibration": {"n_blocks": n_blocks, "moves_per_block": moves, **keys}}
    )


def action(episode: int, step: int, name: str, session: str = "s") -> Action:
    return Action.model_validate(
        {
            "session": session,
            "episode": episode,
            "step": step,
            "action": name,
            "probabilities": (1, 0, 0, 0),
            "verdict": "missing",
        }
    )


Outcome = Literal["unjudged", "rejected", "untimely"]
"""The last is rejected by time."""


def verdict(move: MoveOnset, outcome: Outcome) -> Verdict:
    by_time = outcome == "untimely"
    said: Literal["unjudged", "rejected"] = "unjudged" if outcome == "unjudged" else "rejected"
    return Verdict(session="s", episode=move.episode, step=move.step, outcome=said, by_time=by_time, clock_offset=0.0)


class Runner:
    """Drives a paradigm from one due time to the next; flips come `lag` seconds after the update.

    `judge` gives the verdict on each move of a calibration, or None to withhold it.
    """

    def __init__(
        self,
        paradigm: Paradigm,
        lag: float = 0.0,
        respond: Callable[[Message, Message], None] | None = None,
        judge: Callable[[MoveOnset], Outcome | None] = lambda move: "unjudged",
    ) -> None:
        self.paradigm, self.lag, self.respond, self.judge = paradigm, lag, respond, judge
        self.now = 100.0
        self.sent: list[Outgoing] = []
        paradigm.start(self.now)
        self.take()

    def take(self) -> None:
        new = self.paradigm.take_messages()
        self.sent += new
        for out in new:
            if isinstance(out.message, MoveOnset) and (outcome := self.judge(out.message)):
                self.paradigm.take_verdict(verdict(out.message, outcome), self.now)
        for out, after in pairwise(new):
            if self.respond:
                self.respond(out.message, after.message)

    def step(self) -> bool:
        """One change; False when the paradigm waits for something from outside."""
        due = self.paradigm.next_due()
        if due is None:
            return False
        self.now = max(self.now, due)
        self.paradigm.update(self.now)
        if self.paradigm.awaiting_flip:
            self.now += self.lag
            self.paradigm.flipped(self.now)
        self.take()
        return True

    def until(self, wanted: Callable[[], bool]) -> None:
        while not wanted():
            assert self.step()

    def all(self) -> list[Outgoing]:
        while self.step():
            pass
        return self.sent

    def of(self, kind: type[Message]) -> list[Outgoing]:
        return [out for out in self.sent if isinstance(out.message, kind)]


def kinds(sent: list[Outgoing]) -> list[str]:
    return [type(out.message).__name__ for out in sent if out.stream == "stimulus"]


def guided(paradigm: Paradigm) -> Runner:
    """An online run whose policy knows the way and answers every onset at once."""
    world = paradigm.world
    goal: list[int] = [0]

    def respond(message: Message, truth: Message) -> None:
        if isinstance(truth, EpisodeGoal):
            goal[0] = world.cell_at(*truth.goal)
        if isinstance(message, EpisodeStart | MoveOnset):
            cell = world.cell_at(*message.position)
            step = message.step + 1 if isinstance(message, MoveOnset) else 1
            if cell != goal[0]:
                best = min(range(4), key=lambda a: (not world.legal[cell, a], world.is_error(cell, a, goal[0])))
                paradigm.offer_action(action(message.episode, step, ACTIONS[best]))

    return Runner(paradigm, respond=respond)


# Calibration


def test_a_calibration_of_600_moves_keeps_the_second_grid() -> None:
    runner = Runner(calibration())
    runner.all()
    onsets = runner.of(MoveOnset)
    assert len(onsets) == 600
    assert all(out.stamp == round(out.stamp) for out in runner.sent)
    begun: float | None = None
    for before, after in pairwise(onsets):
        assert isinstance(before.message, MoveOnset)
        assert isinstance(after.message, MoveOnset)
        if after.message.step > 1:
            assert after.stamp - before.stamp == 3.0
            assert after.message.episode == before.message.episode
        else:
            begun = next(out.stamp for out in runner.of(EpisodeStart) if out.message.episode == after.message.episode)
            assert after.stamp - begun == 2.0  # a rest to look and the countdown
            assert after.message.episode == before.message.episode + 1
    assert begun is not None
    assert runner.sent[-1].stamp == onsets[-1].stamp + 2.0


def test_all_times_of_a_step_count_from_the_flip() -> None:
    runner = Runner(calibration(), lag=0.012)
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    onset = runner.of(MoveOnset)[0].stamp
    assert onset == 102.0 + 0.012
    assert runner.paradigm.next_due() == pytest.approx(onset + 1)
    assert runner.paradigm.scene(onset + 0.5).arrow is not None
    runner.step()
    assert runner.paradigm.scene(onset + 1.5).arrow is None
    assert runner.paradigm.next_due() == pytest.approx(onset + 2)
    runner.step()
    assert runner.paradigm.scene(onset + 2.25).countdown == pytest.approx(0.25)
    assert runner.paradigm.next_due() == pytest.approx(onset + 3)


def test_blocks_breaks_and_episodes_of_a_calibration() -> None:
    runner = Runner(calibration())
    runner.all()
    names = kinds(runner.sent)
    assert names[:3] == ["SessionStart", "BlockStart", "EpisodeStart"]
    assert names[-3:] == ["EpisodeEnd", "BlockEnd", "SessionEnd"]
    starts, ends = runner.of(BlockStart), runner.of(BlockEnd)
    assert [out.message.block for out in starts] == [out.message.block for out in ends] == [0, 1, 2, 3, 4]
    assert [after.stamp - end.stamp for end, after in zip(ends, starts[1:], strict=False)] == [10.0] * 4
    episodes = [out.message.episode for out in runner.of(EpisodeStart)]
    assert episodes == list(range(len(episodes))) == [out.message.episode for out in runner.of(EpisodeEnd)]
    assert sum(out.message.steps for out in runner.of(EpisodeEnd)) == 600
    assert runner.sent[-1].message == SessionEnd(session="s", reason="complete")


def test_truth_is_the_change_of_the_distance_and_errs_three_times_in_ten() -> None:
    runner = Runner(calibration())
    runner.all()
    distance = -1
    for out in (out for out in runner.sent if out.stream == "truth"):
        if isinstance(out.message, EpisodeGoal):
            distance = out.message.distance
            assert distance > 1
        if isinstance(out.message, Truth):
            assert out.message.error == (out.message.distance > distance)
            assert abs(out.message.distance - distance) == 1
            distance = out.message.distance
    onsets, truths = runner.of(MoveOnset), runner.of(Truth)
    assert [out.stamp for out in onsets] == [out.stamp for out in truths]
    assert 0.25 < sum(out.message.error for out in truths) / 600 < 0.35


def test_nothing_on_the_stimulus_stream_tells_the_goal() -> None:
    runner = Runner(calibration(short(1, 40)))
    runner.all()
    assert all(isinstance(out.message, EpisodeGoal | RunSeed | Truth) == (out.stream == "truth") for out in runner.sent)
    for out in runner.of(MoveOnset):
        assert "goal" not in out.message.model_dump()


def test_an_episode_ends_at_the_limit_and_at_the_blocks_end() -> None:
    runner = Runner(calibration(short(2, 5, max_steps=2, error_probability=0.99), OPEN))
    runner.all()
    reasons = [(out.message.steps, out.message.reason) for out in runner.of(EpisodeEnd)]
    assert reasons == [(2, "limit"), (2, "limit"), (1, "block")] * 2


def test_the_goal_counts_before_the_limit_and_the_blocks_end() -> None:
    runner = Runner(calibration(short(1, 2, max_steps=2, error_probability=1e-9), LINE))
    runner.all()
    assert [out.message.reason for out in runner.of(EpisodeEnd)] == ["goal"]


def test_a_key_ends_a_break_but_not_before_its_time() -> None:
    paradigm = calibration(short(2, 1), wait_for_key=True)
    runner = Runner(paradigm)
    runner.until(lambda: len(runner.of(BlockEnd)) == 1)
    paradigm.key_start(runner.now + 5)
    assert "Break" in str(paradigm.scene(runner.now + 5).text)
    runner.step()
    assert (paradigm.waiting_for, paradigm.next_due()) == ("key", None)
    assert "space" in str(paradigm.scene(runner.now).text)
    paradigm.pause(runner.now, "the policy is gone")
    paradigm.key_start(runner.now + 30)  # no effect: a key that is pressed in a pause is none
    assert paradigm.waiting_for == "resume"
    paradigm.resume(runner.now + 40)
    assert paradigm.waiting_for == "key"
    paradigm.key_start(runner.now + 60)
    runner.take()
    assert runner.of(BlockStart)[-1].stamp == runner.now + 60


def test_a_calibration_takes_no_actions_and_the_smallest_map_works() -> None:
    runner = Runner(calibration(short(1, 20), LINE))
    assert "calibration" in str(runner.paradigm.offer_action(action(0, 1, "east")))
    runner.all()
    assert len(runner.of(MoveOnset)) == 20
    with pytest.raises(SetupError):
        calibration(world=compile_map("..", "pair"))


def test_times_of_zero_are_possible() -> None:
    config = Config.model_validate(
        {
            "stimulus": {"headless": True, "countdown_s": 0, "arrow_s": 0, "rest_s": 0},
            "calibration": {"n_blocks": 2, "moves_per_block": 3, "break_s": 0},
        }
    )
    runner = Runner(calibration(config))
    assert runner.paradigm.scene(runner.now).countdown is None
    runner.all()
    assert len(runner.of(MoveOnset)) == 6


# Scenes


def test_the_scenes_of_a_step() -> None:
    paradigm = calibration()
    assert paradigm.scene(0.0).text
    runner = Runner(paradigm)
    look = paradigm.scene(runner.now)
    assert look.agent is not None
    assert look.goal is not None
    assert (look.countdown, look.arrow, look.text, look.moved) == (None, None, None, False)
    runner.step()
    assert [paradigm.scene(runner.now + s).countdown for s in (0.0, 0.5, 1.0, 9.0)] == [0.0, 0.5, 1.0, 1.0]
    paradigm.update(runner.now + 1)
    jump = paradigm.scene(runner.now + 1)
    assert jump.moved
    assert jump.arrow is not None
    assert jump.arrow[0] == look.agent
    assert jump.agent == OPEN.next_cell[jump.arrow]
    paradigm.flipped(runner.now + 1)
    assert not paradigm.scene(runner.now + 1).moved


def test_a_flip_nobody_awaits_is_a_programmers_mistake() -> None:
    with pytest.raises(RuntimeError, match="LOOK"):
        Runner(calibration()).paradigm.flipped(101.0)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_rejected_moves_are_repeated_in_kind_at_the_end_of_their_block(data: st.DataObject) -> None:
    """Whenever the verdicts come, and whichever moves are rejected, repetitions too; at most half a block of them, and
    a block of those that are no fault of the electrodes."""
    n_blocks, per_block = data.draw(st.integers(1, 3), "blocks"), data.draw(st.integers(1, 12), "moves")
    waiting: list[MoveOnset] = []
    told: dict[tuple[int, int], Outcome] = {}
    late = data.draw(st.booleans(), "late")

    def judge(move: MoveOnset) -> Outcome | None:
        told[move.episode, move.step] = data.draw(
            st.sampled_from(["unjudged", "unjudged", "unjudged", "rejected", "untimely"]), "verdict"
        )
        if late:
            waiting.append(move)
            return None
        return told[move.episode, move.step]

    runner = Runner(calibration(short(n_blocks, per_block)), judge=judge)
    while not runner.paradigm.done:
        if not runner.step():
            assert runner.paradigm.waiting_for == "verdict"
            assert waiting
            for move in data.draw(st.permutations(waiting), "order"):
                runner.now += 0.1
                runner.paradigm.take_verdict(verdict(move, told[move.episode, move.step]), runner.now)
                runner.paradigm.take_verdict(verdict(move, "rejected"), runner.now)  # the first word counts
            waiting.clear()
    blocks: list[list[tuple[Outcome, bool, bool]]] = [[]]  # verdict, error, whether an error was possible
    cell = goal = 0
    for out in runner.sent:
        match out.message:
            case EpisodeStart() as start:
                cell = OPEN.cell_at(*start.position)
            case EpisodeGoal() as aim:
                goal = OPEN.cell_at(*aim.goal)
            case MoveOnset() as move:
                can_err = any(OPEN.legal[cell, a] and OPEN.is_error(cell, a, goal) for a in range(4))
                error = OPEN.is_error(cell, ACTIONS.index(move.action), goal)
                blocks[-1].append((told[move.episode, move.step], error, can_err))
                cell = OPEN.cell_at(*move.position)
            case BlockEnd() as end:
                assert end.n_moves == len(blocks[-1])
                blocks.append([])
    for block in blocks[:-1]:
        left = {"rejected": math.ceil(per_block / 2), "untimely": per_block, "unjudged": 0}
        rejected = []
        for outcome, error, _ in block:
            if left[outcome]:
                rejected.append(error)
                left[outcome] -= 1
        assert len(block) == per_block + len(rejected)
        if not late:  # else they are repeated in the order in which their verdicts came
            repeated = block[per_block:]
            assert [error for _, error, _ in repeated] == [
                error and can_err for error, (_, _, can_err) in zip(rejected, repeated, strict=False)
            ]
    onsets = [out.stamp for out in runner.of(MoveOnset)]
    assert all(after - before >= 3.0 - 1e-9 for before, after in pairwise(onsets))


@pytest.mark.parametrize("pause", [False, True])
def test_eye_movements_come_before_the_first_block(pause: bool) -> None:
    runner = Runner(calibration(short(2, 3, eye_movements_s=30)))
    assert runner.paradigm.scene(runner.now).text.startswith("Blink")
    if pause:
        runner.paradigm.pause(runner.now + 1, "a question")
        assert runner.step()
        assert runner.paradigm.waiting_for == "resume"
        runner.now += 5
        runner.paradigm.resume(runner.now)
    runner.all()
    notes = [(out.stamp - 100, out.message.text) for out in runner.of(Note) if isinstance(out.message, Note)]
    delay = 5 * pause
    assert notes == [
        (0, "Eye movements: Blink."),
        (10 + delay, "Eye movements: Look left and right."),
        (20 + delay, "Eye movements: Look up and down."),
    ]
    assert runner.of(BlockStart)[0].stamp == 130 + delay
    assert len(runner.of(MoveOnset)) == 6


@pytest.mark.parametrize("when", ["in a block", "in a break", "in a pause of a break", "before a key"])
def test_a_calibration_that_is_long_enough_ends_after_its_block(when: str) -> None:
    runner = Runner(calibration(short(3, 4, break_s=10), wait_for_key=when == "before a key"))
    paradigm = runner.paradigm
    if when == "in a block":
        runner.until(lambda: len(runner.of(MoveOnset)) == 2)
        paradigm.finish(runner.now)
    else:
        runner.until(lambda: bool(runner.of(BlockEnd)))
        if when == "in a pause of a break":
            paradigm.pause(runner.now, "a question")
            runner.until(lambda: paradigm.waiting_for == "resume")
        elif when == "before a key":
            runner.until(lambda: paradigm.waiting_for == "key")
        paradigm.finish(runner.now)
        paradigm.resume(runner.now)
        runner.take()
    runner.all()
    assert paradigm.done
    assert len(runner.of(MoveOnset)) == 4
    assert kinds(runner.sent)[-3 if "pause" in when else -2] == "BlockEnd"
    (end,) = runner.of(SessionEnd)
    assert isinstance(end.message, SessionEnd)
    assert end.message.reason == "complete"


def test_verdicts_that_stay_away_end_the_block_all_the_same() -> None:
    runner = Runner(calibration(short(1, 5)), judge=lambda move: None if move.step == 1 else "unjudged")
    runner.all()
    assert runner.paradigm.waiting_for == "verdict"
    assert runner.paradigm.miss_verdicts(runner.now) >= 1
    runner.all()
    assert runner.paradigm.done
    assert len(runner.of(MoveOnset)) == 5


# Online


@pytest.mark.parametrize("name", ["open", "obstacles"])
def test_online_shows_every_distance_once_in_the_recorded_order(name: str) -> None:
    world = load_map(name)
    runs = [guided(online(world=world, seed=seed)) for seed in (1, 2)]
    orders = []
    for runner in runs:
        runner.all()
        goals = [out.message.distance for out in runner.of(EpisodeGoal)]
        assert sorted(goals) == list(range(2, 21))
        assert [(out.message.steps, out.message.reason) for out in runner.of(EpisodeEnd)] == [
            (distance, "goal") for distance in goals
        ]
        assert runner.sent[-1].message == SessionEnd(session="s", reason="complete")
        orders.append(goals)
    assert orders[0] != orders[1]
    starts = [{(out.message.position, out.message.sensed) for out in runner.of(EpisodeStart)} for runner in runs]
    assert starts[0] == starts[1]


@pytest.mark.parametrize("when", ["before the first move", "in an episode", "in a pause", "after its last move"])
def test_an_online_run_can_end_after_the_episode_under_way(when: str) -> None:
    runner = guided(online())
    paradigm = runner.paradigm
    if when == "after its last move":
        runner.until(lambda: bool(runner.of(MoveOnset)) and paradigm.waiting_for is None and _at_goal(runner))
    elif when != "before the first move":
        runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    if when == "in a pause":
        paradigm.pause(runner.now, "a question", by_person=True)
        runner.until(lambda: paradigm.waiting_for == "resume")
    paradigm.finish(runner.now)
    paradigm.release(runner.now)
    paradigm.resume(runner.now)
    runner.take()
    runner.all()
    assert paradigm.done
    assert [out.message.reason for out in runner.of(EpisodeEnd)] == ["goal"]
    assert runner.sent[-1].message == SessionEnd(session="s", reason="complete")
    assert runner.sent[-1].stamp - runner.of(MoveOnset)[-1].stamp >= 0.6


def _at_goal(runner: Runner) -> bool:
    (goal,), last = runner.of(EpisodeGoal), runner.of(MoveOnset)[-1]
    return last.message.position == goal.message.goal


def test_online_ends_a_rest_after_the_last_arrow() -> None:
    runner = guided(online())
    runner.all()
    last = runner.of(MoveOnset)[-1].stamp
    assert [out.stamp - last for out in runner.sent[-2:]] == [2.0, 2.0]


def legal_action(paradigm: Paradigm, step: int, now: float) -> Action:
    cell = paradigm.scene(now).agent
    assert cell is not None
    return action(0, step, ACTIONS[int(paradigm.world.legal[cell].argmax())])


def test_a_missing_action_holds_the_countdown_until_it_comes() -> None:
    runner = Runner(online())
    runner.all()
    paradigm = runner.paradigm
    assert (runner.now, paradigm.next_due(), paradigm.waiting_for) == (102.0, None, "action")
    paradigm.update(500.0)
    assert paradigm.scene(500.0).countdown == 1.0
    assert paradigm.offer_action(legal_action(paradigm, 1, 500.0)) is None
    assert paradigm.next_due() == 102.0
    paradigm.update(500.0)
    paradigm.flipped(500.01)
    assert paradigm.next_due() == 501.01


def test_an_action_during_the_arrow_leaves_the_arrow_alone() -> None:
    runner = Runner(online())
    paradigm = runner.paradigm
    paradigm.offer_action(legal_action(paradigm, 1, 100.0))
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    arrow = paradigm.scene(102.7).arrow
    assert paradigm.offer_action(legal_action(paradigm, 2, 102.7)) is None
    assert paradigm.scene(102.7).arrow == arrow


def test_actions_that_do_not_fit_are_refused_with_a_sentence() -> None:
    paradigm = online(world=compile_map("...", "three"))
    assert "no action now" in str(paradigm.offer_action(action(0, 1, "east")))
    runner = Runner(paradigm)
    towards, away = ("east", "west") if paradigm.scene(100.0).agent == 0 else ("west", "east")
    assert "legal" in str(paradigm.offer_action(action(0, 1, away)))
    assert "legal" in str(paradigm.offer_action(action(0, 1, "north")))
    assert "step 1 of episode 0" in str(paradigm.offer_action(action(0, 2, towards)))
    assert "step 1 of episode 0" in str(paradigm.offer_action(action(1, 1, towards)))
    assert "session 's'" in str(paradigm.offer_action(action(0, 1, towards, session="other")))
    assert paradigm.offer_action(action(0, 1, towards)) is None
    assert paradigm.offer_action(action(0, 1, towards)) is None  # the very same: from a policy that was started again
    assert "again" in str(paradigm.offer_action(action(0, 1, away)))
    paradigm.update(101.0)
    paradigm.update(102.0)
    assert paradigm.awaiting_flip
    assert "no action now" in str(paradigm.offer_action(action(0, 2, towards)))
    paradigm.flipped(102.0)
    assert "step 2" in str(paradigm.offer_action(action(0, 1, away)))
    assert paradigm.offer_action(action(0, 2, towards)) is None
    runner.all()
    assert paradigm.done
    assert "no action now" in str(paradigm.offer_action(action(0, 3, towards)))


def test_an_obstacle_is_refused() -> None:
    paradigm = online(world=compile_map("...\n.#.\n...", "ring"))
    Runner(paradigm)
    cell = paradigm.scene(100.0).agent
    assert cell is not None
    for number, name in enumerate(ACTIONS):
        if not paradigm.world.legal[cell, number]:
            assert "no free cell" in str(paradigm.offer_action(action(0, 1, name)))


def test_online_stops_at_the_limit() -> None:
    config = Config.model_validate({"stimulus": {"headless": True}, "online": {"max_steps": 1, "distances": (5, 6)}})
    runner = guided(online(config))
    runner.all()
    assert [(out.message.steps, out.message.reason) for out in runner.of(EpisodeEnd)] == [(1, "limit")] * 2


# Pause and stop


def test_a_pause_during_the_countdown_is_at_once_and_resumes_with_a_full_countdown() -> None:
    runner = Runner(calibration())
    paradigm = runner.paradigm
    runner.step()
    paradigm.pause(101.5, "cough", by_person=True)
    assert (paradigm.waiting_for, paradigm.next_due(), paradigm.scene(101.5).text) == ("resume", None, "Pause")
    paradigm.pause(101.6, "again", by_person=True)
    paradigm.resume(200.0)
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    assert [out.stamp for out in (*runner.of(Pause), *runner.of(Resume), *runner.of(MoveOnset))] == [101.5, 200, 202]


def test_a_pause_for_a_process_says_that_it_ends_by_itself_unless_a_person_pauses_as_well() -> None:
    runner = Runner(calibration())
    paradigm = runner.paradigm
    runner.step()
    paradigm.pause(101.5, "the policy is gone")
    assert "by itself" in str(paradigm.scene(101.5).text)
    assert not paradigm.is_paused_by_person
    paradigm.pause(102.0, "cough", by_person=True)
    runner.take()
    assert (paradigm.is_paused_by_person, paradigm.scene(102.0).text) == (True, "Pause")
    assert [out.stamp for out in runner.of(Pause)] == [101.5, 102.0]


def test_a_pause_waits_until_the_move_is_over() -> None:
    runner = Runner(calibration())
    paradigm = runner.paradigm
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    paradigm.pause(102.1, "cough")
    assert paradigm.scene(102.1).arrow is not None
    runner.all()
    assert [out.stamp for out in runner.of(Pause)] == [104.0]
    paradigm.resume(110.0)
    runner.until(lambda: len(runner.of(MoveOnset)) == 2)
    assert runner.now == 112.0


def test_a_pause_after_the_last_move_of_an_episode_and_in_a_break() -> None:
    runner = Runner(calibration(short(2, 1)))
    paradigm = runner.paradigm
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    paradigm.pause(102.1, "cough")
    runner.all()
    assert not runner.of(EpisodeEnd)
    paradigm.resume(110.0)
    runner.take()
    assert [out.stamp for out in runner.of(BlockEnd)] == [110.0]
    paradigm.pause(111.0, "longer break")
    runner.all()
    assert runner.of(Pause)[-1].stamp == 120.0
    paradigm.resume(300.0)
    runner.take()
    assert runner.of(BlockStart)[-1].stamp == 300.0


def test_a_pause_to_come_can_be_called_off() -> None:
    runner = Runner(calibration(short(1, 2)))
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    runner.paradigm.pause(102.1, "cough")
    runner.paradigm.resume(102.2)
    runner.all()
    assert not runner.of(Pause)
    assert runner.paradigm.done


def test_stop_before_the_start_and_twice() -> None:
    paradigm = online()
    paradigm.stop(5.0, "failed", "no amplifier")
    paradigm.stop(6.0, "interrupted", "again")
    paradigm.start(7.0)
    (out,) = paradigm.take_messages()
    assert out == Outgoing("stimulus", SessionEnd(session="s", reason="failed", text="no amplifier"), 5.0)
    assert paradigm.take_messages() == []


def test_stop_before_the_flip_of_a_jump_leaves_the_move_out() -> None:
    runner = Runner(calibration())
    runner.step()
    runner.paradigm.update(102.0)
    assert runner.paradigm.awaiting_flip
    runner.paradigm.stop(102.0, "interrupted")
    runner.take()
    assert not runner.paradigm.awaiting_flip
    assert not runner.of(MoveOnset)
    assert runner.of(EpisodeEnd)[0].message == EpisodeEnd(session="s", episode=0, steps=0, reason="aborted")


# Anything in any order

KINDS = ["update"] * 6 + ["act"] * 4 + ["wild", "pause", "resume", "resume", "key", "key", "start"]
EVENTS = st.lists(
    st.tuples(st.sampled_from(KINDS), st.sampled_from([0.0, 0.3, 1.0, 3.0]), st.integers(0, 3)),
    min_size=60,
    max_size=200,
)


@settings(max_examples=100, deadline=None)
@given(events=EVENTS, is_online=st.booleans(), starts_at=st.integers(0, 3), stops_at=st.integers(0, 400))
def test_whatever_happens_the_messages_stay_in_order(
    events: list[tuple[str, float, int]], is_online: bool, starts_at: int, stops_at: int
) -> None:
    config = Config.model_validate(
        {
            "stimulus": {"headless": True, "arrow_s": 0.7},
            "calibration": {"n_blocks": 2, "moves_per_block": 4, "max_steps": 3, "break_s": 2.0},
            "online": {"distances": (2, 3), "max_steps": 4},
        }
    )
    world = compile_map("....\n.#..", "small")
    paradigm = online(config, world) if is_online else calibration(config, world, wait_for_key=True)
    now, sent = 0.0, []
    for index, (kind, wait, number) in enumerate(events):
        now += wait
        happen(paradigm, {starts_at: "start", stops_at: "stop"}.get(index, kind), now, number)
        if paradigm.awaiting_flip and number:  # else something happens before the flip
            now += 0.01
            paradigm.flipped(now)
        sent += paradigm.take_messages()
        waits = paradigm.waiting_for is not None or paradigm.awaiting_flip or paradigm.done
        assert (paradigm.next_due() is None) == waits
        paradigm.scene(now)
    paradigm.stop(now, "interrupted")
    check(sent + paradigm.take_messages())


def happen(paradigm: Paradigm, kind: str, now: float, number: int) -> None:
    scene = paradigm.scene(now)
    match kind:
        case "update":
            paradigm.update(now)
        case "act" if scene.agent is not None:
            for step in range(1, 6):
                for episode in range(3):
                    paradigm.offer_action(action(episode, step, ACTIONS[number]))
        case "wild":
            paradigm.offer_action(action(number, number + 1, ACTIONS[number]))
        case "pause":
            paradigm.pause(now, "why not")
        case "resume":
            paradigm.resume(now)
        case "key":
            paradigm.key_start(now)
        case "start":
            paradigm.start(now)
        case "stop":
            paradigm.stop(now, "interrupted")


def check(sent: list[Outgoing]) -> None:
    """The invariants of every run."""
    stamps = [out.stamp for out in sent]
    assert stamps == sorted(stamps)
    names = kinds(sent)
    assert names.count("SessionEnd") == 1
    assert names[-1] == "SessionEnd"
    assert names[0] in ("SessionStart", "SessionEnd")
    assert names.count("SessionStart") == (len(names) > 1)
    check_moves(sent)
    pauses = [name for name in names if name in ("Pause", "Resume")]
    assert pauses == ["Pause", "Resume"] * (len(pauses) // 2) + ["Pause"] * (len(pauses) % 2)


def check_moves(sent: list[Outgoing]) -> None:
    steps: dict[int, int] = {}
    open_episode: int | None = None
    for out, after in zip(sent, [*sent[1:], sent[-1]], strict=True):
        match out.message:
            case EpisodeStart(episode=episode):
                assert open_episode is None
                assert episode == len(steps)
                assert isinstance(after.message, EpisodeGoal)
                open_episode, steps[episode] = episode, 0
            case MoveOnset(episode=episode, step=step):
                assert episode == open_episode
                assert step == steps[episode] + 1
                assert isinstance(after.message, Truth)
                assert (after.message.episode, after.message.step, after.stamp) == (episode, step, out.stamp)
                steps[episode] = step
            case EpisodeEnd(episode=episode):
                assert episode == open_episode
                assert out.message.steps == steps[episode]
                open_episode = None
            case SessionStart() | SessionEnd():
                assert open_episode is None
    assert sum(isinstance(out.message, Truth) for out in sent) == sum(steps.values())
