import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from policy.network import HIDDEN, Network, action_log_probabilities, greedy_actions

LEGAL_SETS = st.lists(st.booleans(), min_size=4, max_size=4).filter(any)
LOGITS = st.lists(st.floats(-50, 50), min_size=4, max_size=4)


@given(LOGITS, LEGAL_SETS, st.floats(0, 1))
def test_probabilities_are_bounded_below_and_zero_where_illegal(logits, legal, epsilon):
    mask = torch.tensor(legal)
    probabilities = action_log_probabilities(torch.tensor(logits), mask, epsilon).exp()
    assert probabilities.sum().item() == pytest.approx(1, abs=1e-5)
    assert (probabilities[~mask] == 0).all()
    assert (probabilities[mask] >= epsilon / sum(legal) - 1e-6).all()


@given(LOGITS, LEGAL_SETS)
def test_the_greedy_action_is_legal_and_of_largest_logit(logits, legal):
    action = int(greedy_actions(torch.tensor(logits), torch.tensor(legal)))
    assert legal[action]
    assert np.float32(logits[action]) == max(np.float32(z) for z, ok in zip(logits, legal, strict=True) if ok)


def test_unrolling_is_stepping_with_the_memory_emptied_at_episode_starts():
    torch.manual_seed(0)
    network, inputs = Network(12, 9), torch.randn(7, 3, 12)
    starts = torch.zeros(7, 3, dtype=torch.bool)
    starts[0], starts[4, 1] = True, True
    hidden, stepped = torch.randn(3, HIDDEN), []
    together, _ = network.unroll(inputs, hidden, starts)
    for step in range(7):
        logits, _, hidden = network(inputs[step], hidden * (~starts[step]).float()[:, None])
        stepped.append(logits)
    torch.testing.assert_close(together, torch.stack(stepped))


def test_the_memory_is_one_gru_of_64_units():
    """Paper IV.A."""
    assert Network(12, 9).memory.hidden_size == 64
