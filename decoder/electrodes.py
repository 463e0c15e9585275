"""Which electrodes are bad, decided at the start of each episode and kept until the next, or until moves are rejected.

Decided from the EEG just before, on what is in the record alone: a replay decides the same from the same samples.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bci_app.protocol import Electrodes
from decoder.eyes import is_eog
from decoder.quality import Fault, Inspector
from decoder.timeline import MAX_JITTER

WINDOW_S = 10.0
"""Seconds before an episode that are looked at (decided: drifts show, and a blink or two don't)."""
EOG_FAULTS: frozenset[Fault] = frozenset({"not finite", "railed", "flat"})
"""What makes an EOG channel bad: it is meant to differ from its neighbours, and to be large."""
RECORDED_S = 6.0
"""Session seconds before a run's first message that are in the record for certain: what is older isn't looked at."""


class Examiner:
    """Looks at the EEG before each episode.

    Parameters
    ----------
    session : goes into every message.
    channels : of the stream, EOG too.
    sfreq : rate, Hz. Raises SetupError where that is too slow to tell noise from EEG.
    """

    def __init__(self, session: str, channels: Sequence[str], sfreq: float) -> None:
        self._session = session
        self._inspector = Inspector(channels, sfreq)
        self.n_window = round(WINDOW_S * sfreq)

    def examine(
        self,
        key: tuple[int, int],
        samples: NDArray[np.floating],
        times: NDArray[np.float64],
        since: float,
        before: Electrodes | None = None,
    ) -> Electrodes:
        """What is bad from this (episode, step) on. What lies before a gap isn't looked at: levels differ there.

        Parameters
        ----------
        samples, times : (n_times, n_channels), uV, and (n_times,), raw stamps; the newest `n_window` or fewer.
        since : stamp of the EEG from which on samples are recorded for certain.
        before : the decision that holds until then.
        """
        if not len(times):
            return self.decide(key, samples, times, before)
        after_gap = np.flatnonzero(np.diff(times) > 2 * MAX_JITTER)[-1:] + 1
        first = max(int(np.searchsorted(np.maximum.accumulate(times), since)), *after_gap.tolist(), 0)
        return self.decide(key, samples[first:], times[first:], before)

    def decide(
        self,
        key: tuple[int, int],
        samples: NDArray[np.floating],
        times: NDArray[np.float64],
        before: Electrodes | None = None,
    ) -> Electrodes:
        """What is bad over exactly these samples; where they are too few, what was so before."""
        episode, step = key
        if len(samples) < self._inspector.n_least:
            return Electrodes(session=self._session, episode=episode, step=step, bad=before.bad if before else {})
        qualities = self._inspector.inspect(np.asarray(samples, dtype=np.float64))
        faults = {
            quality.name: [fault for fault in quality.faults if not is_eog(quality.name) or fault in EOG_FAULTS]
            for quality in qualities
        }
        return Electrodes(
            session=self._session,
            episode=episode,
            step=step,
            bad={name: found for name, found in faults.items() if found},
            last_time=float(times[-1]),
            n_samples=len(samples),
        )

    def again(self, before: Electrodes, samples: NDArray[np.floating], times: NDArray[np.float64]) -> Electrodes:
        """The same decision from a recording's samples, (n_times, n_channels), uV, and stamps.

        Where the samples it was made on aren't all there, it is taken over.
        """
        if before.last_time is None:
            return before
        ends = np.flatnonzero(times == before.last_time)
        if not len(ends) or ends[-1] + 1 < before.n_samples:
            return before
        window = slice(ends[-1] + 1 - before.n_samples, ends[-1] + 1)
        return self.decide((before.episode, before.step), samples[window], times[window])


def changes(before: Electrodes | None, now: Electrodes) -> list[str]:
    """What is new about the electrodes, a sentence each."""
    known = before.bad if before else {}
    sentences = [f"Channel {name} is bad: {', '.join(now.bad[name])}." for name in now.bad if name not in known]
    return sentences + [f"Channel {name} is good again." for name in known if name not in now.bad]
