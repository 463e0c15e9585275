"""What is reachable without learning takes the documented number of steps, and a name finds who plays."""

import numpy as np
import pytest

from bci_app.errors import SetupError
from bci_app.gridworld import compile_map, load_map
from bci_app.told import Told
from policy import checkpoint, teachers
from policy.baselines import BayesPlayer, OraclePlayer, PlannerPlayer, SearchPlayer
from policy.cards import PolicyCard
from policy.ear import Ear
from policy.evaluation import NetworkPlayer, evaluate
from policy.network import Network
from policy.planner import PlannerSettings
from policy.players import heard, player_of
from policy.simulator import Simulator, pair_weights
from policy.verdicts import Decoders, HeldOut, Verdicts

OPEN, RING = load_map("open"), compile_map("....\n.##.\n.##.\n....", "ring")
BINARY = Verdicts("binary", (0.7,))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A library of the ring: a teacher and a policy trained at 0.75."""
    path = tmp_path_factory.mktemp("library")
    settings = PlannerSettings(n_episodes=8, n_steps=2, n_minibatches=1, updates=1, critic_updates=0)
    checkpoint.write(teachers.path_of(path, RING), teachers.make(RING, settings))
    card = PolicyCard(RING.name, RING.digest, "binary:0.75", "ours", Network.layout, RING.n_cells, 8, {})
    checkpoint.write(path / "ring_075.safetensors", checkpoint.pack(Network(RING.n_cells, 8), card))
    return path


@pytest.mark.parametrize(
    ("words", "expected"), [("none", 24.4), ("binary:0.7", 16.7), ("binary:0.8", 12.8), ("score:0.7", 14.9)]
)
def test_the_filter_takes_the_documented_number_of_steps(words, expected):
    """SPEC section 6: what is reachable on `open`; without verdicts a shorter view ahead than there is better."""
    player = BayesPlayer(OPEN, pair_weights(OPEN, "pairs"))
    result = evaluate(player, OPEN, Verdicts.parse(words), n=2000)
    assert result.mean_steps == pytest.approx(expected, rel=0.06)


def test_certain_verdicts_find_every_goal_soon():
    result = evaluate(BayesPlayer(OPEN, pair_weights(OPEN, "pairs")), OPEN, Verdicts("binary", (1.0,)), n=1000)
    assert result.success_60 == 1
    assert result.mean_steps == pytest.approx(9.4, rel=0.05)


@pytest.mark.parametrize("name", ["bayes", "planner", "sweep", "oracle"])
def test_whoever_is_kept_plays_on_as_if_alone(folder, name):
    """A player that forgets episodes goes on with the others as one that never knew them."""
    which = np.arange(12) % 3 == 0
    start, goal = (column[:12] for column in np.nonzero(RING.distance == 6))

    def moves(drops):
        player, _ = player_of(name, RING, BINARY, folder)
        # No ties to be broken by chance: a verdict a step, always right.
        decoders = Decoders.score(12, 0.9, missing=0.0)
        decoders.distance[:] = 40
        simulator = Simulator(RING, start, goal, decoders, np.random.default_rng(0))
        player.begin(simulator)
        taken = []
        for step in range(5):
            if step == 2 and drops:
                player.keep(which)
                simulator.keep(which)
            action = player.act(simulator.view())
            simulator.step(action)
            taken.append(action if drops and step >= 2 else action[which])
        return taken[2:]

    for one, other in zip(moves(True), moves(False), strict=True):
        np.testing.assert_array_equal(one, other)


def test_names_find_players(folder):
    kinds = {"bayes": BayesPlayer, "planner": PlannerPlayer, "sweep": SearchPlayer, "oracle": OraclePlayer}
    for name, kind in kinds.items():
        player, verdicts = player_of(name, RING, BINARY, folder)
        assert isinstance(player, kind)
        assert verdicts == BINARY
    for name in ("ring_075", "075", "0.8", "accuracy", str(folder / "ring_075.safetensors")):
        player, verdicts = player_of(name, RING, BINARY, folder)
        assert isinstance(player, NetworkPlayer)
        assert verdicts.taken_for == Verdicts("binary", (0.75,))


def test_a_policy_that_hears_one_kind_of_verdicts_cant_be_told_otherwise(folder):
    wrongly = Verdicts("binary", (0.7,), taken_for=Verdicts("binary", (0.9,)))
    own = HeldOut(np.ones(3, np.float32), -np.ones(3, np.float32), 0.2)
    for draw in (wrongly, own):
        with pytest.raises(SetupError, match=r"takes every verdict for one of binary:0\.75"):
            player_of("ring_075", RING, draw, folder)
        assert player_of("bayes", RING, draw, folder)[1] is draw


def test_an_unknown_name_lists_the_known_ones(folder):
    with pytest.raises(SetupError, match=r"No policy 'best': expected a policy file, told.*one of bayes.*ring_075"):
        player_of("best", RING, BINARY, folder)


def test_a_policy_of_another_map_and_a_missing_teacher_are_refused(folder):
    with pytest.raises(SetupError, match=r"trained on map 'ring'.*map is 'open'"):
        player_of("ring_075", OPEN, BINARY, folder)
    with pytest.raises(SetupError, match=r"planner of map 'open' must be in .*bci-app train --map open"):
        player_of("planner", OPEN, BINARY, folder)


@pytest.mark.parametrize(
    ("trained", "given", "kind", "taken_for"),
    [
        ("none", "binary:0.7", "none", None),
        ("binary:0.8", "binary:0.7", "binary:0.7", "binary:0.8"),
        ("binary:0.8", "score:0.7", "binary:0.7", "binary:0.8"),  # it takes the word, not the score
        ("binary:0.8", "rates:0.6:0.9", "rates:0.6:0.9", "binary:0.8"),
        ("binary:0.8", "none", "binary:0.8", None),
        ("score:0.8", "score:0.7", "score:0.7", "score:0.8"),
        ("told", "score:0.7", "score:0.7", None),
        ("told", "rates:0.6:0.9", "rates:0.6:0.9", None),
    ],
)
def test_how_each_kind_of_policy_hears_verdicts(trained, given, kind, taken_for):
    found = heard(Verdicts.parse(trained), Verdicts.parse(given))
    assert str(found) == kind
    assert found.taken_for == (taken_for and Verdicts.parse(taken_for))
    assert found.missing == (given == "none" and trained == "binary:0.8")


@pytest.mark.parametrize("trained", ["none", "binary:0.8", "rates:0.6:0.9", "score:0.8", "told"])
@pytest.mark.parametrize("given", ["none", "binary:0.7", "rates:0.5:0.95", "score:0.7"])
def test_a_policy_hears_in_simulation_what_it_hears_live(trained, given):
    policy, verdicts = Verdicts.parse(trained), Verdicts.parse(given)
    if policy.kind == "score" and verdicts.kind in ("binary", "rates"):
        return  # refused: see below
    rng, n = np.random.default_rng(0), 400
    error = np.arange(n) % 2 == 0
    simulated = heard(policy, verdicts)(n, rng)
    found = simulated.evidence(error, rng)
    rates = verdicts.numbers or (0.5, 0.5)
    ear = Ear(policy, Told(rates[0], rates[-1], float(simulated.information[0])))
    np.testing.assert_allclose(simulated.information, ear.information, rtol=1e-6)
    if verdicts.kind == "none":
        assert not found.any()
    elif verdicts.kind != "score":
        words = {np.float32(ear.evidence(word, None)) for word in ("error", "correct")}
        assert set(found.tolist()) == {float(word) for word in words}


def test_a_teacher_that_is_damaged_or_of_another_map_is_refused(folder):
    contents = teachers.path_of(folder, RING).read_bytes()
    assert teachers.read(contents, RING, "x").paths.shape[0] == RING.n_cells
    with pytest.raises(SetupError, match=r"knows map 'ring'.*not 'open'"):
        teachers.read(contents, OPEN, "x")
    for bad in (b"", b"junk" * 9, contents[:-9], (folder / "ring_075.safetensors").read_bytes()):
        with pytest.raises(SetupError, match="must be a teacher written by"):
            teachers.read(bad, RING, "x")
