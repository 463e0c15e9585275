"""Policy files: what is written is read, and what is no policy of ours is refused in a sentence."""

import pickle
from dataclasses import replace

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from bci_app.errors import SetupError
from bci_app.gridworld import compile_map, load_map
from policy.cards import (
    PolicyCard,
    check_fits,
    choose_by_accuracy,
    choose_told,
    choose_without,
    library,
    policy_name,
    read_card,
)
from policy.checkpoint import load, pack, rounded, unpack, write
from policy.network import Network, PaperNetwork, ToldNetwork
from policy.verdicts import Verdicts

RING, OBSTACLES = compile_map("....\n.##.\n.##.\n....", "ring"), load_map("obstacles")
NETWORKS = {"evidence-2": (Network, "binary:0.75"), "told-3": (ToldNetwork, "told"), "paper-1": (PaperNetwork, "none")}


def card(verdicts="binary:0.75", network=None, recipe="ours"):
    of = network or Network(RING.n_cells, 4)
    story = {"settings": {"seed": 1}}
    return PolicyCard(RING.name, RING.digest, verdicts, recipe, of.layout, RING.n_cells, of.n_hidden, story)


def packed(verdicts="binary:0.75", recipe="ours"):
    torch.manual_seed(1)
    network = Network(RING.n_cells, 4)
    return pack(network, card(verdicts, network, recipe))


CONTENTS = packed()
HEADER = 8 + int.from_bytes(CONTENTS[:8], "little")


@pytest.fixture
def folder(tmp_path):
    for verdicts in ("none", "told", "binary:0.7", "binary:0.75", "binary:0.8", "score:0.75", "rates:0.7:0.8"):
        write(tmp_path / f"{card(verdicts).name}.safetensors", packed(verdicts))
    write(tmp_path / "ring_077_paper.safetensors", packed("binary:0.77", "paper"))
    write(tmp_path / "ring_teacher.safetensors", b"not a policy, and not asked")
    return tmp_path


@pytest.mark.parametrize("layout", NETWORKS)
def test_weights_and_card_make_the_round_trip_to_the_bit(tmp_path, layout):
    kind, verdicts = NETWORKS[layout]
    torch.manual_seed(2)
    for saved in (kind(RING.n_cells), rounded(kind(RING.n_cells))):
        path, wanted = tmp_path / "new" / "x.safetensors", card(verdicts, saved)
        write(path, pack(saved, wanted))
        loaded, found = load(path)
        assert (loaded.layout, found.layout) == (layout, layout)
        assert replace(found, path=None) == wanted
        assert found.path == path
        for one, other in zip(saved.state_dict().values(), loaded.state_dict().values(), strict=True):
            assert one.dtype == other.dtype == torch.float32
            assert torch.equal(one, other)


@pytest.mark.parametrize("hidden", [8, 80])
def test_a_told_policy_with_a_memory_of_any_size_is_read_back(hidden):
    told = ToldNetwork(RING.n_cells, hidden)
    loaded, _ = unpack(pack(told, card("told", told)), "x")
    assert loaded.listening.n_hidden == hidden
    assert loaded.n_hidden == told.n_hidden


def test_rounded_weights_take_half_the_room():
    network = Network(RING.n_cells, 32)
    full = len(pack(network, card()))
    assert len(pack(rounded(network), card())) < 0.6 * full


def test_a_file_takes_the_place_of_the_one_before(tmp_path):
    path = tmp_path / "x.safetensors"
    write(path, b"old")
    write(path, b"new")
    assert path.read_bytes() == b"new"
    assert [each.name for each in tmp_path.iterdir()] == ["x.safetensors"]


def refused(contents, says="must be a policy written by|weights of another network|must read the inputs"):
    with pytest.raises(SetupError, match=says) as caught:
        unpack(contents, "x")
    assert str(caught.value).endswith(".")


@given(st.integers(0, len(CONTENTS) - 1))
@settings(max_examples=30, deadline=None)
def test_a_truncated_file_is_refused(length):
    refused(CONTENTS[:length], "must be a policy written by")


@given(st.integers(0, HEADER - 1), st.integers(0, 255))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_header_is_refused_or_harmless(position, byte):
    damaged = CONTENTS[:position] + bytes([byte]) + CONTENTS[position + 1 :]
    try:
        _, found = unpack(damaged, "x")
    except SetupError:
        return
    assert (found.layout, found.n_cells, found.n_hidden) == (card().layout, card().n_cells, card().n_hidden)


@pytest.mark.parametrize(
    ("field", "value"), [("n_cells", 1.5), ("n_cells", -12), ("n_cells", "x"), ("n_hidden", 5), ("n_hidden", None)]
)
def test_sizes_that_are_none_are_refused(field, value):
    refused(pack(Network(RING.n_cells, 4), replace(card(), **{field: value})), "weights of another network")


@given(st.binary(max_size=200))
@settings(max_examples=50, deadline=None)
def test_garbage_is_refused(contents):
    refused(contents, "must be a policy written by")


def test_a_pickle_and_somebody_elses_tensors_are_refused_and_nothing_is_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return exec, (f"open({str(tmp_path / 'run')!r}, 'w')",)

    refused(pickle.dumps(Evil()), "must be a policy written by")
    torch.save({"w": Evil()}, tmp_path / "x.pt")
    refused((tmp_path / "x.pt").read_bytes(), "must be a policy written by")
    assert not (tmp_path / "run").exists()
    save_file({"w": torch.zeros(2)}, tmp_path / "x.safetensors")
    refused((tmp_path / "x.safetensors").read_bytes(), "must be a policy written by")


def test_another_layout_weights_of_another_network_and_other_verdicts_are_refused():
    network = Network(RING.n_cells, 4)
    refused(pack(network, replace(card(), layout="score-9")), "'evidence-2'.*but was trained on 'score-9'")
    refused(pack(network, replace(card(), layout="paper-1", n_hidden=64)), "weights of another network")
    refused(pack(network, replace(card(), verdicts="binary:0.4")), "above 0.5")


def test_a_missing_file_is_named(tmp_path):
    for read in (load, read_card):
        with pytest.raises(SetupError, match=r"Can't read the policy .*absent"):
            read(tmp_path / "absent.safetensors")


def test_another_map_is_refused():
    check_fits(card(), RING)
    with pytest.raises(SetupError, match=r"trained on map 'ring'.*map is 'obstacles'"):
        check_fits(card(), OBSTACLES)
    # The same name is not the same map.
    with pytest.raises(SetupError, match=r"trained on map 'ring'.*map is 'ring'"):
        check_fits(card(), compile_map("...\n.#.\n...", "ring"))


@pytest.mark.parametrize(
    ("accuracy", "expected"),
    [(0.78, 0.80), (0.50, 0.70), (1.0, 0.80), (0.725, 0.70), (0.775, 0.75), (0.7251, 0.75)],
)
def test_the_nearest_accuracy_is_chosen_and_a_tie_goes_to_the_lower(folder, accuracy, expected):
    """Paper V.B.2: a participant decoded at 78 % gets the policy trained at 0.80."""
    assert choose_by_accuracy(accuracy, RING, folder).accuracy == expected


def test_the_told_policy_and_the_one_without_verdicts_are_found(folder):
    assert choose_told(RING, folder).verdicts == "told"
    assert choose_without(RING, folder).verdicts == "none"
    assert choose_told(RING, folder).accuracy is None
    assert len(library(folder)) == 8  # the teacher is no policy


def test_a_policy_of_another_map_is_never_chosen(folder):
    for choose in (choose_told, choose_without, lambda *where: choose_by_accuracy(0.75, *where)):
        with pytest.raises(SetupError, match=r"for map 'obstacles' in .*bci-app train --map obstacles --verdicts"):
            choose(OBSTACLES, folder)


def test_names_of_files():
    names = {"none": "m_none", "told": "m_told", "binary:0.75": "m_075", "binary:1": "m_100", "score:0.7": "m_score070"}
    assert {words: policy_name("m", Verdicts.parse(words)) for words in names} == names
    assert policy_name("m", Verdicts.parse("binary:0.8"), "paper") == "m_080_paper"
    assert policy_name("m", Verdicts.parse("binary:0.801")) == "m_80.1"  # no other accuracy has its name
