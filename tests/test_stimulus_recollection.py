"""A stimulus that takes a dead one's place: the run comes out as it would have, wherever the first one ended."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_stimulus_paradigm import OPEN, Runner, action, calibration, guided, online, short, verdict

from bci_app.errors import SetupError
from bci_app.protocol import (
    Action,
    BlockEnd,
    Continued,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Pause,
    RunSeed,
    SessionEnd,
    Truth,
    Verdict,
)
from bci_app.said import Memory
from stimulus.paradigm import Outgoing, Paradigm


def rejected(move: MoveOnset) -> bool:
    """Some moves, whichever stimulus makes them."""
    return (7 * move.episode + 3 * move.step) % 5 == 0


def judged(move: MoveOnset) -> Verdict:
    return verdict(move, "rejected" if rejected(move) else "unjudged")


def memory_of(sent: list[Outgoing], actions: dict[tuple[int, int], Action] | None = None) -> Memory:
    """What bci-app has heard: the stimulus, the verdicts on its moves and the actions that led to them."""
    memory = Memory("s")
    for out in sent:
        if out.stream != "stimulus":
            continue
        message = out.message
        memory.take(out.stamp, message)
        if isinstance(message, MoveOnset) and actions is None:
            memory.take(out.stamp + 0.6, judged(message))
        following = {EpisodeStart: 1, MoveOnset: getattr(message, "step", 0) + 1}.get(type(message))
        if actions is not None and following and isinstance(message, EpisodeStart | MoveOnset):
            said = actions.get((message.episode, following))
            if said:
                memory.take(out.stamp + 0.7, said)
    return memory


def moves(sent: list[Outgoing]) -> list[tuple[int, int, str]]:
    onsets = [out.message for out in sent if out.stream == "stimulus" and isinstance(out.message, MoveOnset)]
    return [(onset.episode, onset.step, onset.action) for onset in onsets]


def of(sent: list[Outgoing], kind: type[Message]) -> list[Message]:
    return [out.message for out in sent if isinstance(out.message, kind)]


class Second(Runner):
    """Drives the paradigm that takes over."""

    def __init__(self, paradigm: Paradigm, memory: Memory, now: float) -> None:
        self.paradigm, self.lag, self.respond = paradigm, 0.0, None
        self.judge = lambda move: "rejected" if rejected(move) else "unjudged"
        self.now, self.sent = now, []
        paradigm.remember(memory.recall("stimulus").said, now)
        self.take()

    def resume(self) -> None:
        """All processes are well again."""
        self.now += 1
        self.paradigm.resume(self.now)
        self.take()


CONFIG = short(3, 9)
UNDISTURBED = Runner(calibration(CONFIG), judge=lambda move: "rejected" if rejected(move) else "unjudged").all()
SENT = [out for out in UNDISTURBED if out.stream == "stimulus"]


@settings(max_examples=len(SENT), deadline=None)
@given(cut=st.integers(1, len(SENT) - 1))
def test_a_calibration_goes_on_wherever_it_was_cut(cut: int) -> None:
    before = SENT[:cut]
    second = Second(calibration(CONFIG), memory_of(before), before[-1].stamp + 10)
    assert second.paradigm.waiting_for == "resume"
    assert isinstance(second.sent[0].message, Continued)
    assert not second.step()  # it waits
    second.resume()
    after = second.all()
    again = last_said(UNDISTURBED, before)
    assert [out for out in after if out.stamp < before[-1].stamp or out in again] == again
    new = [out for out in after if out not in again]
    assert moves(before) + moves(new) == moves(UNDISTURBED)
    for kind in (EpisodeStart, EpisodeEnd, BlockEnd, SessionEnd):
        assert of(before, kind) + of(new, kind) == of(UNDISTURBED, kind)
    assert [out.stamp for out in new] == sorted(out.stamp for out in new)
    assert new[0].stamp >= before[-1].stamp
    onsets = [out.stamp for out in (*before, *new) if isinstance(out.message, MoveOnset)]
    assert all(b - a >= 3.0 for a, b in pairwise(onsets))


def last_said(whole: list[Outgoing], before: list[Outgoing]) -> list[Outgoing]:
    """What the stimulus said with its last start and its last move: some of it may be lost."""
    starts = [out for out in before if isinstance(out.message, EpisodeStart)]
    if not starts or any(isinstance(out.message, EpisodeEnd) for out in before[before.index(starts[-1]) :]):
        return []
    start = starts[-1].message
    made = [out for out in before if isinstance(out.message, MoveOnset) and out.message.episode == start.episode][-1:]
    goal = [out for out in whole if isinstance(out.message, EpisodeGoal) and out.message.episode == start.episode]
    truth = [out for out in whole if isinstance(out.message, Truth) and made and out.stamp == made[0].stamp]
    return [*goal, starts[-1], *truth, *made]


def guided_with_actions() -> tuple[list[Outgoing], dict[tuple[int, int], Action]]:
    paradigm = online()
    said: dict[tuple[int, int], Action] = {}
    offer = paradigm.offer_action

    def listening(message: Action) -> str | None:
        said[message.episode, message.step] = message
        return offer(message)

    paradigm.offer_action = listening  # type: ignore[method-assign]
    return guided(paradigm).all(), said


ONLINE, ACTIONS = guided_with_actions()
SAID_ONLINE = [out for out in ONLINE if out.stream == "stimulus"]


@settings(max_examples=100, deadline=None)
@given(cut=st.integers(1, len(SAID_ONLINE) - 1), with_actions=st.booleans())
def test_an_online_run_goes_on_with_the_action_that_was_said(cut: int, with_actions: bool) -> None:
    """Or with one that comes only now, because the policy had not spoken when the stimulus died."""
    before = SAID_ONLINE[:cut]
    memory = memory_of(before, ACTIONS if with_actions else {})
    second = Second(online(), memory, before[-1].stamp + 10)
    second.resume()
    while not second.paradigm.done:
        while second.step():
            pass
        if second.paradigm.waiting_for == "action":
            last = [out.message for out in (*before, *second.sent) if isinstance(out.message, EpisodeStart | MoveOnset)]
            key = last[-1].episode, getattr(last[-1], "step", 0) + 1
            assert second.paradigm.offer_action(ACTIONS[key]) is None
    new = [out for out in second.sent if out not in last_said(ONLINE, before)]
    assert moves(before) + moves(new) == moves(ONLINE)
    assert of(before, EpisodeEnd) + of(second.sent, EpisodeEnd) == of(ONLINE, EpisodeEnd)


def test_what_nobody_remembers_is_said_to_be_void_with_the_seed() -> None:
    cut = next(i for i, out in enumerate(SENT) if isinstance(out.message, MoveOnset) and out.message.step == 2) + 1
    second = Second(calibration(CONFIG), memory_of(SENT[:cut]), SENT[cut].stamp)
    assert of(second.sent, Continued) == [Continued(session="s", episode=0, step=2)]
    assert of(second.sent, RunSeed) == [RunSeed(session="s", seed=7)]
    second.paradigm.tell_where(second.now)  # as often as it takes until everybody hears it
    second.take()
    assert of(second.sent, Continued) == [Continued(session="s", episode=0, step=2)] * 2
    second.resume()  # and once more when it goes on
    assert of(second.sent, Continued) == [Continued(session="s", episode=0, step=2)] * 3


def test_an_episode_that_nobody_remembers_begins_again() -> None:
    place = next(i for i, out in enumerate(SENT) if isinstance(out.message, EpisodeEnd)) + 1
    second = Second(calibration(CONFIG), memory_of(SENT[:place]), SENT[place].stamp)
    assert of(second.sent, Continued) == [Continued(session="s", episode=0)]
    second.resume()
    assert of(second.sent, EpisodeStart)[0] == of(SENT, EpisodeStart)[1]


def test_the_clocks_of_others_dont_move_the_onsets() -> None:
    """A decoder's stamps may be far ahead: of another computer."""
    memory = Memory("s")
    for out in SENT[:12]:
        memory.take(out.stamp, out.message)
        if isinstance(out.message, MoveOnset):
            memory.take(out.stamp + 6e5, judged(out.message))
    second = Second(calibration(CONFIG), memory, SENT[11].stamp + 10)
    second.resume()
    second.all()
    assert all(out.stamp < 1e4 for out in second.sent)


def test_a_persons_pause_stays_one() -> None:
    runner = Runner(calibration(CONFIG))
    runner.until(lambda: len(runner.of(MoveOnset)) == 3)
    runner.paradigm.pause(runner.now, "The experimenter pressed pause.", by_person=True)
    while runner.step():
        pass
    memory = Memory("s")
    for out in runner.sent:
        memory.take(out.stamp, out.message)
    second = Second(calibration(CONFIG), memory, runner.now + 5)
    assert second.paradigm.is_paused_by_person
    assert of(second.sent, Pause)[0].by_person
    links = Second(calibration(CONFIG), memory_of(SENT[:9]), 1e4)
    assert not links.paradigm.is_paused_by_person


def test_what_is_over_is_over_and_what_has_not_begun_waits_for_its_start() -> None:
    assert Second(calibration(CONFIG), memory_of(SENT), 1e6).paradigm.done
    fresh = Second(calibration(CONFIG), Memory("s"), 0.0)
    assert fresh.paradigm.waiting_for == "start"


def test_another_runs_words_are_refused() -> None:
    other = Paradigm.calibration(CONFIG, OPEN, "s", "P001", seed=8)
    with pytest.raises(SetupError, match="isn't what this stimulus's"):
        Second(other, memory_of(SENT), 1e6)


def test_an_action_that_was_taken_before_is_not_taken_twice() -> None:
    start = next(i for i, out in enumerate(SAID_ONLINE) if isinstance(out.message, EpisodeStart)) + 1
    second = Second(online(), memory_of(SAID_ONLINE[:start], ACTIONS), 1e4)
    first = ACTIONS[0, 1]
    assert second.paradigm.offer_action(first) is None  # said again, for the stimulus was gone: the same, so no trouble
    other = next(name for name in ("north", "south", "west", "east") if name != first.action)
    assert "again" in str(second.paradigm.offer_action(action(0, 1, other)))
    assert Counter(moves(second.sent)) == Counter()
