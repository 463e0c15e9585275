"""Questions that take a while: one at a time, none waited for, and no answer that holds no longer."""

import threading

import pytest
from lsl_peers import until

from bci_app.errors import LinkLost
from decoder.enquiry import Enquiry


def test_it_is_asked_once_at_a_time_and_answered_once() -> None:
    may_answer, asked = threading.Event(), []

    def ask() -> float:
        asked.append(len(asked))
        assert may_answer.wait(10)
        return 0.25

    enquiry = Enquiry(ask)
    enquiry.begin(0)
    enquiry.begin(0)
    assert enquiry.take(0) is None
    may_answer.set()
    answers = []
    until(lambda: answers.append(enquiry.take(0)) or answers[-1] is not None, 10, "the answer")
    assert answers[-1] == 0.25
    assert enquiry.take(0) is None
    assert asked == [0]


@pytest.mark.parametrize("fails", [False, True])
def test_what_was_asked_before_a_silence_is_worth_nothing(fails: bool) -> None:
    asked: list[int] = []

    def ask() -> int:
        asked.append(len(asked) + 1)
        if fails:
            raise LinkLost(f"gone {len(asked)}")
        return len(asked)

    enquiry, answers = Enquiry(ask), list[int | None]()
    enquiry.begin(0)

    def is_answered() -> bool:
        enquiry.begin(1)
        try:
            answers.append(enquiry.take(1))
        except LinkLost as error:
            answers.append(int(str(error).removeprefix("gone ")))
        return answers[-1] is not None

    until(is_answered, 10, "the answer")
    assert answers[-1] == 2
