"""Which policy an online run gets."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bci_app.config import PolicyConfig
from bci_app.errors import SetupError
from bci_app.gridworld import load_map
from bci_app.verbs import choose_policy
from decoder.model import ModelInfo, load

OPEN = load_map("open")


@pytest.fixture(scope="module")
def dead(any_decoder: Path) -> ModelInfo:
    """A decoder fitted on noise."""
    return load(any_decoder).info


def reaching(info: ModelInfo, accuracy: float, balanced: float) -> ModelInfo:
    """The same with other cross-validated figures."""
    figures: dict[str, Any] = {
        **info.blocked,
        "accuracy": {"value": accuracy},
        "balanced_accuracy": {"value": balanced},
    }
    evidence = replace(info.evidence, hit=0.7, correct_rejection=0.8, information=0.2)
    return info.model_copy(update={"blocked": figures, "evidence": evidence})


def test_by_default_the_policy_is_told_the_decoders_statistics(dead: ModelInfo) -> None:
    card, reason = choose_policy(None, reaching(dead, 0.78, 0.75), PolicyConfig(), False, OPEN)
    assert card.name == "open_told"
    assert "0.20 bits" in reason


def test_below_the_gate_nobody_is_sent_home(dead: ModelInfo) -> None:
    card, reason = choose_policy(None, reaching(dead, 0.72, 0.54), PolicyConfig(), False, OPEN)
    assert card.name == "open_none"
    assert "balanced accuracy of 54.0% is below the gate of 55%" in reason
    assert "--below-gate" in reason
    insisted, _ = choose_policy(None, reaching(dead, 0.72, 0.54), PolicyConfig(), True, OPEN)
    assert insisted.name == "open_told"


def test_the_papers_rule_is_a_setting(dead: ModelInfo) -> None:
    papers = PolicyConfig(choice="accuracy", gate_accuracy=0.70)
    assert choose_policy(None, reaching(dead, 0.78, 0.60), papers, False, OPEN)[0].name == "open_080"
    card, reason = choose_policy(None, reaching(dead, 0.69, 0.69), papers, False, OPEN)
    assert card.name == "open_none"
    assert "accuracy of 69.0% is below the gate of 70%" in reason


@pytest.mark.parametrize(
    ("asked", "name"),
    [
        ("none", "open_none"),
        ("told", "open_told"),
        ("accuracy", "open_080"),
        ("0.91", "open_090"),
        ("070_paper", "open_070_paper"),
    ],
)
def test_a_policy_that_is_asked_for_is_taken_below_the_gate_too(dead: ModelInfo, asked: str, name: str) -> None:
    card, reason = choose_policy(asked, reaching(dead, 0.80, 0.50), PolicyConfig(), False, OPEN)
    assert (card.name, reason) == (name, "as asked for")


@pytest.mark.parametrize("asked", ["75", "0.5", "-0.7", "nan"])
def test_an_accuracy_that_is_none_is_refused(dead: ModelInfo, asked: str) -> None:
    """75 for 0.75 would have the policy take every verdict for certain."""
    with pytest.raises(SetupError, match=r"above 0\.5 and at most 1"):
        choose_policy(asked, dead, PolicyConfig(), False, OPEN)


def test_what_is_no_policy_and_what_is_of_another_map_is_refused(dead: ModelInfo) -> None:
    with pytest.raises(SetupError, match="No policy 'best': expected a policy file"):
        choose_policy("best", dead, PolicyConfig(), False, OPEN)
    other, _ = choose_policy("none", dead, PolicyConfig(), False, load_map("obstacles"))
    with pytest.raises(SetupError, match="trained on map 'obstacles'"):
        choose_policy(str(other.path), dead, PolicyConfig(), False, OPEN)
