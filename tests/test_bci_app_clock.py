"""Session time, with a clock one can set."""

from hypothesis import given
from hypothesis import strategies as st

from bci_app.clock import Clock

reals = st.floats(0, 1e6)


@given(reals, reals)
def test_at_speed_one_session_time_is_real_time_to_the_bit(now: float, origin: float) -> None:
    assert Clock(lambda: now, 1.0, origin).now() == now


@given(st.floats(0.5, 50), reals, st.floats(0, 1e4))
def test_a_session_runs_so_many_times_faster(speed: float, origin: float, elapsed: float) -> None:
    clock = Clock(lambda: origin + elapsed, speed, origin)
    assert abs(clock.now() - (origin + elapsed * speed)) < 1e-3
    assert abs(clock.real_until(clock.now() + speed) - 1) < 1e-3
    assert clock.real_until(clock.now() - 1) == 0
