"""Frames: what is measured of a screen, where the next picture is aimed, and what counts as late."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stimulus.pace import Pace, flips

FRAME = 1 / 60


def beat(n: int, interval: float = FRAME, sd: float = 0.0) -> list[float]:
    rng = np.random.default_rng(0)
    return (5.0 + np.arange(n) * interval + rng.normal(0, sd, n)).tolist()


def test_a_screen_that_paces_is_told_from_one_that_doesnt() -> None:
    found = flips(beat(121, sd=2e-4), may_be_paced=True, refresh_hz=60.0)
    assert found.paced
    assert found.interval_ms == pytest.approx(16.67, abs=0.05)
    assert 0.1 < found.sd_ms < 0.5
    assert (found.n, found.n_late) == (120, 0)
    assert flips(beat(50, 1 / 144), True, None).paced
    assert not flips(beat(50), may_be_paced=False, refresh_hz=60.0).paced  # a slow picture, not a screen
    assert not flips(beat(50, 2e-5), True, 60.0).paced  # vsync was granted, and isn't there
    assert not flips(beat(50, 1 / 30), True, 60.0).paced  # every second refresh is missed


def test_late_flips_are_counted_and_dont_spoil_the_rest() -> None:
    times = beat(101)
    late = [time + (0.04 if number > 50 else 0.0) for number, time in enumerate(times)]
    found = flips(late, True, 60.0)
    assert found.n_late == 1
    assert found.longest_ms == pytest.approx(56.7, abs=0.1)
    assert found.sd_ms < 0.01
    assert found.paced


def test_a_busy_computer_that_misses_half_of_the_flips_still_knows_its_screen() -> None:
    rng = np.random.default_rng(3)
    gaps = FRAME * rng.choice([1, 2, 3], 200, p=[0.5, 0.3, 0.2]) + rng.normal(0, 5e-4, 200)
    found = flips(np.cumsum(gaps).tolist(), True, 60.0)
    assert found.paced
    assert found.interval_ms == pytest.approx(16.67, abs=0.15)
    assert 60 < found.n_late < 140


@given(since=st.floats(0, 3), interval=st.floats(1 / 240, 1 / 50))
def test_the_aim_is_a_flip_that_can_still_be_reached(since: float, interval: float) -> None:
    pace = Pace(interval, paced=True)
    assert pace.aim(7.0) == 7.0  # no flip is known yet
    pace.flipped(10.0, running=False)
    aim = pace.aim(10.0 + since)
    assert 0.09 * interval <= aim - (10.0 + since) <= 1.11 * interval
    frames = (aim - 10.0) / interval
    assert frames == pytest.approx(round(frames))


def test_what_follows_at_once_must_come_a_frame_later() -> None:
    pace = Pace(FRAME, paced=True)
    assert pace.flipped(1.0, running=True) is None
    assert pace.flipped(1.0 + FRAME, running=True) is None
    assert pace.flipped(1.0 + 3 * FRAME, running=True) == pytest.approx(FRAME * 1e3)
    assert pace.flipped(1.0 + 4.2 * FRAME, running=False) is None  # the jump, in time
    assert pace.flipped(9.0, running=True) is None  # nothing was due meanwhile
    assert pace.flipped(9.0 + 5 * FRAME, running=False) == pytest.approx(4 * FRAME * 1e3)  # a late jump


def test_without_a_beat_nothing_is_aimed_at() -> None:
    pace = Pace(FRAME, paced=False)
    pace.flipped(1.0, running=True)
    assert (pace.aim(1.01), pace.lead) == (1.01, 0.0)
    assert pace.flipped(1.0 + 1.8 * FRAME, running=True) is None
    assert pace.flipped(1.0 + 4 * FRAME, running=True) is not None
