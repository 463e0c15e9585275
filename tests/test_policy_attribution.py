import numpy as np
import pytest
import torch

from bci_app.gridworld import compile_map
from policy.experiment1.attribution import METHODS, attributions, effect_of, record
from policy.experiment1.influence import CellMeans, mean_by_episode
from policy.network import Network, PaperNetwork, ToldNetwork
from policy.verdicts import Verdicts, binary_evidence

torch.set_num_threads(1)  # small matrices: more threads only wait for each other
HALL = compile_map("\n".join(["....."] * 5), "hall")
RIGHT = Verdicts("binary", (0.8,), missing=0.1)
SCALE = float(binary_evidence(0.8, 0.8)[0])


def network_of(kind, seed=0):
    torch.manual_seed(seed)
    network = kind(HALL.n_cells)
    for parameter in network.parameters():
        parameter.data *= 3  # so that its choices depend on something
    return network.eval()


@pytest.fixture(params=[Network, PaperNetwork], scope="module")
def played(request):
    network = network_of(request.param)
    steps = record(network, HALL, RIGHT, 4, seed=1)
    return network, steps, effect_of(network, steps, SCALE)


def everything(effect):
    return torch.arange(len(effect))


def test_at_what_was_perceived_the_effect_is_the_networks_own(played):
    network, steps, effect = played
    logits = network(network.look(HALL, steps.view), steps.hidden).logits
    legal = torch.from_numpy(HALL.legal[steps.view.cell])
    expected = torch.log_softmax(logits.masked_fill(~legal, -torch.inf), dim=1).max(dim=1).values  # it was greedy
    torch.testing.assert_close(effect(effect.verdict, effect.position, everything(effect)), expected)


def test_verdicts_are_counted_in_verdicts_whatever_their_evidence(played):
    _, steps, effect = played
    assert set(effect.verdict.flatten().tolist()) == {-1, 0, 1}
    np.testing.assert_array_equal(np.sign(steps.view.evidence), effect.verdict[:, 0].numpy())


def test_the_first_step_of_an_episode_has_no_verdict_and_is_left_out(played):
    _, steps, _ = played
    assert steps.view.step.min() == 1
    assert set(steps.episode) == set(range(4))


@pytest.mark.parametrize(
    ("heard", "part"), [("binary:0.8", "listening"), ("binary:0.55", "listening"), ("none", "searching")]
)
def test_of_a_told_policy_the_part_that_plays_counts(heard, part):
    torch.manual_seed(0)
    told = ToldNetwork(HALL.n_cells, hidden=80).eval()
    steps = record(told, HALL, Verdicts.parse(heard), 2, seed=0)
    effect = effect_of(told, steps, float(steps.view.evidence.max()) or SCALE)
    played = told(told.look(HALL, steps.view), steps.hidden).logits
    legal = torch.from_numpy(HALL.legal[steps.view.cell])
    expected = torch.log_softmax(played.masked_fill(~legal, -torch.inf), dim=1).max(dim=1).values
    torch.testing.assert_close(effect(effect.verdict, effect.position, everything(effect)), expected)
    if heard != "none":
        assert set(effect.verdict.flatten().tolist()) == {-1, 1}  # however it is doubted
    getattr(told, part).judged.weight.data.zero_()
    getattr(told, part).judged_sure.weight.data.zero_()
    assert (attributions(effect, "gradient")[0] == 0).all()


def test_gradients_are_finite_differences(played):
    _, _, effect = played
    by_verdict, by_position = attributions(effect, "gradient")
    rows, small = everything(effect), 1e-3

    def slope(change_verdict, change_position):
        up = effect(effect.verdict + change_verdict, effect.position + change_position, rows)
        down = effect(effect.verdict - change_verdict, effect.position - change_position, rows)
        return ((up - down) / (2 * small)).detach().numpy()

    def agree(found, expected):
        # Not where a unit of the head begins to answer within the difference: there the function has a corner.
        assert np.mean(np.abs(found - expected) < 3e-3) > 0.9

    agree(by_verdict, slope(small, 0))
    for number, change in enumerate(small * torch.eye(by_position.shape[1])):
        agree(by_position[:, number], slope(0, change))


def test_integrated_gradients_sum_to_what_the_input_changes(played):
    _, _, effect = played
    by_verdict, by_position = attributions(effect, "integrated gradients")
    rows = everything(effect)
    with torch.no_grad():
        present = effect(effect.verdict, effect.position, rows)
        unheard = effect(torch.zeros_like(effect.verdict), effect.position, rows)
        nowhere = effect(effect.verdict, effect.nowhere.expand_as(effect.position), rows)
    np.testing.assert_allclose(by_verdict, (present - unheard).numpy(), atol=1e-2)
    np.testing.assert_allclose(by_position.sum(axis=1), (present - nowhere).numpy(), atol=1e-2)
    assert (by_verdict[effect.verdict[:, 0].numpy() == 0] == 0).all()


def test_smooth_gradients_are_the_same_every_time_and_near_the_gradients(played):
    _, _, effect = played
    before = torch.random.get_rng_state()
    first, again = attributions(effect, "SmoothGrad")[0], attributions(effect, "SmoothGrad")[0]
    np.testing.assert_array_equal(first, again)
    assert torch.equal(before, torch.random.get_rng_state())
    assert np.corrcoef(first, attributions(effect, "gradient")[0])[0, 1] > 0.8


@pytest.mark.parametrize("method", METHODS)
def test_a_policy_that_is_deaf_owes_nothing_to_verdicts(method):
    network = network_of(Network)
    for table in (network.judged, network.judged_sure):
        table.weight.data.zero_()
    effect = effect_of(network, record(network, HALL, RIGHT, 2, seed=0), SCALE)
    by_verdict, by_position = attributions(effect, method)
    assert (by_verdict == 0).all()
    assert (by_position != 0).any()


@pytest.mark.parametrize("method", METHODS)
def test_what_is_the_same_in_all_cells_isnt_owed_to_the_position(method):
    """The same function with other weights: what every cell's row has more, the memory's bias has less."""
    network, turned = network_of(Network), network_of(Network)
    turned.from_cell.weight.data += 0.5
    turned.from_memory.bias.data -= 0.5
    steps = record(network, HALL, RIGHT, 2, seed=0)
    found, same = (attributions(effect_of(each, steps, SCALE), method)[1] for each in (network, turned))
    np.testing.assert_allclose(found, same, atol=1e-4)


def test_the_interval_of_a_mean_counts_episodes_not_steps():
    rng = np.random.default_rng(0)
    episode = np.repeat(np.arange(400), 10)
    values = rng.normal(size=400)[episode]
    mean, low, high = mean_by_episode(values, episode)
    assert mean == pytest.approx(values.mean())
    assert (high - low) / 2 == pytest.approx(1.96 / np.sqrt(400), rel=0.1)


def test_centre_and_edge_of_known_values():
    rng = np.random.default_rng(0)
    cell, episode = rng.integers(HALL.n_cells, size=3000), rng.integers(100, size=3000)
    inside = ((HALL.cells > 0) & (HALL.cells < 4)).all(axis=1)
    means = CellMeans(HALL, np.where(inside[cell], 3.0, 1.0), cell, episode)
    assert means.visits.sum() == 3000
    found = means.centre_and_edge(1, rng)
    assert (found["centre"], found["edge"], found["ci_low"], found["ci_high"]) == pytest.approx((3, 1, 2, 2))
    assert (found["ratio"], found["ratio_low"], found["ratio_high"]) == pytest.approx((3, 3, 3))
    assert means.centre_and_edge(3, rng) is None  # a map of five by five is then all edge


def test_where_centre_and_edge_are_alike_the_interval_holds_zero():
    rng = np.random.default_rng(1)
    cell, episode = rng.integers(HALL.n_cells, size=3000), rng.integers(100, size=3000)
    found = CellMeans(HALL, rng.random(3000), cell, episode).centre_and_edge(1, rng)
    assert found["ci_low"] < 0 < found["ci_high"]
    assert found["ratio_low"] < 1 < found["ratio_high"]
