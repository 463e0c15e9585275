"""How a stream's samples come in: silence, gaps, their rate, and whether their stamps have moved against the clock.

Pure: chunks, and the times at which they came, are handed in. Real times are seconds of LSL's clock; stamps, and the
session clock's readings, are session seconds on the clock of the stamps.
"""

from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import LinkLost, SetupError
from decoder.clock_drift import ClockDrift
from decoder.timeline import MAX_JITTER, measured_rate

SILENCE_S = 1.0
"""Real seconds without a sample after which a stream is said to be silent (decided)."""
ROUND_S = 0.25
"""Real seconds a round counts as listening, at most: a process that was stopped, or starved, has heard nothing, but
what came meanwhile is still to be pulled (decided: rounds take 5 ms)."""
RATE_S = 10.0
"""Session seconds over which the rate is measured again and again."""
MOVED_S = 0.1
"""Real seconds by which samples may come later, or earlier, after their stamps than in the beginning. More is a clock
that was set or drifts, or a network that holds them back, and an epoch could be that far beside its move (decided: a
third of an ErrP)."""
SLOW_S = 1.0
"""The same in a simulation that runs faster than time: the computer that plays the amplifier may fall behind."""
LEARN_S = 10.0
"""Real seconds in which it is learnt how late samples come: this computer is busy in the first (decided)."""
OTHER_S = 0.5
"""Real seconds by which a stream that was away may come later or earlier from then on, over another link say; more is a
clock that was set (decided)."""
DELAY_S = 2.0
"""Real seconds of which the promptest sample tells how late they come: computers pause for less (decided)."""
RETURN_S = 0.5
"""The same of a stream that is back: everybody waits for it (decided)."""
LINK_S = 1.0
"""Real seconds over which a link is summed up."""

Remark = tuple[Literal["info", "warning", "error"], str]


class Reception:
    """Follows one stream of samples.

    Parameters
    ----------
    name, sfreq : of the stream; Hz.
    speed : session seconds a real second.
    lead_s : session seconds without a missing sample that must be there when the stimulus goes on.
    tolerance : largest relative difference of the rate.
    patience_s : real seconds it may be silent.
    """

    def __init__(
        self, name: str, sfreq: float, speed: float, lead_s: float, tolerance: float, patience_s: float
    ) -> None:
        self._name, self._sfreq, self._speed = name, sfreq, speed
        self._most_moved_s = MOVED_S if speed <= 1 else SLOW_S * speed
        self._lead_s, self._tolerance, self._patience_s = lead_s, tolerance, patience_s
        self._listened: float | None = None
        self.quiet_s = 0.0
        """Real seconds listened to without a sample."""
        self.is_silent = False
        self._whole_since = self._newest = np.inf  # stamps: from the one to the other no sample is missing
        self._is_short = False  # of samples before the next move
        self._back_at = 0.0
        self._was_away = False  # and must be asked what it is, on which clock, before it counts again
        self._delays: deque[tuple[float, float]] = deque()  # of the last seconds: when it came, and how late, session s
        self._usual: float | None = None  # how late they come, session seconds,
        self._learning_since = np.inf  # and since when that is learnt
        self._is_other_link = False
        self._moved_since: float | None = None
        self._drift = ClockDrift()
        self._has_drifted = False
        self.moved_s = 0.0
        """Session seconds by which they come later than in the beginning; 0 for less than matters."""
        self._rate_times = np.empty(0)
        self._rate_is_off = False
        self.n_gaps = self.n_reconnects = 0
        self._n_lately, self._lately_since = 0, -np.inf
        self.rate_hz: float | None = None
        """Samples a session second, lately."""

    def take(self, times: NDArray[np.float64], now: float, session_now: float, offset: float = 0.0) -> list[Remark]:
        """Take in a round, at real time `now`, that brought samples stamped `times` (n_times,), or none.

        `session_now` is the same moment on the session clock, `offset` what has to be added to the stream's own clock,
        real seconds, to come to this computer's; after a silence it counts only once `is_what_it_was` was told.

        Returns what is to be told. Raises LinkLost for a silence longer than patience, SetupError for a wrong rate.
        """
        remarks = self._listen(len(times), now)
        if len(times):
            self._look_for_gap(times)
            remarks += self._compare_clocks(float(times[-1]), now, session_now, offset)
            remarks += self._check_rate(times)
        self._sum_up(len(times), now)
        if self._is_short and self._is_whole() and self.is_known and not self._is_other_link and not self.moved_s:
            self._is_short = False
        return remarks

    @property
    def n_silences(self) -> int:
        """How often it fell silent: what was asked before the last time tells nothing any more."""
        return self.n_reconnects + self.is_silent

    @property
    def is_to_be_asked(self) -> bool:
        """Whether it was away, is back, and what it is by now, and on which clock, isn't known."""
        return self._was_away and not self.is_silent

    def is_what_it_was(self) -> None:
        """It was asked: it is, and its clock has been measured anew."""
        self._was_away = False

    @property
    def is_known(self) -> bool:
        """Whether it is there, and what it is and on which clock is known."""
        return not (self.is_silent or self._was_away)

    @property
    def lacks(self) -> str | None:
        """What it must be waited for, in words; None where a move can be judged."""
        if self.is_silent or (self._is_short and not self.moved_s):
            return f"for EEG from '{self._name}'"
        return f"for the time stamps of '{self._name}' to come right" if self.moved_s else None

    def _is_whole(self) -> bool:
        return not self.is_silent and self._newest - self._whole_since >= self._lead_s

    def _listen(self, n_new: int, now: float) -> list[Remark]:
        elapsed = 0.0 if self._listened is None else min(now - self._listened, ROUND_S)
        before, self.quiet_s = self.quiet_s, 0.0 if n_new else self.quiet_s + elapsed
        self._listened = now
        if self.quiet_s > self._patience_s:
            raise LinkLost(f"No EEG sample for {self.quiet_s:.0f} s. Look at the amplifier; what was recorded is kept.")
        if self.is_to_be_asked and now - self._back_at > self._patience_s:
            raise LinkLost(
                f"The EEG is back, but in {self._patience_s:.0f} s its sender hasn't answered what it is and what its "
                "clock says. Look at the firewall (UDP) of its computer; what was recorded is kept."
            )
        if n_new and self.is_silent:
            self.is_silent, self._was_away, self._is_other_link = False, True, True
            self._back_at = now
            self._delays.clear()
            self.n_reconnects += 1
            return [("info", f"The EEG is back after {before:.1f} s.")]
        if not self.is_silent and self.quiet_s > SILENCE_S:
            self.is_silent = self._is_short = True
            return [("error", f"No EEG sample for {SILENCE_S:g} s.")]
        return []

    def _look_for_gap(self, times: NDArray[np.float64]) -> None:
        """Keep in mind since when no sample is missing."""
        steps = np.diff(times, prepend=self._newest if np.isfinite(self._newest) else times[0])
        breaks = np.flatnonzero((steps > 2 * MAX_JITTER) | (steps < -MAX_JITTER))
        self.n_gaps += len(breaks)
        if len(breaks) or not np.isfinite(self._whole_since):
            self._whole_since = float(times[breaks[-1] if len(breaks) else 0])
        self._newest = float(times[-1])
        if np.any(np.abs(steps) > self._most_moved_s):
            self._delays.clear()  # what came before tells nothing of how late samples come from here on

    def _compare_clocks(self, newest: float, now: float, session_now: float, offset: float) -> list[Remark]:
        """Stamps are only worth something while what they say of now is what it was."""
        self._delays.append((now, session_now - newest))
        while now - self._delays[0][0] > DELAY_S:
            self._delays.popleft()
        if self._was_away or now - self._delays[0][0] < (RETURN_S if self._is_other_link else DELAY_S / 2):
            return []
        delay = min(late for _, late in self._delays) - offset * self._speed
        remarks: list[Remark] = []
        was_other_link, self._is_other_link = self._is_other_link, False
        if was_other_link and self._usual is not None:
            later = delay - self._usual - self.behind_s(now)
            if MOVED_S * self._speed < abs(later) < OTHER_S * self._speed:
                self._usual += later
                how = "later" if later > 0 else "earlier"
                text = f"Since it is back the EEG comes {abs(later):.3f} s {how} than before."
                remarks.append(("warning", f"{text} That is taken for the link's doing, not the clock's."))
        if self._usual is None:
            self._usual, self._learning_since = delay, now
        elif now - self._learning_since < LEARN_S and self._usual - delay < OTHER_S * self._speed:
            self._usual = min(self._usual, delay)
        if self._speed <= 1 and not self.moved_s:
            self._drift.take(now, delay)
        later, had_moved = delay - self._usual - self.behind_s(now), bool(self.moved_s)
        self.moved_s = later if abs(later) > self._most_moved_s else 0.0
        if self.moved_s and not had_moved:
            self._is_short, self._moved_since = True, now
            how = "later" if later > 0 else "earlier"
            text = (
                f"The EEG's time stamps have moved: its samples come {abs(later):.3f} s {how} after them than before."
            )
            remarks.append(
                ("error", f"{text} No move can be judged until the amplifier's clock, or network, is right.")
            )
        elif self._moved_since is not None and self.moved_s and now - self._moved_since > self._patience_s:
            raise LinkLost(
                f"The EEG's time stamps have been {abs(later):.3f} s off for {now - self._moved_since:.0f} s. End the "
                "run, restart the amplifier's connector, and go on with --resume; what was recorded is kept."
            )
        if had_moved and not self.moved_s:
            remarks.append(("info", "The EEG's time stamps are right again."))
        if self._drift.ppm and not self._has_drifted:
            self._has_drifted = True
            slow = "slow" if self._drift.ppm > 0 else "fast"
            text = f"The amplifier's clock is {abs(self._drift.ppm):.0f} ppm {slow}. Moves are placed by it."
            remarks.append(("warning", text))
        return remarks

    def behind_s(self, now: float) -> float:
        """Seconds by which the amplifier's clock has fallen behind since the beginning, by its drift."""
        return self._drift.at(now)

    def _check_rate(self, times: NDArray[np.float64]) -> list[Remark]:
        self._rate_times = np.concatenate((self._rate_times, times))
        if len(self._rate_times) < RATE_S * self._sfreq:
            return []
        rate, self._rate_times = measured_rate(self._rate_times, self._sfreq), np.empty(0)
        was_off, self._rate_is_off = self._rate_is_off, not abs(rate / self._sfreq - 1) <= self._tolerance
        sentence = f"Stream '{self._name}' drifted from {self._sfreq:g} Hz to {rate:.1f} Hz."
        if was_off and self._rate_is_off:
            raise SetupError(f"{sentence} Check the amplifier's rate and connection; what was recorded is kept.")
        return [("error", sentence)] if self._rate_is_off else []

    def _sum_up(self, n_new: int, now: float) -> None:
        self._n_lately += n_new
        if now - self._lately_since >= LINK_S:
            elapsed_s = (now - self._lately_since) * self._speed
            self.rate_hz = self._n_lately / elapsed_s if np.isfinite(elapsed_s) else None
            self._n_lately, self._lately_since = 0, now
