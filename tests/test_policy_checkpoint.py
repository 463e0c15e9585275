from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from policy.__main__ import main
from policy.checkpoint import PolicyCard, check_fits, choose, library, load, save
from policy.network import Network
from policy.observation import LAYOUT, input_size

OPEN, OBSTACLES = load_map("open"), load_map("obstacles")


def card(accuracy=0.75, world=OPEN):
    return PolicyCard(
        world.name,
        world.digest,
        accuracy,
        LAYOUT,
        input_size(world),
        world.n_cells,
        {"settings": {"seed": 1}},
    )


def network(world=OPEN):
    torch.manual_seed(1)
    return Network(input_size(world), world.n_cells)


@pytest.fixture
def folder(tmp_path):
    for accuracy in (None, 0.70, 0.75, 0.80):
        one = card(accuracy)
        save(tmp_path / f"{one.name}.safetensors", network(), one)
    return tmp_path


def test_weights_and_card_make_the_round_trip(tmp_path):
    path = tmp_path / "new" / "open_075.safetensors"
    saved = network()
    save(path, saved, card())
    loaded, found = load(path)
    assert replace(found, path=None) == card()
    assert found.path == path
    for one, other in zip(saved.state_dict().values(), loaded.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_another_layout_is_refused(tmp_path):
    path = tmp_path / "old.safetensors"
    save(path, network(), replace(card(), layout="score-9"))
    with pytest.raises(SetupError, match=r"layout 'binary-1', but was trained on 'score-9'"):
        load(path)


def test_another_map_is_refused():
    check_fits(card(), OPEN)
    with pytest.raises(SetupError, match=r"trained on map 'open'.*map is 'obstacles'"):
        check_fits(card(), OBSTACLES)


@pytest.mark.parametrize("content", [b"", b"not safetensors at all"])
def test_a_file_that_is_no_policy_is_refused(tmp_path, content):
    path = tmp_path / "x.safetensors"
    path.write_bytes(content)
    with pytest.raises(SetupError, match="must be a policy file"):
        load(path)


def test_somebody_elses_safetensors_file_and_a_missing_one_are_refused(tmp_path):
    path = tmp_path / "x.safetensors"
    save_file({"w": torch.zeros(2)}, path)
    for bad in (path, tmp_path / "none.safetensors"):
        with pytest.raises(SetupError, match="must be a policy file"):
            load(bad)


def test_weights_of_another_size_are_refused(tmp_path):
    path = tmp_path / "x.safetensors"
    save(path, network(OBSTACLES), card())
    with pytest.raises(SetupError, match="weights of another network"):
        load(path)


@pytest.mark.parametrize(
    ("accuracy", "expected"),
    [(0.78, 0.80), (0.50, 0.70), (1.0, 0.80), (0.725, 0.70), (0.775, 0.75), (0.7251, 0.75), (None, None)],
)
def test_the_nearest_accuracy_is_chosen_and_a_tie_goes_to_the_lower(folder, accuracy, expected):
    """Paper V.B.2: a participant decoded at 78 % gets the policy trained at 0.80."""
    assert choose(accuracy, OPEN, folder).accuracy == expected


def test_a_policy_of_another_map_is_never_chosen(folder):
    with pytest.raises(SetupError, match="No policy with verdicts for map 'obstacles'"):
        choose(0.75, OBSTACLES, folder)


def test_the_library_lists_every_shipped_policy():
    assert {one.name for one in library()} == {
        f"{name}_{kind}" for name in ("open", "obstacles") for kind in ("none", "070", "075", "080")
    }


def test_the_command_trains_a_policy_of_a_labs_own_map(tmp_path, capsys):
    (tmp_path / "ring.txt").write_text("...\n.#.\n...\n")
    few = ["--updates", "2", "--warm-updates", "1", "--n-episodes", "16", "--n-steps", "4", "--test-episodes", "50"]
    where = ["--map", str(tmp_path / "ring.txt"), "--accuracy", "none", "--out", str(tmp_path)]
    assert main([*where, *few]) == 0
    path = tmp_path / "ring_none.safetensors"
    _, found = load(path)
    assert found.accuracy is None
    assert found.recipe["settings"]["updates"] == 2
    assert main(["--map", "open", "--start", str(path), "--out", str(tmp_path), *few]) == SetupError.exit_code
    assert "trained on map 'ring'" in capsys.readouterr().out
