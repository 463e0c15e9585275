"""The live agent: it hears what its policy was trained to hear, moves as the evaluation does, and repeats itself."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, load_map
from bci_app.told import Told
from policy.agent import Agent
from policy.ear import Ear
from policy.evaluation import NetworkPlayer
from policy.network import Network, PaperNetwork, ToldNetwork
from policy.simulator import Pairs, Simulator, pair_weights
from policy.verdicts import LIMIT, Verdicts, binary_evidence, binary_information, score_information

OBSTACLES = load_map("obstacles")
NOTHING = (False,) * 5
TOLD = Told(0.66, 0.79, 0.21)
PROBABLE = st.floats(0, 1)


def ear(words, told=None):
    return Ear(Verdicts.parse(words), told)


def network(kind=Network, world=OBSTACLES):
    torch.manual_seed(3)
    return kind(world.n_cells).eval()


def if_told(hit, correct_rejection):
    return tuple(float(value) for value in binary_evidence(hit, correct_rejection))


@pytest.mark.parametrize(
    ("words", "error", "correct", "said_2", "information"),
    [
        ("none", 0.0, 0.0, 0.0, 0.0),
        ("binary:0.8", *if_told(0.8, 0.8), if_told(0.8, 0.8)[0], binary_information(0.8, 0.8)),
        ("rates:0.6:0.9", *if_told(0.6, 0.9), if_told(0.6, 0.9)[0], binary_information(0.6, 0.9)),
        ("score:0.8", *if_told(0.8, 0.8), 2.0, score_information(0.8)),
        ("told", *if_told(0.66, 0.79), 2.0, 0.21),
    ],
)
def test_what_each_kind_of_policy_hears(words, error, correct, said_2, information):
    one = ear(words, TOLD)
    assert one.evidence("error", None) == pytest.approx(error)
    assert one.evidence("correct", None) == pytest.approx(correct)
    assert one.evidence("error", 2.0) == pytest.approx(said_2)
    assert one.evidence("missing", None) == one.evidence("missing", 2.0) == 0
    assert one.information == pytest.approx(float(information), rel=1e-6)


def test_evidence_weighs_by_itself_whatever_the_word_and_within_its_bounds():
    one = ear("told", TOLD)
    assert one.evidence("correct", 0.3) == 0.3
    assert one.evidence("error", -99.0) == -LIMIT
    assert one.evidence("error", 99.0) == LIMIT


def test_a_policy_that_must_be_told_and_is_not_says_so():
    with pytest.raises(SetupError, match=r"must be told its decoder's statistics.*--told"):
        ear("told")


@given(PROBABLE, PROBABLE, PROBABLE)
def test_what_is_told_makes_the_round_trip_to_the_bit(hit, correct_rejection, information):
    told = Told(hit, correct_rejection, information)
    assert Told.parse(str(told)) == told


@pytest.mark.parametrize(
    "text", ["", "0.6:0.7", "0.6:0.7:0.1:0.1", "a:0.7:0.2", "1.2:0.7:0.2", "0.6:nan:0.2", "-1:0:0"]
)
def test_other_words_are_not_told(text):
    with pytest.raises(SetupError, match=r"HIT:CORRECT_REJECTION:BITS.*found"):
        Told.parse(text)


@pytest.mark.parametrize(
    ("kind", "words", "told"),
    [
        (Network, "binary:0.8", None),
        (Network, "rates:0.6:0.9", None),
        (PaperNetwork, "binary:0.8", None),
        (ToldNetwork, "told", TOLD),
        (ToldNetwork, "told", Told(0.58, 0.57, 0.02)),  # near chance it doubts what it is told
        (ToldNetwork, "told", Told(0.5, 0.5, 0.0)),  # and without verdicts it searches
    ],
)
def test_the_live_agent_moves_as_the_evaluation(kind, words, told):
    """The same episodes, heard by the ear as words (or, told, as evidence) and in the simulator as evidence."""
    world, actor, n = OBSTACLES, network(kind), 12
    rng = np.random.default_rng(4)
    start, goal = Pairs(pair_weights(world, "distances")).draw(n, rng)
    decoders = Verdicts.parse("score:0.7" if told else words, 0.2)(n, rng)
    if told:
        decoders.information[:] = told.information
    simulator = Simulator(world, start, goal, decoders, rng)
    player, agents = NetworkPlayer(actor, world), [Agent(actor, ear(words, told), world) for _ in range(n)]
    player.begin(simulator)
    decisions = [
        agent.begin(int(s), world.goal_sensed(int(s), int(g))) for agent, s, g in zip(agents, start, goal, strict=True)
    ]
    for _ in range(20):
        actions = player.act(simulator.view())
        assert [decision.action for decision in decisions] == actions.tolist()
        simulator.step(actions)
        for i, agent in enumerate(agents):
            evidence, cell = float(simulator.evidence[i]), int(simulator.cell[i])
            word = "missing" if evidence == 0 else "error" if evidence > 0 else "correct"
            sensed = world.goal_sensed(cell, int(goal[i]))
            decisions[i] = agent.step(int(actions[i]), cell, sensed, word, evidence if told else None)
            assert decisions[i].evidence == pytest.approx(evidence)


def test_the_same_episode_gives_the_same_bits_and_nothing_is_left_of_the_last_one():
    agent = Agent(network(), ear("told", TOLD), OBSTACLES)

    def episode(said):
        decisions, cell = [agent.begin(40, NOTHING)], 40
        for verdict in ("error", "missing", "correct", "error"):
            action = decisions[-1].action
            cell = int(OBSTACLES.next_cell[cell, action])
            decisions.append(agent.step(action, cell, NOTHING, verdict, said))
        return decisions

    first = episode(None)
    episode(3.0)
    assert episode(None) == first


def test_probabilities_are_of_the_legal_actions():
    decision = Agent(network(), ear("none"), OBSTACLES).begin(0, NOTHING)
    assert sum(decision.probabilities) == pytest.approx(1, abs=1e-6)
    assert [decision.probabilities[ACTIONS.index(a)] for a in ("north", "west")] == [0, 0]
    assert decision.probabilities[decision.action] == max(decision.probabilities)


def test_a_step_without_an_episode_is_a_programming_error():
    with pytest.raises(RuntimeError, match=r"before Agent\.begin"):
        Agent(network(), ear("none"), OBSTACLES).step(0, 49, NOTHING, "error")


@pytest.mark.parametrize(
    ("kind", "words", "exact"),
    [
        (ToldNetwork, "told", False),
        (Network, "binary:0.8", False),
        (Network, "none", True),
        (PaperNetwork, "none", True),
    ],
)
def test_the_belief_is_the_head_s_where_it_was_taught_and_bayes_rule_elsewhere(kind, words, exact):
    """Asking for it, or not, changes no decision; and a filter that is asked late has missed nothing."""
    asked, silent = (Agent(network(kind), ear(words, TOLD), OBSTACLES) for _ in range(2))
    assert asked.begin(0, NOTHING) == silent.begin(0, NOTHING)
    cell, goal = 0, OBSTACLES.n_cells - 1
    for step in range(8):
        found = asked.believed()
        assert found.exact == exact
        assert len(found.goal) == OBSTACLES.n_cells
        assert sum(found.goal) == pytest.approx(1, abs=1e-5)
        action = int(np.flatnonzero(OBSTACLES.legal[cell])[step % 2])
        cell = int(OBSTACLES.next_cell[cell, action])
        sensed = OBSTACLES.goal_sensed(cell, goal)
        said = ("error", "correct")[step % 2]
        assert asked.step(action, cell, sensed, said) == silent.step(action, cell, sensed, said)
    assert asked.believed() == silent.believed()
    if exact:
        assert asked.believed().goal[cell] == 0  # it was there, and sensed nothing


def test_a_told_policy_that_is_told_nothing_has_no_belief_of_its_own():
    agent = Agent(network(ToldNetwork), ear("told", Told(0.5, 0.5, 0.0)), OBSTACLES)
    agent.begin(0, NOTHING)
    assert agent.believed().exact


def test_the_shipped_policy_believes_nearly_what_bayes_rule_says():
    """The auxiliary head is shipped with its weights: total variation 0.12 to 0.14 in the mean over real episodes."""
    from policy.belief import Belief
    from policy.cards import choose_told
    from policy.checkpoint import load

    found, _ = load(choose_told(OBSTACLES).path)
    agent = Agent(found, ear("told", TOLD), OBSTACLES)
    rng, apart = np.random.default_rng(0), []
    for start, goal in rng.integers(OBSTACLES.n_cells, size=(20, 2)).tolist():
        decision, cell, exact = agent.begin(start, OBSTACLES.goal_sensed(start, goal)), start, None
        for _ in range(15):
            view = agent._tracker.view()
            if exact is None:
                exact = Belief(OBSTACLES, pair_weights(OBSTACLES, "mixture"), view)
            else:
                exact.update(view)
            apart.append(np.abs(exact.probability[0] - agent.believed().goal).sum() / 2)
            error, cell = (
                OBSTACLES.is_error(cell, decision.action, goal),
                int(OBSTACLES.next_cell[cell, decision.action]),
            )
            if cell == goal:
                break
            said = "error" if error == (rng.random() < 0.75) else "correct"
            decision = agent.step(decision.action, cell, OBSTACLES.goal_sensed(cell, goal), said)
    assert np.mean(apart) < 0.25
