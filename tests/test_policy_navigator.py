"""The navigator: it chooses again what it chose, whoever lost their memory in between."""

from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.gridworld import ACTIONS, GridWorld, load_map
from bci_app.protocol import Action, Continued, EpisodeStart, Message, MoveOnset, Verdict
from bci_app.told import Told
from policy.agent import Agent
from policy.ear import Ear
from policy.navigator import Navigator
from policy.network import ToldNetwork
from policy.verdicts import Verdicts

WORLD = load_map("obstacles")
TOLD = Told(0.7, 0.8, 0.25)


@pytest.fixture(scope="module")
def network() -> ToldNetwork:
    torch.manual_seed(5)
    return ToldNetwork(WORLD.n_cells).eval()


def new(network: ToldNetwork) -> Navigator:
    return Navigator(Agent(network, Ear(Verdicts.parse("told"), TOLD), WORLD), WORLD, "s")


def begun(world: GridWorld, cell: int, goal: int) -> EpisodeStart:
    row, column = world.cells[cell].tolist()
    sensed = world.goal_sensed(cell, goal)
    return EpisodeStart(session="s", episode=3, position=(row, column), sensed=sensed, max_steps=60)


def moved(world: GridWorld, cell: int, goal: int, action: Action) -> tuple[int, MoveOnset]:
    cell = int(world.next_cell[cell, ACTIONS.index(action.action)])
    row, column = world.cells[cell].tolist()
    fields = {"episode": 3, "step": action.step, "action": action.action, "position": (row, column)}
    return cell, MoveOnset.model_validate({"session": "s", **fields, "sensed": world.goal_sensed(cell, goal)})


def judged(step: int, kind: str, evidence: float) -> Verdict:
    log_odds = None if kind == "rejected" else evidence
    fields = {"episode": 3, "step": step, "outcome": kind, "log_odds": log_odds, "evidence": log_odds}
    return Verdict.model_validate({"session": "s", "clock_offset": 0.0, **fields})


kinds = st.lists(
    st.tuples(st.sampled_from(["error", "correct", "rejected", "late"]), st.floats(-9, 9)), min_size=1, max_size=12
)


def story(navigator: Navigator, start: int, goal: int, verdicts: list[tuple[str, float]]) -> list[Message]:
    """What is said in an episode, in order. The action after a move whose verdict is late comes before the verdict."""
    said: list[Message] = []
    first = begun(WORLD, start, goal)
    action: Action | None = navigator.begin(first)
    said += [first, *([action] if action else [])]
    cell = start
    for kind, evidence in verdicts:
        assert action is not None
        cell, onset = moved(WORLD, cell, goal, action)
        assert navigator.moved(onset) is None
        verdict = judged(onset.step, "error" if kind == "late" else kind, evidence)
        action = navigator.missing() if kind == "late" else navigator.judged(verdict)
        answers = [action] if action else []
        said += [onset, *answers, verdict] if kind == "late" else [onset, verdict, *answers]
        if action is None:
            break
    return said


def go_on(navigator: Navigator, said: list[Message], cut: int) -> list[Action]:
    """The actions of a navigator that hears what is said from `cut` on."""
    chosen: list[Action | None] = []
    for before, message in pairwise([said[cut - 1], *said[cut:], said[-1]]):
        if isinstance(before, MoveOnset) and isinstance(message, Action):
            chosen.append(navigator.missing())  # its patience was over
        match message:
            case MoveOnset():
                chosen.append(navigator.moved(message))
            case Verdict() if message is not before:
                chosen.append(navigator.judged(message))
    return [action for action in chosen if action is not None]


@settings(max_examples=80, deadline=None)
@given(
    start=st.integers(0, WORLD.n_cells - 1),
    goal=st.integers(0, WORLD.n_cells - 1),
    verdicts=kinds,
    data=st.data(),
)
def test_whoever_relives_an_episode_goes_on_to_the_bit(
    network: ToldNetwork, start: int, goal: int, verdicts: list[tuple[str, float]], data: st.DataObject
) -> None:
    said = story(new(network), start, goal, verdicts)
    cut = data.draw(st.integers(1, len(said)), "cut")
    second = new(network)
    last = second.relive(said[:cut])
    after = [message for message in said[cut:] if isinstance(message, Action)]
    before = [message for message in said[:cut] if isinstance(message, Action)]
    chosen = [*([last] if last else []), *go_on(second, said, cut)]
    # What was said before is said again at most, for it may never have arrived.
    assert chosen in (after, [*before[-1:], *after])


def test_void_moves_are_forgotten(network: ToldNetwork) -> None:
    said = story(new(network), 0, WORLD.n_cells - 1, [("error", 2.0), ("correct", -1.0), ("error", 1.0)])
    second = new(network)
    second.relive(said)
    assert not second.forget_void(Continued(session="s", episode=3, step=3))
    assert not second.forget_void(Continued(session="s", episode=3))
    assert second.forget_void(Continued(session="s", episode=2))  # the whole episode
    assert second.forget_void(Continued(session="s", episode=3, step=2))
    assert second.forget_void(Continued(session="s", episode=3, step=0))


def test_an_episodes_start_that_is_said_twice_is_known(network: ToldNetwork) -> None:
    second = new(network)
    start = begun(WORLD, 0, 9)
    assert not second.is_in(start)
    second.begin(start)
    assert second.is_in(start)
    assert not second.is_in(begun(WORLD, 1, 9))
