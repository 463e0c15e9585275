import numpy as np
import pytest

from bci_app.gridworld import ACTIONS, load_map
from policy.agent import Agent
from policy.checkpoint import choose, load
from policy.evaluation import NetworkPlayer
from policy.observation import VERDICTS
from policy.simulator import Simulator, VerdictModel, pair_weights

NAMES = {code: name for name, code in VERDICTS.items()}


def shipped(name):
    world = load_map(name)
    network, _ = load(choose(0.75, world).path)
    return network, world


def recorded_episodes(network, world, n=30, n_steps=40):
    """The vectorised evaluation's moves and verdicts: (left, action, cell, verdict) of each step, and the goals."""
    simulator = Simulator(
        world, n, pair_weights(world, "distances"), VerdictModel(0.7, 0.8, 0.1), np.random.default_rng(4)
    )
    player = NetworkPlayer(network, world)
    player.begin(simulator.view())
    steps = []
    for _ in range(n_steps):
        left = simulator.cell.copy()
        actions = player.act(simulator.view())
        simulator.step(actions)
        steps.append((left, actions, simulator.cell.copy(), simulator.verdict.copy()))
    return steps, simulator.goal


@pytest.mark.parametrize("name", ["open", "obstacles"])
def test_the_live_agent_moves_as_the_vectorised_evaluation(name):
    network, world = shipped(name)
    steps, goals = recorded_episodes(network, world)
    for i, goal in enumerate(goals.tolist()):
        agent, start = Agent(network, world), int(steps[0][0][i])
        decision = agent.begin(start, world.goal_sensed(start, goal))
        for _, actions, cells, verdicts in steps:
            assert decision.action == actions[i]
            cell = int(cells[i])
            if cell == goal:
                break
            decision = agent.step(int(actions[i]), cell, world.goal_sensed(cell, goal), NAMES[int(verdicts[i])])


def test_the_same_episode_gives_the_same_bits_and_nothing_is_left_from_the_last_one():
    network, world = shipped("open")
    agent, nothing = Agent(network, world), (False,) * 5

    def episode():
        decisions, cell = [agent.begin(60, nothing)], 60
        for verdict in ("error", "missing", "correct", "error"):
            action = decisions[-1].action
            cell = int(world.next_cell[cell, action])
            decisions.append(agent.step(action, cell, nothing, verdict))
        return decisions

    assert episode() == episode()


def test_probabilities_are_of_the_legal_actions():
    network, world = shipped("open")
    decision = Agent(network, world).begin(0, (False,) * 5)
    assert sum(decision.probabilities) == pytest.approx(1, abs=1e-6)
    assert [decision.probabilities[ACTIONS.index(a)] for a in ("north", "west")] == [0, 0]
    assert decision.probabilities[decision.action] == max(decision.probabilities)


def test_a_goal_that_is_sensed_is_entered():
    network, world = shipped("open")
    for action in range(4):
        sensed = tuple(i == action + 1 for i in range(5))
        assert Agent(network, world).begin(60, sensed).action == action


def test_a_step_without_an_episode_is_a_programming_error():
    network, world = shipped("open")
    with pytest.raises(RuntimeError, match=r"before Agent\.begin"):
        Agent(network, world).step(0, 49, (False,) * 5, "error")
