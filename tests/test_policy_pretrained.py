"""The shipped policies keep what is said of them, against the Bayes filter on the same 4000 episodes.

The full figures, 20,000 episodes each, are benchmarks/policy_steps.py's; here a tenth of a step is noise, so the bounds
are a little wider.
"""

from pathlib import Path

import pytest
import torch

from bci_app.gridworld import SHIPPED_MAPS, load_map
from policy.cards import PRETRAINED, check_fits, library, policy_name
from policy.checkpoint import load
from policy.evaluation import Result, evaluate
from policy.library import WITHOUT, everything
from policy.players import player_of
from policy.verdicts import Verdicts

torch.set_num_threads(1)  # small matrices: more threads only wait for each other
N = 4000


def result(name: str, player: str, verdicts: Verdicts, distribution: str = "pairs") -> Result:
    world = load_map(name)
    playing, heard = player_of(player, world, verdicts, PRETRAINED)
    return evaluate(playing, world, heard, distribution, N, seed=77)


def test_the_library_is_whole_and_fits_the_maps() -> None:
    cards = library()
    ours = {policy_name(name, kind) for name in SHIPPED_MAPS for kind in everything()}
    published = (WITHOUT, *(Verdicts("binary", (accuracy,)) for accuracy in (0.7, 0.8, 1.0)))
    papers = {policy_name(name, kind, "paper") for name in SHIPPED_MAPS for kind in published}
    assert sorted(card.name for card in cards) == sorted(ours | papers)
    for card in cards:
        assert isinstance(card.path, Path)
        assert card.path.stem == card.name
        load(card.path)
        check_fits(card, load_map(card.map))


@pytest.mark.parametrize("name", SHIPPED_MAPS)
@pytest.mark.parametrize("accuracy", [0.6, 0.7, 0.8, 1.0])
def test_binary_policies_need_no_more_steps_than_the_bayes_filter(name: str, accuracy: float) -> None:
    verdicts = Verdicts("binary", (accuracy,))
    bayes, ours = (result(name, player, verdicts) for player in ("bayes", f"{accuracy * 100:03.0f}"))
    assert ours.mean_steps < 1.04 * bayes.mean_steps


@pytest.mark.parametrize("name", SHIPPED_MAPS)
def test_without_verdicts_the_search_is_known_by_heart(name: str) -> None:
    assert result(name, "none", Verdicts("none")).mean_steps == result(name, "sweep", Verdicts("none")).mean_steps
    assert result(name, "none", Verdicts("none"), "distances").success_60 > 0.96


@pytest.mark.parametrize("name", SHIPPED_MAPS)
@pytest.mark.parametrize("words", ["score:0.6", "score:0.7", "score:0.85", "binary:0.75", "rates:0.654:0.859"])
def test_the_told_policy_makes_the_list_unnecessary(name: str, words: str) -> None:
    verdicts = Verdicts.parse(words)
    assert result(name, "told", verdicts).mean_steps < 1.05 * result(name, "bayes", verdicts).mean_steps


@pytest.mark.parametrize("name", SHIPPED_MAPS)
def test_a_dead_decoder_does_no_harm(name: str) -> None:
    """One of 108 errors found, no correct move called an error: person s10 of Ehrlich & Cheng 2018."""
    dead = Verdicts("rates", (1 / 108, 1.0), taken_for=Verdicts("rates", (1.5 / 109, 42.5 / 43)))
    assert result(name, "told", dead).mean_steps <= result(name, "none", Verdicts("none")).mean_steps


@pytest.mark.parametrize("name", SHIPPED_MAPS)
def test_the_experiments_episodes_succeed(name: str) -> None:
    """Published: 83.19 and 76.70 % at 0.70, 95.86 and 94.21 % at 0.80."""
    assert result(name, "070", Verdicts("binary", (0.7,)), "distances").success_60 > 0.985
    assert result(name, "080", Verdicts("binary", (0.8,)), "distances").success_60 > 0.997


def test_missing_verdicts_are_borne() -> None:
    there, gone = (result("open", "told", Verdicts("score", (0.75,), missing)) for missing in (0.0, 0.2))
    assert there.mean_steps < gone.mean_steps < 1.25 * there.mean_steps
