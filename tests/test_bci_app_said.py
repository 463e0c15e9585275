"""What was said: what a process that was started again is told of it, and what nobody remembers is void."""

from hypothesis import given
from hypothesis import strategies as st

from bci_app.protocol import (
    Action,
    Continued,
    Electrodes,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    Message,
    MoveOnset,
    Note,
    SessionStart,
    Status,
    Truth,
    Verdict,
)
from bci_app.said import Memory, is_void, without_void

NOTHING = (False,) * 5


def opening() -> SessionStart:
    return SessionStart(session="s", task="online", participant="P", map="open", layout=["..."], n_episodes=2)


def start(episode: int) -> EpisodeStart:
    return EpisodeStart(session="s", episode=episode, position=(0, 0), sensed=NOTHING, max_steps=60)


def move(episode: int, step: int, action: str = "east") -> MoveOnset:
    fields = {"episode": episode, "step": step, "action": action, "position": (0, step), "sensed": NOTHING}
    return MoveOnset.model_validate({"session": "s", **fields})


def verdict(episode: int, step: int) -> Verdict:
    return Verdict(session="s", episode=episode, step=step, outcome="error", clock_offset=0.0)


def chosen(episode: int, step: int) -> Action:
    fields = {"episode": episode, "step": step, "action": "east", "probabilities": (0, 0, 0, 1), "verdict": "error"}
    return Action.model_validate({"session": "s", **fields})


def end(episode: int) -> EpisodeEnd:
    return EpisodeEnd(session="s", episode=episode, steps=2, reason="goal")


STORY: list[Message] = [
    opening(),
    start(0),
    chosen(0, 1),
    move(0, 1),
    verdict(0, 1),
    chosen(0, 2),
    move(0, 2),
    verdict(0, 2),
    end(0),
    start(1),
    Electrodes(session="s", episode=1),
    chosen(1, 1),
    move(1, 1),
]


def told(memory: Memory, role: str) -> list[Message]:
    return [item.message for item in memory.recall(role).said]  # type: ignore[arg-type]


def memory_of(messages: list[Message]) -> Memory:
    memory = Memory("s")
    for stamp, message in enumerate(messages):
        memory.take(float(stamp), message)
    return memory


def test_each_is_told_what_it_must_know() -> None:
    noise: list[Message] = [
        Status(session="s", role="decoder", state="ready"),
        Note(session="s", role="decoder", level="info", text="hello"),
        Truth(session="s", episode=1, step=1, error=True, distance=3),
    ]
    memory = memory_of([*STORY, *noise])
    assert told(memory, "stimulus") == STORY
    assert told(memory, "policy") == [opening(), start(1), chosen(1, 1), move(1, 1)]
    assert told(memory, "decoder") == [opening(), start(1), move(1, 1), STORY[10]]
    assert told(Memory("s"), "policy") == []


def test_a_decoder_is_told_of_all_moves_without_a_verdict_and_of_what_holds_of_the_electrodes() -> None:
    held = Electrodes(session="s", episode=0, bad={"F3": ["flat"]})
    story = [opening(), start(0), held, move(0, 1), verdict(0, 1), move(0, 2), end(0), start(1), move(1, 1)]
    assert told(memory_of(story), "decoder") == [opening(), move(0, 2), start(1), move(1, 1), held]


def test_it_is_told_in_the_order_of_the_stamps() -> None:
    memory = Memory("s")
    memory.take(5.0, verdict(0, 1))
    memory.take(4.0, move(0, 1))
    memory.take(3.0, start(0))
    assert told(memory, "policy") == [start(0), move(0, 1), verdict(0, 1)]


def test_what_came_after_the_place_where_it_goes_on_is_void() -> None:
    here = Continued(session="s", episode=0, step=1)
    void = [message for message in STORY if is_void(message, here)]
    assert void == [move(0, 2), verdict(0, 2), end(0), start(1), STORY[10], chosen(1, 1), move(1, 1)]
    after = [move(0, 2, "west"), end(0)]
    kept = without_void([*STORY, here, *after], lambda message: message)
    assert kept == [*STORY[:6], here, *after]
    memory = memory_of([*STORY, here, *after])
    assert told(memory, "stimulus") == [*STORY[:6], *after]


def test_of_two_verdicts_on_a_move_the_first_counts_unless_it_is_void() -> None:
    late = verdict(0, 1).model_copy(update={"outcome": "rejected"})
    story: list[Message] = [start(0), move(0, 1), verdict(0, 1), late]
    assert without_void(story, lambda message: message) == story[:3]
    again: list[Message] = [Continued(session="s", episode=0, step=0), move(0, 1), late]
    assert without_void([*story, *again], lambda message: message) == [start(0), *again]


def test_what_is_told_twice_of_goal_and_truth_counts_once() -> None:
    goal = EpisodeGoal(session="s", episode=0, goal=(3, 3), distance=6)
    truth = Truth(session="s", episode=0, step=1, error=True, distance=7)
    story: list[Message] = [start(0), goal, move(0, 1), truth]
    here = Continued(session="s", episode=0, step=1)
    assert without_void([*story, truth, goal, here, start(0), move(0, 1), truth], lambda message: message) == [
        *story,
        here,
    ]
    memory = memory_of([opening(), *story, here, start(0), move(0, 1)])
    assert told(memory, "stimulus") == [opening(), start(0), move(0, 1)]
    # One that is void comes anew.
    earlier, other = here.model_copy(update={"step": 0}), truth.model_copy(update={"error": False})
    assert without_void([*story, earlier, other], lambda message: message) == [start(0), goal, earlier, other]


def test_an_episode_that_ended_stays_ended() -> None:
    between = Continued(session="s", episode=0)
    assert not any(is_void(message, between) for message in STORY[:9])
    assert all(is_void(message, between) for message in STORY[9:])  # the next one's start as well
    begun = Continued(session="s", episode=1, step=0)
    assert not is_void(start(1), begun)
    assert is_void(move(1, 1), begun)


def test_a_console_that_comes_late_is_told_the_outline_and_the_episode_under_way() -> None:
    decision = Electrodes(session="s", episode=1)
    expected = [opening(), start(0), end(0), start(1), decision, move(1, 1)]
    assert told(memory_of(STORY), "console") == expected


@given(
    st.lists(st.tuples(st.integers(0, 6), st.sets(st.integers(1, 6)), st.booleans()), min_size=1, max_size=12),
    st.integers(0, 3),
)
def test_what_is_forgotten_of_a_long_online_run_nobody_is_told(
    episodes: list[tuple[int, set[int], bool]], unmade: int
) -> None:
    """Compared with a calibration, of which nothing is forgotten; moves without a verdict, and a stimulus that died."""
    said: list[Message] = []
    for number, (n_moves, unjudged, looked) in enumerate(episodes):
        said.append(start(number))
        said += [Electrodes(session="s", episode=number, bad={"Cz": ["flat"]})] if looked else []
        for step in range(1, n_moves + 1):
            said += [chosen(number, step), move(number, step)]
            said += [] if step in unjudged else [verdict(number, step)]
        said.append(end(number))
    last = len(episodes) - 1
    said.append(Continued(session="s", episode=last, step=max(0, episodes[-1][0] - unmade)))
    online, whole = Memory("s"), Memory("s")
    online.take(0.0, opening())
    whole.take(0.0, opening().model_copy(update={"task": "calibration"}))
    for number, message in enumerate(said):
        for memory in (online, whole):
            memory.take(1.0 + number, message)
    for role in ("decoder", "policy", "console"):
        assert online.recall(role).said[1:] == whole.recall(role).said[1:]
    kinds = (EpisodeStart, EpisodeEnd)
    stimulus = [
        [item for item in memory.recall("stimulus").said if isinstance(item.message, kinds)]
        for memory in (online, whole)
    ]
    assert stimulus[0] == stimulus[1]


def test_of_a_long_online_run_little_is_kept() -> None:
    memory = Memory("s")
    memory.take(0.0, opening())
    for number in range(100):
        memory.take(number, start(number))
        for step in range(1, 15):
            for message in (chosen(number, step), move(number, step), verdict(number, step)):
                memory.take(number + step / 100, message)
        memory.take(number + 0.9, end(number))
    assert len(memory.recall("stimulus").said) < 2 * 100 + 2 * 3 * 14 + 2
