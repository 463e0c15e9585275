"""What bci-app makes of what it hears of a run."""

from pathlib import Path
from typing import Literal

import numpy as np
from test_bci_app_said import chosen, end, move, opening, start, verdict

from bci_app.eeg import EegDescription
from bci_app.heard import Heard
from bci_app.protocol import (
    AnyMessage,
    Continued,
    Electrodes,
    EpisodeGoal,
    Note,
    Pause,
    Resume,
    Role,
    SessionEnd,
    Status,
    Truth,
    Verdict,
)
from bci_app.recording import Recording, Stamped

ROLES: tuple[Role, ...] = ("decoder", "policy", "stimulus")
EEG = EegDescription("Amp", "amp", "here", ("Fz",), ("uV",), ("EEG",), 10.0)


def said(role: Role, state: Literal["waiting", "ready"], text: str = "") -> Status:
    return Status(session="s", role=role, state=state, text=text)


def heard(*messages: AnyMessage) -> Heard:
    made = Heard(ROLES)
    for message in messages:
        made.take(message)
    return made


def recording(*messages: AnyMessage, marked: tuple[int, ...] = (), damage: tuple[str, ...] = ()) -> Recording:
    """One message a second from 0 on, with markers at some of them."""
    stamped = tuple(Stamped(float(at), message) for at, message in enumerate(messages))
    nothing = np.zeros((0, 1), np.float32)
    return Recording(Path("x.xdf"), EEG, nothing, np.zeros(0), stamped, damage, tuple((float(at), 1) for at in marked))


def test_all_must_be_ready_and_one_that_is_started_again_must_be_so_anew() -> None:
    made = heard(*(said(role, "ready") for role in ROLES))
    assert made.all_ready()
    made.forget("policy")
    assert not made.all_ready()
    assert "policy was not heard of" in made.whereabouts()
    made.take(said("policy", "waiting", "for the decoder"))
    assert not made.all_ready()
    assert "policy is waiting for the decoder" in made.whereabouts()


def test_of_two_verdicts_on_a_move_the_first_counts_and_late_ones_say_nothing_of_the_eeg() -> None:
    def bad(step: int, by_time: bool = False) -> Verdict:
        fields = {"episode": 0, "step": step, "by_time": by_time, "clock_offset": 0.0, "reason": "flat"}
        return Verdict.model_validate({"session": "s", "outcome": "rejected", **fields})

    made = heard(verdict(0, 1), bad(1), bad(2), bad(3, by_time=True), bad(4))
    assert made.verdicts == {"error": 1, "rejected": 3}
    assert made.rejected_in_a_row == 2
    assert made.last_reason == "flat"
    made.take(verdict(0, 5))
    assert made.rejected_in_a_row == 0


def test_what_a_stimulus_that_was_started_again_does_not_remember_does_not_count() -> None:
    made = heard(
        opening(), start(0), move(0, 1), verdict(0, 1), chosen(0, 2), move(0, 2), verdict(0, 2), chosen(0, 3),
        Continued(session="s", episode=0, step=1),
    )  # fmt: skip
    assert made.moves == 1
    assert made.verdicts == {"error": 1}
    assert not made.missing_in(recording(move(0, 1), verdict(0, 1), chosen(0, 2)), has_truth=False)


def test_a_pause_is_by_a_person_or_by_the_session() -> None:
    made = heard(Pause(session="s", reason="a break", by_person=True))
    assert made.is_paused
    assert made.is_paused_by_person
    made.take(Resume(session="s"))
    assert not made.is_paused
    assert not made.is_paused_by_person


def test_whatever_was_heard_and_is_not_in_the_recording_is_told() -> None:
    truth = Truth(session="s", episode=0, step=1, error=True, distance=3)
    goal = EpisodeGoal(session="s", episode=0, goal=(5, 5), distance=4)
    made = heard(move(0, 1), verdict(0, 1), chosen(0, 2))
    whole = (move(0, 1), verdict(0, 1), chosen(0, 2), truth, goal)
    assert made.all_judged()
    assert made.missing_in(recording(*whole, marked=(0,)), has_truth=True) == []
    for left_out, said_to_lack in ((1, "verdicts"), (2, "actions")):
        rest = whole[:left_out] + whole[left_out + 1 :]
        assert made.missing_in(recording(*rest, marked=(0,)), has_truth=True) == [
            f"1 of 1 {said_to_lack} are not in it."
        ]
    assert made.missing_in(recording(*whole[:3]), has_truth=True) == [
        f"1 of 1 moves have no {what} in it." for what in ("truth", "marker", "goal")
    ]
    assert made.missing_in(recording(*whole, marked=(4,)), has_truth=True) == ["1 of 1 moves have no marker in it."]
    assert made.missing_in(recording(*whole[1:]), has_truth=False) == ["1 of 1 moves are not in it."]
    assert made.missing_in(recording(*whole, damage=("Cut.",)), has_truth=False) == ["Cut."]


def test_why_a_run_ended_is_what_bci_app_says_before_what_the_stimulus_says() -> None:
    made = heard(opening(), Note(session="s", role="decoder", level="warning", text="C3 is bad."))
    path = Path("x.xdf")
    assert made.outcome(path).reason == "failed"
    assert "never said" in made.outcome(path).text
    made.take(SessionEnd(session="s", reason="complete", text="All done."))
    assert (made.outcome(path).reason, made.outcome(path).text) == ("complete", "All done.")
    made.ending = ("failed", "The recorder died.")
    outcome = made.outcome(path, verified="All is there.")
    assert (outcome.reason, outcome.text, outcome.verified) == ("failed", "The recorder died.", "All is there.")
    assert outcome.notes == ("decoder: C3 is bad.",)


def test_progress_of_both_tasks() -> None:
    assert heard().progress()[2] == 1
    made = heard(opening(), start(0), Electrodes(session="s", episode=0, bad={"C3": ["flat"]}), end(0))
    assert made.progress()[1:] == (1, 2)
    assert "bad: C3" in made.progress()[0]
    made = heard(opening().model_copy(update={"n_moves": 40}), move(0, 1), verdict(0, 1))
    assert made.progress() == ("calibration", 1, 40)
