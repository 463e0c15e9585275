"""How samples come in: silence, gaps, the rate, and stamps that leave the clock. No LSL: rounds are handed in."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.errors import LinkLost, SetupError
from decoder.clock_drift import ClockDrift
from decoder.reception import DELAY_S, MOVED_S, SILENCE_S, Reception

SFREQ, ROUND_S = 250.0, 0.02


def made(speed: float = 1.0, lead_s: float = 2.0) -> Reception:
    return Reception("Amp", SFREQ, speed, lead_s, tolerance=0.01, patience_s=60.0)


def rounds(began: float, seconds: float, off: float = 0.0, late: float = 0.04) -> Iterator[tuple[np.ndarray, float]]:
    """(stamps, time at which they come) of an amplifier at speed 1 whose stamps are off by so much."""
    n = round(ROUND_S * SFREQ)
    for number in range(round(seconds / ROUND_S)):
        first = began + number * ROUND_S
        yield first + np.arange(n) / SFREQ + off, first + ROUND_S + late


def play(
    reception: Reception, began: float, seconds: float, off: float = 0.0, late: float = 0.04, offset: float = 0.0
) -> list[str]:
    """What is said meanwhile; `offset` is what the stream's clock is known to be behind by."""
    remarks = []
    for stamps, now in rounds(began, seconds, off, late):
        remarks += [text for _, text in reception.take(stamps, now, now, offset)]
    return remarks


def silence(reception: Reception, began: float, seconds: float) -> list[str]:
    remarks = []
    for number in range(round(seconds / ROUND_S)):
        now = began + number * ROUND_S
        remarks += [text for _, text in reception.take(np.empty(0), now, now)]
    return remarks


def test_silence_is_told_within_a_second_and_ends_only_with_enough_eeg() -> None:
    reception = made()
    assert play(reception, 0.0, 5.0) == []
    assert reception.lacks is None
    assert silence(reception, 5.1, SILENCE_S + 0.1) == ["No EEG sample for 1 s."]
    assert reception.lacks == "for EEG from 'Amp'"
    assert "back after 1." in play(reception, 7.0, 1.0)[0]
    assert reception.lacks is not None  # the next move's epoch reaches back further
    assert reception.is_to_be_asked
    play(reception, 8.0, 1.2)
    assert reception.lacks is not None  # it may be another amplifier
    reception.is_what_it_was()
    play(reception, 9.2, 0.1)
    assert reception.lacks is None
    assert (reception.n_gaps, reception.n_reconnects) == (1, 1)


def test_silence_beyond_patience_ends_the_run() -> None:
    reception = made()
    play(reception, 0.0, 3.0)
    with pytest.raises(LinkLost, match="Look at the amplifier"):
        silence(reception, 3.0, 62.0)


def test_a_process_that_was_stopped_has_heard_no_silence() -> None:
    reception = made()
    play(reception, 0.0, 3.0)
    assert reception.take(np.empty(0), 60.0, 60.0) == []
    assert reception.lacks is None


@settings(max_examples=25, deadline=None)
@given(off=st.one_of(st.floats(0.2, 300_000.0), st.floats(-300_000.0, -0.2)))
def test_stamps_that_leave_the_clock_are_told_and_waited_for(off: float) -> None:
    reception = made()
    play(reception, 0.0, 12.0)
    (told,) = play(reception, 12.0, DELAY_S + 1.0, off)
    assert "time stamps have moved" in told
    assert ("earlier" if off > 0 else "later") in told
    assert reception.moved_s == pytest.approx(-off, rel=1e-6, abs=1e-3)
    assert reception.lacks == "for the time stamps of 'Amp' to come right"
    assert play(reception, 15.0, 4.0) == ["The EEG's time stamps are right again."]
    assert reception.lacks is None


@settings(max_examples=25, deadline=None)
@given(late=st.floats(0.0, 0.9 * MOVED_S))
def test_samples_that_come_a_little_later_are_no_matter(late: float) -> None:
    reception = made()
    play(reception, 0.0, 12.0)
    assert play(reception, 12.0, 5.0, late=0.04 + late) == []
    assert reception.lacks is None


def test_samples_that_come_late_only_while_the_computer_is_busy_at_first_are_no_matter() -> None:
    reception = made()
    assert play(reception, 0.0, 3.0, late=0.3) == []
    assert play(reception, 3.0, 20.0) == []
    assert reception.lacks is None


@pytest.mark.parametrize(("late", "says"), [(0.04, None), (0.25, "later than before"), (0.9, "time stamps have moved")])
def test_a_stream_that_was_away_may_come_over_another_link(late: float, says: str | None) -> None:
    reception = made()
    play(reception, 0.0, 12.0, late=0.06)
    silence(reception, 12.1, 3.0)
    told = play(reception, 15.1, 2.6, late=late)
    reception.is_what_it_was()
    told += play(reception, 17.7, 4.0, late=late)
    assert "is back" in told[0]
    assert (says in told[1]) if says else told[1:] == []
    assert (reception.lacks is None) == (late < 0.5)


@pytest.mark.parametrize(("offset", "is_right"), [(-1e5, True), (-1e5 - 3, False), (0.0, False)])
def test_the_session_waits_until_the_clock_of_a_stream_that_is_back_was_measured_and_compared(
    offset: float, is_right: bool
) -> None:
    """Its computer was started anew: what its clock says is another time."""
    reception = made()
    play(reception, 0.0, 12.0)
    silence(reception, 12.1, 3.0)
    said = play(reception, 15.1, 4.0, off=1e5)  # what is known of its old clock tells nothing
    assert len(said) == 1
    assert reception.lacks == "for EEG from 'Amp'"
    reception.is_what_it_was()
    said += play(reception, 19.1, 0.1, off=1e5, offset=offset)
    assert (reception.lacks is None) == is_right
    assert any("time stamps have moved" in text for text in said) != is_right


def test_a_stream_that_is_back_and_does_not_answer_ends_the_run() -> None:
    reception = made()
    play(reception, 0.0, 5.0)
    silence(reception, 5.1, 3.0)
    with pytest.raises(LinkLost, match="hasn't answered what it is"):
        play(reception, 8.1, 61.0)


def test_stamps_that_stay_off_end_the_run() -> None:
    reception = made()
    play(reception, 0.0, 12.0)
    with pytest.raises(LinkLost, match="--resume"):
        play(reception, 12.0, 65.0, off=-20.0)


def test_a_clock_that_drifts_is_told_and_moves_are_placed_by_it() -> None:
    """A quarter of an hour of 100 ppm: 90 ms; each chunk comes up to 20 ms late."""
    reception, rng, told = made(), np.random.default_rng(1), []
    for number in range(90):
        for stamps, now in rounds(number * 10.0, 1.6):
            late = now + rng.exponential(0.01)
            told += [text for _, text in reception.take(stamps * (1 - 100e-6), late, late)]
        reception.take(np.empty(0), number * 10.0 + 9.9, 0.0)
        assert reception.lacks is None
    assert len(told) == 1
    assert "ppm slow. Moves are placed by it" in told[0]
    assert reception.behind_s(900.0) == pytest.approx(0.09, abs=0.005)


@given(ppm=st.floats(-150.0, 150.0), seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_a_drift_is_known_to_some_milliseconds_at_any_time(ppm: float, seed: int) -> None:
    drift, rng = ClockDrift(), np.random.default_rng(seed)
    for now in np.arange(0.0, 7200.0, 2.0):
        drift.take(now, 0.04 + now * ppm * 1e-6 + rng.exponential(0.001))
        if now > 300:
            assert drift.at(now) == pytest.approx(now * ppm * 1e-6, abs=0.015)
    assert drift.at(7200.0) == pytest.approx(7200.0 * ppm * 1e-6, abs=0.010)


@given(held_s=st.floats(0.02, 0.5), first=st.floats(100.0, 3000.0), seconds=st.floats(30.0, 3000.0))
@settings(max_examples=8, deadline=None)
def test_samples_that_a_network_holds_back_are_no_drift(held_s: float, first: float, seconds: float) -> None:
    drift = ClockDrift()
    for now in np.arange(0.0, 7200.0, 2.0):
        drift.take(now, 0.04 + held_s * (first < now < first + seconds))
        assert abs(drift.at(now)) < 0.03


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_the_rate_lately_is_that_of_the_session(speed: float) -> None:
    reception = made(speed)
    n = round(ROUND_S * speed * SFREQ)
    for number in range(200):
        now = number * ROUND_S
        reception.take((number * n + np.arange(n)) / SFREQ, now, now * speed)
    assert reception.rate_hz == pytest.approx(SFREQ, rel=0.05)


def test_a_wrong_rate_is_told_once_and_then_ends_the_run() -> None:
    reception = made()
    play(reception, 0.0, 3.0)
    times = 3.0 + np.arange(40 * 200) / 200.0  # 200 Hz instead of 250

    def go_on(n: int) -> list[str]:
        remarks = []
        for chunk in times[:n].reshape(-1, 4):
            remarks += [text for _, text in reception.take(chunk, chunk[-1] + 0.04, chunk[-1] + 0.04)]
        return remarks

    assert "drifted from 250 Hz to 20" in go_on(3000)[0]
    with pytest.raises(SetupError, match="Check the amplifier's rate"):
        go_on(len(times))
