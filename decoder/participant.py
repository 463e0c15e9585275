"""A participant to rehearse with: EEG that answers moves, and answers errors with an error-related potential."""

from abc import ABC, abstractmethod
from bisect import bisect_left, insort
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from decoder.background import Background, SyntheticBackground, bump, moment, remember
from decoder.montage import directions

Array = NDArray[np.float64]

RESPONSE_S = (0.05, 0.95)
"""Seconds after a move between which the answer may differ from 0."""
GAIN_UV = 8.0
"""Standard deviation of a trial's ErrP amplitude, uV at the positive peak (decided)."""
SEPARATION = (
    (0.5, 0.0),
    (0.579, 0.4),
    (0.638, 0.7),
    (0.726, 1.2),
    (0.752, 1.35),
    (0.816, 1.8),
    (0.894, 2.5),
    (0.963, 3.6),
)
"""Balanced accuracy and the distance of the two classes' mean amplitudes in `GAIN_UV` that gives it: means over 5 seeds
at 500 Hz, 600 moves, tenfold cross-validation (measured by `benchmarks/decoder_decodability.py`). It is what the
amplitudes allow: the normal distribution function of half the distance."""
LATENCY_S = 0.008
"""Standard deviation of a trial's latency, s (decided)."""
N_STRATA = 20
"""Trials of a class over which amplitudes cover the normal distribution evenly (decided)."""


@dataclass(frozen=True)
class Wave:
    """One deflection: height (relative to the gain, or uV), latency and width (standard deviation) in s."""

    height: float
    latency: float
    width: float


ERRP = (Wave(-0.7, 0.21, 0.025), Wave(1.0, 0.30, 0.035), Wave(-0.8, 0.41, 0.050))
"""Error minus correct at Fz: negative near 200 ms, positive near 300 ms, negative near 400 ms (paper V.C.1)."""
VISUAL = (Wave(3.0, 0.11, 0.020), Wave(-4.0, 0.17, 0.025))
"""Occipital response to any move, uV (decided)."""
LATE = (Wave(4.0, 0.36, 0.070),)
"""Parietal response to any move, uV (decided)."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The response to one move: ``courses.T @ maps``, uV.

    Attributes
    ----------
    first : number of its first sample.
    courses : (n_waves, n_times).
    maps : (n_waves, n_channels), shared by the answers of a person.
    """

    first: int
    courses: Array
    maps: Array


class Person(ABC):
    """EEG of somebody who watches moves: an answer to each is laid over a background.

    Parameters
    ----------
    background : the EEG to answer in.
    t0 : session time of sample 0, s.
    """

    def __init__(self, background: Background, t0: float) -> None:
        self._background = background
        self._t0 = t0
        self._n_moves = [0, 0]
        self._answers: list[Answer] = []
        self._recent: OrderedDict[int, Array] = OrderedDict()
        self._rendered = 0

    @property
    def sfreq(self) -> float:
        """Rate, Hz."""
        return self._background.sfreq

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        return self._background.names

    def respond(self, onset: float, error: bool, size: float = 1.0) -> bool:
        """Answer a move at session time `onset`, an error by an ErrP of a `size` relative to the person's own.

        False when samples that belong to the answer have been rendered already: the move was told too late.
        """
        number = self._n_moves[error]
        self._n_moves[error] += 1
        answer = self._answer(onset - self._t0, error, number, size)
        insort(self._answers, answer, key=lambda other: other.first)
        return answer.first >= self._rendered

    def render(self, start: int, n_times: int) -> NDArray[np.float32]:
        """Samples from number `start` >= 0 on: float32, (n_times, n_channels), uV. The same in chunks of any size."""
        samples = self._background.samples(start, n_times)
        longest = ceil((RESPONSE_S[1] - RESPONSE_S[0]) * self.sfreq) + 1
        begin = bisect_left(self._answers, start - longest, key=lambda answer: answer.first)
        for answer in self._answers[begin:]:
            if answer.first >= start + n_times:
                break
            # The whole answer is mixed before it is cut: a product of another shape may round otherwise.
            data = self._mixed(answer)
            a, b = max(start, answer.first), min(start + n_times, answer.first + len(data))
            if a < b:
                samples[a - start : b - start] += data[a - answer.first : b - answer.first]
        self._rendered = max(self._rendered, start + n_times)
        return samples.astype(np.float32)

    def forget(self, before: int) -> None:
        """Answers that end before sample number `before` won't be rendered again: sessions may last all day."""
        longest = ceil((RESPONSE_S[1] - RESPONSE_S[0]) * self.sfreq) + 1
        n_over = bisect_left(self._answers, before - longest, key=lambda answer: answer.first)
        for answer in self._answers[:n_over]:
            self._recent.pop(id(answer), None)  # another may get its id
        del self._answers[:n_over]

    def _mixed(self, answer: Answer) -> Array:
        key = id(answer)
        if key not in self._recent:
            remember(self._recent, key, answer.courses.T @ answer.maps)
        return self._recent[key]

    @abstractmethod
    def _answer(self, onset: float, error: bool, number: int, size: float) -> Answer:
        """The answer to a class's move `number`, at `onset` s after sample 0, all of it within `RESPONSE_S`."""


class Participant(Person):
    """A made-up person.

    Parameters
    ----------
    seed : the same seed gives the same person, to the bit.
    sfreq : rate, Hz.
    decodability : balanced accuracy that our decoder reaches on this person in cross-validation over 600 moves;
        measured for the synthetic background, in a recorded one it is some points lower.
    errp : False: error moves are answered like correct ones.
    background : the EEG to answer in; synthetic by default. Its rate and channels are used then.
    t0 : session time of sample 0, s.
    run : another number, another hour of the same person: other noise and other single trials.

    Notes
    -----
    Each move evokes ``common + gain * ErrP`` with normal gains of one variance; an error moves their mean up. The
    gains vary more than the EEG around them and are stratified, so that 600 moves of any seed come closer to the
    decodability asked for than chance allows independent moves: within 0.03 for nine seeds in ten (measured).
    """

    def __init__(
        self,
        seed: int,
        sfreq: float = 500.0,
        decodability: float = 0.75,
        errp: bool = True,
        *,
        background: Background | None = None,
        t0: float = 0.0,
        run: int = 0,
    ) -> None:
        super().__init__(background or SyntheticBackground(seed, sfreq, run), t0)
        self._moment = moment(seed, run)
        self._mean_uv = GAIN_UV * separation(decodability) if errp else 0.0
        rng = np.random.default_rng([seed, 3])
        self._tempo = rng.uniform(0.95, 1.05)
        where = directions(self.names)
        # Centred between FCz and Fz, a few centimetres wide; every person a little different.
        errp_map = bump(where, (rng.normal(0, 0.05), 0.6 + rng.normal(0, 0.1), 0.85), 0.55)
        self._maps = np.stack([errp_map, bump(where, (0, -1, 0.1), 0.45), bump(where, (0, -0.5, 0.9), 0.6)])

    def _answer(self, onset: float, error: bool, number: int, size: float) -> Answer:
        rng = np.random.default_rng([self._moment, 4, int(error), number])
        gain = GAIN_UV * stratified_normal(self._moment, int(error), number) + (size * self._mean_uv if error else 0.0)
        visual, late = rng.normal(1, 0.15, 2)
        first = ceil((onset + RESPONSE_S[0]) * self.sfreq)
        last = floor((onset + RESPONSE_S[1]) * self.sfreq)
        seconds = (np.arange(first, last + 1) / self.sfreq - onset) / self._tempo - rng.normal(0, LATENCY_S)
        courses = [gain * _course(ERRP, seconds), visual * _course(VISUAL, seconds), late * _course(LATE, seconds)]
        return Answer(first, np.stack(courses), self._maps)


def separation(decodability: float) -> float:
    """Distance of the two classes' mean ErrP amplitudes, in `GAIN_UV`, for a decodability; from `SEPARATION`."""
    known, distances = zip(*SEPARATION, strict=True)
    # Accuracy is nearly a normal distribution function of the distance: interpolate along that.
    return float(np.interp(ndtri(decodability), ndtri(known), distances))


def stratified_normal(seed: int, stream: int, number: int) -> float:
    """A normal deviate: every `N_STRATA` of a stream in a row fall one into each of as many equally likely parts."""
    group, place = divmod(number, N_STRATA)
    part, within = _strata(seed, stream, group)
    return float(ndtri((part[place] + within[place]) / N_STRATA))


@lru_cache(maxsize=64)
def _strata(seed: int, stream: int, group: int) -> tuple[NDArray[np.int64], Array]:
    rng = np.random.default_rng([seed, 5, stream, group])
    return rng.permutation(N_STRATA), rng.random(N_STRATA)


def _course(waves: tuple[Wave, ...], seconds: Array) -> Array:
    course: Array = np.sum([w.height * np.exp(-(((seconds - w.latency) / w.width) ** 2) / 2) for w in waves], axis=0)
    return course
