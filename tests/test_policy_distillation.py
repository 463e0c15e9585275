"""Our recipe: the actor recites the search, and learns from the planner what a live agent can know."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from bci_app.gridworld import compile_map
from policy.baselines import BayesPlayer, SearchPlayer
from policy.coverage import search_paths
from policy.distillation import DistillationSettings, distil
from policy.evaluation import NetworkPlayer, evaluate, play
from policy.network import Network, ToldNetwork, doubting
from policy.planner import Planner
from policy.recitation import DONE, RecitationSettings, Walk, recite
from policy.simulator import Pairs, Simulator, pair_weights
from policy.verdicts import Verdicts, anybody, binary_information

RING = compile_map("....\n.##.\n.##.\n....", "ring")
QUICK = DistillationSettings(n_hidden=32, n_episodes=64, n_steps=8, updates=60, learning_rate=8e-3)
NONE = Verdicts("none")


@cache
def planner():
    """One that has learnt nothing yet makes the greedy move, and that is worth learning."""
    torch.manual_seed(0)
    return Planner(RING, search_paths(RING)).eval()


@cache
def reciting():
    return recite(RING, search_paths(RING), RecitationSettings(updates=80, learning_rate=1e-2))


def test_the_ring_is_learnt_to_near_bayes():
    kind = Verdicts("binary", (0.8,))
    network = distil(RING, planner(), kind, QUICK)
    learnt = evaluate(NetworkPlayer(network, RING), RING, kind, n=4000)
    bayes = evaluate(BayesPlayer(RING, pair_weights(RING, "pairs")), RING, kind, n=4000)
    silent = evaluate(NetworkPlayer(network, RING), RING, NONE, n=4000)
    assert learnt.success_60 == 1
    assert learnt.mean_steps < 1.05 * bayes.mean_steps
    assert learnt.mean_steps_ci[1] < silent.mean_steps_ci[0]  # it listens


def test_the_same_seed_gives_the_same_weights_and_progress_is_told():
    short, told = replace(QUICK, updates=3), []

    def run(seed):
        settings = replace(short, seed=seed)
        return distil(RING, planner(), anybody, settings, lambda update, figures: told.append((update, figures)))

    first, again, other = run(0).state_dict(), run(0).state_dict(), run(1).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["move.weight"], other["move.weight"])
    assert [update for update, _ in told] == [1, 2, 3] * 3
    assert told[0][1].keys() == {"steps", "imitation", "goal"}


def test_a_network_to_go_on_from_is_gone_on_from():
    start = distil(RING, planner(), anybody, replace(QUICK, updates=2))
    before = {name: tensor.clone() for name, tensor in start.state_dict().items()}
    still = distil(RING, planner(), anybody, replace(QUICK, updates=1, learning_rate=0.0), network=start)
    assert all(torch.equal(before[name], tensor) for name, tensor in still.state_dict().items())
    moved = distil(RING, planner(), anybody, replace(QUICK, updates=1), network=start)
    assert not torch.equal(moved.state_dict()["move.weight"], before["move.weight"])


@pytest.mark.parametrize("guided", [0.0, 1.0])
def test_the_teacher_leads_as_long_as_it_is_said_to(guided):
    """Led in half of the episodes, an actor that can't learn still meets what the greedy move leads to."""
    steps = []
    settings = replace(QUICK, updates=2, learning_rate=0.0, guided=guided, n_steps=40)
    kind = Verdicts("binary", (0.95,))
    distil(RING, planner(), kind, settings, lambda update, figures: steps.append(figures["steps"]))
    assert (steps[0] < 15) == (guided == 1.0)


def test_every_episode_begins_with_an_empty_memory():
    starts = []

    class Watched(Network):
        def remember(self, inputs, hidden):
            """One step; notes the memories that episodes begin with."""
            starts.append(hidden[inputs.marks[:, -2] == 0])
            return super().remember(inputs, hidden)

    distil(RING, planner(), anybody, replace(QUICK, updates=4), network=Watched(RING.n_cells, 8))
    begun = torch.cat(starts[1:])  # after the very first step
    assert len(begun) > 20
    assert not begun.any()


def test_what_is_recited_is_the_laid_down_walk():
    paths = search_paths(RING)
    walk = Walk.along(RING, paths)
    n = RING.n_cells
    simulator = Simulator(RING, np.arange(n), np.argmax(RING.distance, axis=1), NONE(n, None), np.random.default_rng(0))
    network = reciting()
    for step in range(paths.shape[1]):
        told = (walk.taught[step] != DONE).numpy()
        np.testing.assert_array_equal(walk.taught[step].numpy()[told], paths[told, step])
        np.testing.assert_array_equal(walk.legal[step], RING.legal[simulator.cell])
        seen = network.look(RING, replace(simulator.view(), sensed=np.zeros(n, np.uint8)))
        for field in ("move", "cell", "marks"):
            found, expected = getattr(walk.inputs[step], field), getattr(seen, field)
            assert torch.equal(found[told], expected[told])
        simulator.step(np.where(told, paths[:, step], 0))
        if not told.all():
            break
    assert step > 2


def test_the_search_is_known_by_heart_and_a_goal_that_is_sensed_is_entered():
    network, paths = reciting(), search_paths(RING)
    start, goal = np.nonzero(RING.distance >= 2)

    def steps(player):
        n = len(start)
        return play(player, Simulator(RING, start, goal, NONE(n, None), np.random.default_rng(0)))

    np.testing.assert_array_equal(steps(NetworkPlayer(network, RING)), steps(SearchPlayer(paths)))


def test_the_same_seed_recites_the_same():
    short = RecitationSettings(updates=3, what_if=0.5)
    first, again = (recite(RING, search_paths(RING), short).state_dict() for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first)


def seen_with(evidence, information):
    """A view of as many episodes on the ring, with these two alone."""
    n = len(information)
    view = Simulator(RING, np.zeros(n, int), np.full(n, 5), NONE(n, None), np.random.default_rng(0)).view()
    return replace(view, evidence=np.asarray(evidence, np.float32), information=np.asarray(information, np.float32))


@pytest.mark.parametrize(
    ("told", "taken_for"), [(0.51, 0.545), (0.55, 0.589), (0.6, 0.614), (0.65, 0.632), (0.75, 0.75), (0.9, 0.9)]
)
def test_near_chance_what_is_told_of_a_decoder_is_doubted(told, taken_for):
    bits, sure = float(binary_information(told, told)), np.log(told / (1 - told))
    view = doubting(seen_with([sure, -sure, 0], [bits] * 3))
    expected = np.log(taken_for / (1 - taken_for))
    np.testing.assert_allclose(view.evidence, [expected, -expected, 0], rtol=0.05)
    np.testing.assert_allclose(view.information, binary_information(taken_for, taken_for), rtol=0.1)


@given(st.floats(0, 1, width=32), st.floats(-10, 10, width=32))
def test_what_is_heard_grows_with_what_is_told_and_nothing_told_is_nothing_heard(information, evidence):
    view = doubting(seen_with([evidence] * 3, [information, min(information + 0.01, 1), 0]))
    assert view.evidence.dtype == view.information.dtype == np.float32
    assert abs(view.information[0] - information) <= 0.0307  # at 0.32 squared, which is taken for 0.268 squared
    assert view.information[0] <= view.information[1]
    assert (view.evidence[2], view.information[2]) == (np.float32(evidence), 0)
    assert evidence * view.evidence[0] >= 0
    assert abs(view.evidence[0]) <= 10
    if information >= 0.18:  # an accuracy of 0.75
        assert view.information[0] == pytest.approx(information)
        assert view.evidence[0] == pytest.approx(evidence)


@pytest.mark.parametrize("hidden", [32, 64, 96])
def test_the_told_network_searches_or_listens_as_it_is_told_and_never_mixes_memories(hidden):
    torch.manual_seed(0)
    told = ToldNetwork(RING.n_cells, hidden).eval()

    def draw(n, rng):
        decoders = Verdicts("binary", (0.8,))(n, rng)
        decoders.put(np.arange(n) % 2 == 0, NONE(n // 2, rng))
        return decoders

    rng = np.random.default_rng(0)
    start, goal = Pairs(pair_weights(RING, "pairs")).draw(8, rng)
    simulator, silent = Simulator(RING, start, goal, draw(8, rng), rng), torch.arange(8) % 2 == 0
    memory = torch.zeros(8, told.n_hidden)
    alone = {each: torch.zeros(8, each.n_hidden) for each in (told.searching, told.listening)}
    for _ in range(4):
        inputs = told.look(RING, simulator.view())
        with torch.no_grad():
            output, outputs = told(inputs, memory), {each: each(inputs, alone[each]) for each in alone}
        memory, alone = output.hidden, {each: outputs[each].hidden for each in alone}
        torch.testing.assert_close(output.logits[silent], outputs[told.searching].logits[silent])
        torch.testing.assert_close(output.logits[~silent], outputs[told.listening].logits[~silent])
        for which in (silent, ~silent):
            part = told(type(inputs)(*(each[which] for each in inputs)), torch.zeros(4, told.n_hidden))
            whole = told(inputs, torch.zeros(8, told.n_hidden))
            torch.testing.assert_close(part.logits, whole.logits[which])
        simulator.step(np.argmax(RING.legal[simulator.cell], axis=1))


def test_a_search_hears_nothing():
    network, rng = reciting(), np.random.default_rng(0)
    start, goal = Pairs(pair_weights(RING, "pairs")).draw(20, rng)
    simulator, hidden = Simulator(RING, start, goal, anybody(20, rng), rng), torch.zeros(20, network.n_hidden)
    for _ in range(5):
        simulator.step(np.argmax(RING.legal[simulator.cell], axis=1))
        heard = simulator.view()
        nothing = np.zeros(20, np.float32)
        silent = replace(heard, evidence=nothing, information=nothing)
        one, other = (network(network.look(RING, view), hidden) for view in (heard, silent))
        assert torch.equal(one.logits, other.logits)
        hidden = one.hidden
