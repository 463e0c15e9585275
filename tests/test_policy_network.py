"""The actors: what they read, that one step is one step however it is asked for, and how logits become actions."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from bci_app.gridworld import compile_map, load_map
from policy.episodes import Episodes
from policy.network import (
    HIDDEN,
    N_MARKS,
    PAPER_SCALARS,
    Inputs,
    Network,
    PaperNetwork,
    action_log_probabilities,
    greedy_actions,
    paper_vector,
    perceived,
    sensing,
)
from policy.observation import Tracker
from policy.simulator import pair_weights
from policy.verdicts import anybody

OPEN, RING = load_map("open"), compile_map("....\n.##.\n.##.\n....", "ring")
NOTHING = (False,) * 5
LEGAL_SETS = st.lists(st.booleans(), min_size=4, max_size=4).filter(any)
LOGITS = st.lists(st.floats(-50, 50), min_size=4, max_size=4)
BOTH = pytest.mark.parametrize("kind", [Network, PaperNetwork])


def in_the_middle(n=6, world=RING):
    """Episodes some moves old."""
    rng = np.random.default_rng(0)
    episodes = Episodes(world, n, pair_weights(world, "pairs"), anybody, rng)
    for _ in range(3):
        episodes.move(np.argmax(world.legal[episodes.simulator.cell], axis=1))
    return episodes


@given(LOGITS, LEGAL_SETS, st.floats(0, 1))
def test_probabilities_are_bounded_below_and_zero_where_illegal(logits, legal, epsilon):
    mask = torch.tensor(legal)
    log_probabilities = action_log_probabilities(torch.tensor(logits), mask, epsilon)
    probabilities = log_probabilities.exp()
    assert probabilities.sum().item() == pytest.approx(1, abs=1e-5)
    assert torch.isneginf(log_probabilities[~mask]).all()
    assert (probabilities[mask] >= epsilon / sum(legal) - 1e-6).all()
    softmax = np.exp(np.array(logits) - max(logits)) * legal
    expected = (1 - epsilon) * softmax / max(softmax.sum(), 1e-300) + epsilon * mask.numpy() / sum(legal)
    if softmax.sum() > 1e-20:
        np.testing.assert_allclose(probabilities, expected, atol=1e-5)


@given(LOGITS, LEGAL_SETS)
def test_the_greedy_action_is_legal_and_of_largest_logit(logits, legal):
    action = int(greedy_actions(torch.tensor(logits), torch.tensor(legal)))
    assert legal[action]
    assert np.float32(logits[action]) == max(np.float32(z) for z, ok in zip(logits, legal, strict=True) if ok)


def test_the_papers_observation_by_hand():
    """Paper IV.B: verdict, goal sensed, last action, visited cells, position and step, each divided by its maximum."""
    tracker = Tracker(OPEN, 60, NOTHING, 0.3)  # row 5, column 5
    start = paper_vector(OPEN, tracker.view())[0]
    assert start.shape == (PAPER_SCALARS + 121,)
    assert start[:PAPER_SCALARS].tolist() == [0.5, 0, 0, 0, 0, 0, 0, 0.5, 0.5, 0]
    assert np.flatnonzero(start[PAPER_SCALARS:]).tolist() == [60]
    tracker.moved(3, 61, (False, False, True, False, False), 1.2)  # east, called an error, the goal lies south
    moved = paper_vector(OPEN, tracker.view())[0]
    np.testing.assert_allclose(moved[:PAPER_SCALARS], [1, 0, 0, 1, 0, 0, 1, 0.5, 0.6, 1 / 60], rtol=1e-6)
    assert np.flatnonzero(moved[PAPER_SCALARS:]).tolist() == [60, 61]
    tracker.moved(1, 72, (True, False, False, False, False), -0.4)  # south, called correct, to the goal
    there = paper_vector(OPEN, tracker.view())[0]
    np.testing.assert_allclose(there[:PAPER_SCALARS], [0, 1, 0, 0, 0, 0, 0.5, 0.6, 0.6, 2 / 60], rtol=1e-6)


def test_the_papers_observation_stays_within_its_maxima():
    tracker = Tracker(OPEN, 120, NOTHING, 0.3)
    for step in range(200):
        tracker.moved(step % 2, 109 if step % 2 == 0 else 120, NOTHING, 10.0)
    assert paper_vector(OPEN, tracker.view()).min() == 0
    assert paper_vector(OPEN, tracker.view()).max() == 1


@BOTH
def test_episodes_side_by_side_are_as_many_single_ones(kind):
    torch.manual_seed(0)
    network, view = kind(RING.n_cells).eval(), in_the_middle().simulator.view()
    inputs, hidden = network.look(RING, view), torch.randn(6, network.n_hidden)
    together = network(inputs, hidden)
    for i in range(6):
        alone = network(type(inputs)(*(part[i : i + 1] for part in inputs)), hidden[i : i + 1])
        for one, other in zip(together, alone, strict=True):
            torch.testing.assert_close(one[i : i + 1], other)


@BOTH
def test_sizes(kind):
    """The memory is one GRU of 64 units (paper IV.A)."""
    network = kind(RING.n_cells)
    output = network(network.look(RING, in_the_middle().simulator.view()), torch.zeros(6, network.n_hidden))
    assert network.n_hidden == HIDDEN == 64
    assert output.logits.shape == (6, 4)
    assert output.hidden.shape == (6, 64)
    assert output.hidden.abs().max() < 1


def test_thinking_from_rows_looked_up_is_the_same_step():
    torch.manual_seed(0)
    network = Network(RING.n_cells)
    inputs, hidden = network.look(RING, in_the_middle().simulator.view()), torch.randn(6, HIDDEN)
    thought = network.think(inputs, network.move(inputs.move), network.from_cell(inputs.cell), hidden)
    for one, other in zip(network(inputs, hidden), thought, strict=True):
        assert torch.equal(one, other)


def test_what_is_decided_of_many_steps_at_once_is_what_is_decided_step_by_step():
    torch.manual_seed(0)
    network, hidden = Network(RING.n_cells), torch.randn(6, HIDDEN)
    steps = [network.look(RING, in_the_middle().simulator.view()) for _ in range(3)]
    outputs, memory = [], []
    for inputs in steps:
        outputs.append(network(inputs, hidden))
        hidden = network.remember(inputs, hidden)
        memory.append(hidden)
    together = network.decide(Inputs(*map(torch.cat, zip(*steps, strict=True))), torch.cat(memory))
    for one, other in zip(zip(*outputs, strict=True), together, strict=True):
        torch.testing.assert_close(torch.cat(one), other)


def test_our_gru_is_a_gru():
    """Against torch's, whose input weights are an identity here."""
    torch.manual_seed(0)
    network, reference = Network(RING.n_cells, 8), torch.nn.GRUCell(24, 8)
    gates, hidden = torch.randn(5, 24), torch.randn(5, 8)
    with torch.no_grad():
        reference.weight_ih.copy_(torch.eye(24))
        reference.bias_ih.zero_()
        reference.weight_hh.copy_(network.recurrent.weight)
        reference.bias_hh.copy_(network.recurrent.bias)
    torch.testing.assert_close(network._gru(gates, hidden), reference(gates, hidden))


@BOTH
def test_every_verdict_is_heard(kind):
    torch.manual_seed(0)
    network, seen = kind(OPEN.n_cells), []
    for evidence in (-1.0, 0.0, 1.0):
        tracker = Tracker(OPEN, 60, NOTHING, 0.3)
        tracker.moved(3, 61, NOTHING, evidence)
        seen.append(network(network.look(OPEN, tracker.view()), torch.zeros(1, HIDDEN)).logits)
    assert not torch.equal(seen[0], seen[1])
    assert not torch.equal(seen[1], seen[2])


def test_gradients_are_of_what_was_seen_even_after_new_episodes_began():
    """Weights learn from the inputs of the forward pass; the simulator writes other decoders into its arrays later."""
    torch.manual_seed(0)
    network, episodes, gradients = Network(RING.n_cells, 8), in_the_middle(), []
    inputs = network.look(RING, episodes.simulator.view())
    for then in (np.zeros(6, bool), np.ones(6, bool)):
        network.zero_grad()
        output = network(inputs, torch.zeros(6, 8))
        episodes.move(np.argmax(RING.legal[episodes.simulator.cell], axis=1))
        episodes.renew(then)
        output.logits.sum().backward()
        gradients.append({name: p.grad.clone() for name, p in network.named_parameters() if p.grad is not None})
    for name, gradient in gradients[0].items():
        assert torch.equal(gradient, gradients[1][name]), name


def test_our_marks_by_hand():
    """Visited cells; one column for each thing but nothing that is sensed; step of 60, information."""
    tracker = Tracker(OPEN, 60, NOTHING, 0.3)
    tracker.moved(3, 61, (False, False, True, False, False), 1.2)
    marks = perceived(tracker.view()).marks[0]
    assert marks.shape == (121 + N_MARKS,)
    assert torch.nonzero(marks).flatten().tolist() == [60, 61, 121 + 2, 121 + 5, 121 + 6]
    assert marks[-2:].tolist() == pytest.approx([1 / 60, 0.3])


def test_what_if_it_were_sensed_is_what_is_perceived_when_it_is():
    tracker, other = Tracker(OPEN, 60, NOTHING, 0.3), Tracker(OPEN, 60, (False, False, False, True, False), 0.3)
    thought = sensing(perceived(tracker.view()), torch.tensor([4]))
    for one, another in zip(thought, perceived(other.view()), strict=True):
        assert torch.equal(one, another)
    assert not perceived(tracker.view()).marks[0, 121:-2].any()
