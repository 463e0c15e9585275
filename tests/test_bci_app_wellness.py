"""Who is well: silence, failures, and what the stimulus must wait for."""

from typing import Literal

import pytest

from bci_app.protocol import Role, Status
from bci_app.wellness import HANGS_S, MOST_FAILURES, STARTING_S, WITHIN_S, Wellness

ROLES: tuple[Role, ...] = ("amplifier", "decoder", "policy", "stimulus")
State = Literal["waiting", "ready", "running", "done", "failed"]


def said(role: Role, state: State = "ready", text: str = "", **hears: float) -> Status:
    names = {name.replace("_", "-"): stamp for name, stamp in hears.items()}
    return Status(session="s", role=role, state=state, text=text, hears=names)


@pytest.fixture
def well() -> Wellness:
    wellness = Wellness(ROLES, is_calibration=False)
    for role in ROLES:
        wellness.take(role, 1.0, said(role), now=10.0)
    return wellness


def test_nobody_is_late_who_takes_no_part_or_has_not_begun() -> None:
    wellness = Wellness(("decoder", "stimulus"), is_calibration=True)
    assert wellness.lacks_eeg()
    assert wellness.hanging(1e6) == []
    wellness.take("decoder", 1.0, said("decoder"), now=10.0)
    assert not wellness.lacks_eeg()
    assert wellness.hanging(1e6) == ["decoder"]


def test_all_is_well(well: Wellness) -> None:
    assert well.troubles() == []
    assert well.hanging(10.0 + HANGS_S) == []


def test_a_decoder_that_waits_for_eeg_is_a_trouble_and_a_stimulus_that_waits_is_none(well: Wellness) -> None:
    well.take("decoder", 2.0, said("decoder", "waiting", "for EEG from 'Amp'"), now=11.0)
    well.take("stimulus", 2.0, said("stimulus", "waiting"), now=11.0)
    assert well.troubles() == ["The decoder waits for EEG from 'Amp'."]
    for state in ("ready", "done"):
        well.take("decoder", 3.0, said("decoder", state), now=12.0)
        assert well.troubles() == []


def test_silence_is_told_and_any_word_ends_it(well: Wellness) -> None:
    late = 10.0 + HANGS_S + 0.1
    well.take("policy", 5.0, None, now=late)
    assert well.hanging(late) == ["amplifier", "decoder", "stimulus"]


def test_a_process_that_is_started_again_has_time_and_its_old_words_dont_count(well: Wellness) -> None:
    assert well.failed("policy", now=20.0, stamp=11.0)
    assert well.troubles()[0] == "The policy is being started again."
    well.take("policy", 10.9, said("policy"), now=20.1)
    assert not well.is_back("policy")
    others: tuple[Role, ...] = ("amplifier", "decoder", "stimulus")
    for role in others:
        well.take(role, 30.0, None, now=20.0 + STARTING_S)
    assert well.hanging(20.0 + STARTING_S) == []
    assert well.hanging(20.0 + STARTING_S + 0.1) == ["policy"]
    well.take("policy", 12.0, said("policy", "waiting", "for the stimulus"), now=22.0)
    assert well.is_back("policy")
    assert well.hanging(20.0 + STARTING_S) == []  # it still loads, or looks for somebody
    well.take("policy", 13.0, said("policy"), now=23.0)
    assert "policy" in well.hanging(23.0 + HANGS_S + 0.1)


def test_everybody_must_hear_it_again(well: Wellness) -> None:
    well.failed("stimulus", now=20.0, stamp=11.0)
    well.take("stimulus", 12.0, said("stimulus"), now=22.0)
    assert well.troubles() == [
        "The amplifier doesn't hear bci-stimulus yet.",
        "The amplifier doesn't hear bci-truth yet.",
        "The decoder doesn't hear bci-stimulus yet.",
        "The policy doesn't hear bci-stimulus yet.",
    ]
    well.take("amplifier", 13.0, said("amplifier", bci_stimulus=12.1, bci_truth=12.1), now=23.0)
    well.take("decoder", 13.0, said("decoder", bci_stimulus=12.1), now=23.0)
    well.take("policy", 13.0, said("policy", bci_stimulus=10.9), now=23.0)
    assert well.troubles() == ["The policy doesn't hear bci-stimulus yet."]
    assert not well.hear_again("stimulus")
    well.take("policy", 14.0, said("policy", bci_stimulus=13.5), now=24.0)
    assert well.troubles() == []
    assert well.hear_again("stimulus")


def test_a_stimulus_is_answered_before_it_has_told_any_truth(well: Wellness) -> None:
    """It tells none until it knows where the run is."""
    well.failed("stimulus", now=20.0, stamp=11.0)
    well.take("stimulus", 12.0, said("stimulus", "waiting"), now=22.0)
    well.take("amplifier", 13.0, said("amplifier", bci_stimulus=12.1), now=23.0)
    well.take("decoder", 13.0, said("decoder", bci_stimulus=12.1), now=23.0)
    well.take("policy", 13.0, said("policy", bci_stimulus=12.1), now=23.0)
    assert well.hear_again("stimulus")
    assert well.troubles() == ["The amplifier doesn't hear bci-truth yet."]


def test_in_a_calibration_the_stimulus_must_hear_the_decoder() -> None:
    wellness = Wellness(("decoder", "stimulus"), is_calibration=True)
    wellness.take("stimulus", 1.0, said("stimulus"), now=1.0)
    wellness.failed("decoder", now=2.0, stamp=2.0)
    wellness.take("decoder", 3.0, said("decoder", bci_stimulus=2.5), now=3.0)
    assert wellness.troubles() == ["The stimulus doesn't hear bci-verdicts yet."]
    wellness.take("stimulus", 4.0, said("stimulus", bci_verdicts=3.0), now=4.0)
    assert wellness.troubles() == []


def test_who_has_lost_a_stream_is_told(well: Wellness) -> None:
    newest: dict[Role, float] = {"stimulus": 30.0, "decoder": 30.0, "policy": 30.0}
    well.take("decoder", 30.0, said("decoder", bci_stimulus=29.0), now=12.0)
    well.take("policy", 30.0, said("policy", bci_stimulus=29.0, bci_verdicts=20.0), now=12.0)
    well.take("stimulus", 30.0, said("stimulus", bci_actions=29.5), now=12.0)
    well.take("amplifier", 30.0, said("amplifier", bci_stimulus=29.5), now=12.0)
    assert well.deaf(newest, 4.0) == ["The policy has lost bci-verdicts."]
    assert well.deaf(newest, 11.0) == []


def test_too_many_failures_in_a_minute_are_no_accident(well: Wellness) -> None:
    assert [well.failed("policy", now=20.0 + i, stamp=20.0 + i) for i in range(MOST_FAILURES)] == [True, True, False]
    rare = Wellness(ROLES, is_calibration=False)
    assert all(rare.failed("policy", now=i * (WITHIN_S / 2 + 1), stamp=float(i)) for i in range(10))


def test_a_program_of_other_people_that_doesnt_tell_what_it_hears_is_not_taken_for_deaf() -> None:
    wellness = Wellness(("decoder", "stimulus", "policy"), is_calibration=False)
    newest: dict[Role, float] = {"decoder": 100.0, "stimulus": 100.0, "policy": 100.0}
    for role in newest:
        wellness.take(role, 1.0, said(role), now=1.0)
    assert wellness.deaf(newest, stale=4.0) == []
    wellness.take("stimulus", 2.0, said("stimulus", bci_actions=2.0), now=2.0)
    assert wellness.deaf(newest, stale=4.0) == ["The stimulus has lost bci-actions."]
