"""The study file: what it may hold, and what is refused before anything starts."""

from pathlib import Path
from typing import Any

import pytest

from bci_app.errors import SetupError
from bci_app.study import plan

TWO: dict[str, Any] = {
    "name": "two",
    "participants": [{"name": "A1", "decodability": 0.8, "seed": 4}, {"name": "A2"}],
}


def study(**changes: Any) -> plan.Study:
    return plan.parse(TWO | changes, "two.toml")


@pytest.mark.parametrize("name", plan.SHIPPED)
def test_the_shipped_studies_can_be_read(name: str) -> None:
    found = plan.load(name)
    assert found.name == name
    assert found.conditions[0] == "none"


def test_the_papers_cohort_is_the_seven_who_went_online_and_the_seven_who_were_sent_home() -> None:
    found = plan.load("wang2022")
    shown = [each.published for each in found.participants]
    assert shown[:7] == ["S2", "S4", "S5", "S6", "S8", "S10", "S15"]
    assert shown[7:] == [None] * 7
    assert set(found.conditions) == set(plan.CONDITIONS)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"participant": []}, "unknown key 'participant'; known: name, folder"),
        (
            {"participants": [{"name": "A1", "decodabilty": 0.7}]},
            "participant A1: unknown key 'decodabilty'; known: name",
        ),
        ({"participants": [{"name": "A1"}, {"name": "A1"}]}, "participant A1 is there twice"),
        ({"participants": [{"name": "A1"}, {"name": "a1"}]}, "participants A1 and a1 differ only in upper and lower"),
        ({"participants": [{"name": "A1"}, {"name": "A 1"}]}, "participant no. 2: 'name' must be letters and digits"),
        ({"participants": [{"name": "A1"}, {"name": "A 1"}]}, "found 'A 1'"),
        ({"participants": [{"kind": "real"}]}, "participant no. 1: 'name' is missing"),
        ({"participants": []}, "'participants' must hold at least 1, found none"),
        ({"participants": {"name": "A1"}}, "must be tables that begin with [[participants]]"),
        ({"participants": [{"name": "A1", "kind": "rehearsed"}]}, "participant A1: 'recording' is missing"),
        ({"participants": [{"name": "A1", "recording": "a.xdf"}]}, "'recording' belongs to a rehearsed participant"),
        ({"participants": [{"name": "A1", "decodability": 1.0}]}, "A1: 'decodability' must be less than 1, found 1.0"),
        (
            {"participants": [{"name": "A1", "kind": "robot"}]},
            "'kind' must be 'simulated', 'rehearsed' or 'real', found",
        ),
        ({"participants": [{"name": "A1", "kind": "real", "decodability": 0.7}]}, "only a simulated participant"),
        ({"participants": [{"name": "A1", "published": "S3"}]}, "must be one of S2"),
        ({"participants": [{"name": "A1", "kind": "real"}], "conditions": ["none", "mute"]}, "without an ErrP"),
        ({"conditions": ["ours", "none"]}, "conditions must begin with none"),
        ({"conditions": ["none", "none"]}, "none is there twice"),
        ({"conditions": ["nothing"]}, "'conditions, no. 1' must be 'none', 'paper', 'ours', 'coin' or 'mute', found"),
        ({"maps": "open"}, "'maps' must be a list in square brackets, found 'open'"),
        ({"speed": "fast"}, "'speed' must be a number, found 'fast'"),
        ({"seed": 1.5}, "'seed' must be a whole number, found 1.5"),
        ({"maps": ["open", "mine/open.txt"]}, "open is there twice"),
        ({"config": {"simulation": {"sfrq": 100}}}, "unknown key 'simulation.sfrq'"),
    ],
)
def test_a_mistake_is_one_sentence(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(SetupError) as caught:
        study(**changes)
    assert says in str(caught.value)


def test_a_missing_recording_and_a_missing_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n[[participants]]\nname = "R1"\nkind = "rehearsed"\nrecording = "gone.xdf"\n')
    with pytest.raises(SetupError, match=r"R1 is to be rehearsed from .*gone\.xdf, and there is no such file"):
        plan.load(str(path))
    with pytest.raises(SetupError, match="Can't read the study 'nowhere"):
        plan.load("nowhere.toml")
    path.write_text("name = ")
    with pytest.raises(SetupError, match="is not a TOML file"):
        plan.load(str(path))


def test_what_a_participant_is_set_to_overrides_what_all_are() -> None:
    mine = study(config={"simulation": {"decodability": 0.7, "sfreq": 256}})
    first, second = (mine.settings(who).simulation for who in mine.participants)
    assert (first.decodability, first.seed, first.sfreq) == (0.8, 4, 256)
    assert second.decodability == 0.7
    assert second.seed != first.seed


def test_a_recording_counts_by_its_content_not_by_where_it_is(tmp_path: Path) -> None:
    digests = []
    for number, content in enumerate((b"one", b"one", b"two")):
        path = tmp_path / str(number) / "hour.edf"
        path.parent.mkdir()
        path.write_bytes(content)
        mine = study(participants=[{"name": "A1", "kind": "rehearsed", "recording": str(path)}])
        digests.append(mine.digest(mine.participants[0]))
    assert digests[0] == digests[1] != digests[2]


def test_conditions_take_turns_in_being_first() -> None:
    mine = study(participants=[{"name": f"A{number}"} for number in range(6)])
    orders = [mine.schedule(who) for who in mine.participants]
    assert [order[0][0] for order in orders[:3]] == ["none", "paper", "ours"]
    assert [order[0][1] for order in orders] == ["open"] * 3 + ["obstacles"] * 3
    assert all(sorted(order) == sorted(orders[0]) for order in orders)


def test_what_is_kept_depends_on_what_matters_and_on_nothing_else() -> None:
    before = study()
    who = before.participants[0]
    assert study(speed=50, side_by_side=2, maps=["open"], conditions=["none"]).digest(who) == before.digest(who)
    assert study(seed=2).digest(who) != before.digest(who)
    assert before.digest(who) != before.digest(who.model_copy(update={"decodability": 0.81}))
    moved = study(config={"eeg": {"stream_name": "LiveAmp"}, "stimulus": {"display": 1}})
    assert moved.digest(who) == before.digest(who)
    assert study(config={"eeg": {"stream_type": "ExG"}}).digest(who) != before.digest(who)
    assert study(config={"priority": "high"}).digest(who) == before.digest(who)
    assert study(config={"priority": "high"}).settings(who).priority == "normal"  # several share the processors
    assert before.run_seed("A1", "none open") != before.run_seed("A1", "ours open")
