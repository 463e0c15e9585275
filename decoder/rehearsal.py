"""A participant learnt from a recorded calibration: the person's own background and responses, drawn anew.

Background: the recording without its responses, in stretches of another order and alignment. Responses: what both
halves of the recording agree on, and the trial-to-trial spread of its size. Whole trials are never played again: a
trial that came twice would be known to a decoder from training when it is tested on it.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bci_app.errors import SetupError
from decoder.background import from_blocks, moment, remember
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.participant import RESPONSE_S, Answer, Person, stratified_normal
from decoder.timeline import piece_edges

Array = NDArray[np.float64]

LEVEL_S = 0.1
"""Half of the time over which the EEG's level is taken at a response's beginning and end, s (decided)."""
MAX_HZ = 15.0
"""Highest frequency of a response: the ErrP's and the visual response's waves are 50 ms long and more (decided)."""
ELSEWHERE_S = 1.45
"""Seconds after a move to where the EEG is looked at without a response; moves are 3 s apart (decided)."""
N_COMPONENTS = 3
"""Components taken of each half's response; the made-up ErrP is one, published ones two or three (decided)."""
RIDGE = 0.05
"""Part of each channel's variance added to the channels' covariance, so that its inverse exists (decided)."""
STRETCH_S = 20.0
"""Seconds of background played in one piece (decided): long against the decoder's reach back of 3.3 s."""
FADE_S = 1.0
"""Seconds over which one stretch fades into the next (decided)."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """What a recording tells of a person.

    Attributes
    ----------
    background : float32, (n_times, n_channels), uV, the recording less its responses.
    edges : int64, (n_pieces + 1,), where the recording's gapless pieces begin, and the end.
    courses, maps : (n_components, n_response) and (n_components, n_channels), uV: the response to any move.
    errp_courses, errp_maps : the same of what an error adds.
    spread : standard deviation of a trial's ErrP, in mean ErrPs.
    scale : the mean ErrP's size, 1 as estimated. Estimates from noise are never quite what they seem to the decoder;
        `bci_app.rehearsing` finds the size at which it reaches the recording's own accuracy.
    names, sfreq : channels, and rate in Hz.
    """

    background: NDArray[np.float32]
    edges: NDArray[np.int64]
    courses: Array
    maps: Array
    errp_courses: Array
    errp_maps: Array
    spread: float
    scale: float
    names: tuple[str, ...]
    sfreq: float


def learn(
    samples: NDArray[np.floating],
    times: Array,
    onsets: Sequence[float],
    error: NDArray[np.bool_],
    names: tuple[str, ...],
    sfreq: float,
) -> Likeness:
    """Take a recording apart.

    Parameters
    ----------
    samples, times : (n_times, n_channels), uV, and raw stamps, (n_times,), s.
    onsets, error : of the moves whose epochs are valid, (n_moves,), on the clock of the stamps, and the truth.

    Raises SetupError when too few moves of a class, or no gapless stretch, are there.
    """
    background = np.nan_to_num(np.asarray(samples, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0, copy=True)
    edges = piece_edges(times)
    if np.diff(edges).max() < round((STRETCH_S + FADE_S) * sfreq):
        raise SetupError(
            f"The longest stretch of this recording without a gap is {np.diff(edges).max() / sfreq:.1f} s; a rehearsal "
            f"is drawn from stretches of {STRETCH_S + FADE_S:g} s at least. Give a longer recording."
        )
    first, trials, known = _trials(background, times, onsets, error, sfreq)
    elsewhere = _trials(background, times, [onset + ELSEWHERE_S for onset in onsets], error, sfreq)[1]
    if min(known.sum(), (~known).sum(), len(elsewhere)) < 2 * N_COMPONENTS:
        raise SetupError(
            f"Responses can't be learnt from {known.sum()} error and {(~known).sum()} correct moves with EEG around "
            f"them; {2 * N_COMPONENTS} of each are needed. Give a whole calibration."
        )
    noise = Noise.of(elsewhere)
    errors, corrects = trials[known], trials[~known]
    waves = _waves(sfreq)
    courses, maps = reproducible(corrects[::2].mean(axis=0), corrects[1::2].mean(axis=0), noise)
    halves = [errors[part::2].mean(axis=0) - corrects[part::2].mean(axis=0) for part in (0, 1)]
    errp_courses, errp_maps = reproducible(halves[0], halves[1], noise)
    sizes, spread, kept = _sizes(trials, known, elsewhere, errp_courses.T @ errp_maps, noise)
    for begin, is_error, size in zip(first, known, sizes, strict=True):
        response = waves @ (
            (errors if is_error else corrects).mean(axis=0) + kept * size * (errp_courses.T @ errp_maps)
        )
        background[begin : begin + len(response)] -= response.astype(np.float32)
    courses, errp_courses = courses @ waves.T, errp_courses @ waves.T
    return Likeness(background, edges, courses, maps, errp_courses, errp_maps, spread, 1.0, names, sfreq)


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariances of the EEG without responses: the product of one in time and one across channels.

    Attributes
    ----------
    in_time : (n_waves, n_waves) of the weights of `_waves`, without unit.
    across : (n_channels, n_channels), uV**2.
    """

    in_time: Array
    across: Array

    @classmethod
    def of(cls, elsewhere: Array) -> "Noise":
        """From weights of stretches of EEG, (n, n_waves, n_channels). Raises SetupError when most channels are flat."""
        _, n_waves, n_channels = elsewhere.shape
        across = _covariance(elsewhere.reshape(-1, n_channels))
        white = np.linalg.solve(np.linalg.cholesky(across), elsewhere.reshape(-1, n_channels).T)
        by_time = white.reshape(-1, n_waves)
        return cls(_covariance(by_time), across)


def reproducible(one: Array, other: Array, noise: Noise) -> tuple[Array, Array]:
    """What two halves of the trials agree on: courses (n_components, n_waves) and maps (n_components, n_channels).

    Each half's mean, (n_waves, n_channels), has true response and noise in it. Its singular components, where the
    noise is white, are made as large as they are in the other half, whose noise is another: so the size of
    each is unbiased but for the components that the other half hasn't at all, which are left out. Mean of both ways.
    """
    in_time, across = np.linalg.cholesky(noise.in_time), np.linalg.cholesky(noise.across)
    white = [np.linalg.solve(across, np.linalg.solve(in_time, half).T).T for half in (one, other)]
    courses, maps = [], []
    for own, test in (white, white[::-1]):
        u, _, vt = np.linalg.svd(own, full_matrices=False)
        for course, pattern in zip(u.T[:N_COMPONENTS], vt[:N_COMPONENTS], strict=True):
            courses.append(in_time @ course)
            maps.append(max(0.0, float(course @ test @ pattern)) / 2 * across @ pattern)
    return np.stack(courses), np.stack(maps)


class RedrawnBackground:
    """A likeness's background for ever: its stretches in drawn order, each faded into the next.

    Parameters
    ----------
    likeness : whose.
    seed : of order and alignment. After all stretches have been played they are cut elsewhere, and drawn again.
    """

    def __init__(self, likeness: Likeness, seed: int) -> None:
        self.names = likeness.names
        self.sfreq = likeness.sfreq
        self._data = likeness.background
        self._seed = seed
        self._n_fade = round(FADE_S * self.sfreq)
        self._n_step = round((STRETCH_S - FADE_S) * self.sfreq)
        self._offset = np.median(self._data[:: max(1, round(self.sfreq))], axis=0).astype(np.float64)
        pieces = [(a, b - a) for a, b in pairwise(likeness.edges.tolist())]
        counts = [(length - self._n_fade) // self._n_step for _, length in pieces]
        # One stretch fewer than fit leaves room to cut them elsewhere every time.
        self._pieces = [(*piece, max(1, n - 1)) for piece, n in zip(pieces, counts, strict=True) if n]
        self._per_cycle = sum(n for _, _, n in self._pieces)
        angle = np.pi / 2 * (np.arange(self._n_fade)[:, None] + 0.5) / self._n_fade
        self._fade_in, self._fade_out = np.sin(angle), np.cos(angle)
        self._blocks: OrderedDict[int, Array] = OrderedDict()
        self._orders: dict[int, NDArray[np.int64]] = {}

    def samples(self, start: int, n_times: int) -> Array:
        """Samples from number `start` >= 0 on: float64, (n_times, n_channels), uV."""
        return from_blocks(self._block, self._n_step, start, (n_times, len(self.names)))

    def _block(self, number: int) -> Array:
        if number not in self._blocks:
            block = self._stretch(number)[: self._n_step]
            if number:
                # Squares of sine and cosine add up to one: the power stays the same through the fade.
                before = self._stretch(number - 1)[self._n_step :]
                block[: self._n_fade] = self._fade_in * block[: self._n_fade] + self._fade_out * before
            remember(self._blocks, number, block + self._offset)
        return self._blocks[number]

    def _stretch(self, number: int) -> Array:
        """A stretch less the line through its ends, so that the electrodes' drifts make no step where two meet."""
        cycle, place = divmod(number, self._per_cycle)
        begin = int(self._order(cycle)[place])
        data = self._data[begin : begin + self._n_step + self._n_fade].astype(np.float64)
        at = np.array([(self._n_fade - 1) / 2, len(data) - (self._n_fade + 1) / 2])
        levels = np.stack([data[: self._n_fade].mean(axis=0), data[-self._n_fade :].mean(axis=0)])
        return data - _line(at, levels, len(data))

    def _order(self, cycle: int) -> NDArray[np.int64]:
        if cycle not in self._orders:
            rng = np.random.default_rng([self._seed, 11, cycle])
            begins = [
                first + int(rng.integers(length - n * self._n_step - self._n_fade + 1)) + np.arange(n) * self._n_step
                for first, length, n in self._pieces
            ]
            self._orders[cycle] = rng.permutation(np.concatenate(begins))
        return self._orders[cycle]


class Rehearsed(Person):
    """The person of a likeness.

    Parameters
    ----------
    likeness : what was learnt.
    seed : of all that is drawn: background, sizes of responses.
    errp : False: error moves are answered like correct ones.
    t0 : session time of sample 0, s.
    run : another number, another hour.
    """

    def __init__(self, likeness: Likeness, seed: int, errp: bool = True, *, t0: float = 0.0, run: int = 0) -> None:
        self._moment = moment(seed, run)
        super().__init__(RedrawnBackground(likeness, self._moment), t0)
        self._likeness = likeness if errp else replace(likeness, scale=0.0)
        self._maps = np.concatenate((likeness.maps, likeness.errp_maps))

    def _answer(self, onset: float, error: bool, number: int, size: float) -> Answer:
        own = self._likeness
        mean = size * own.scale if error else 0.0
        errp = own.spread * stratified_normal(self._moment, int(error), number) + mean
        # Nearest sample, as for the epochs that it was learnt from.
        first = round(onset * self.sfreq) + round(RESPONSE_S[0] * self.sfreq)
        return Answer(first, np.concatenate((own.courses, errp * own.errp_courses)), self._maps)


def _trials(
    samples: NDArray[np.float32], times: Array, onsets: Sequence[float], error: NDArray[np.bool_], sfreq: float
) -> tuple[list[int], Array, NDArray[np.bool_]]:
    """First samples, responses (n_trials, n_waves, n_channels) and truth of the moves with EEG all around them.

    Each is taken less the line through the EEG's levels at its ends, so no drift is in it, as the weights of `_waves`.
    """
    n_level, waves = round(LEVEL_S * sfreq), _waves(sfreq)
    begin, end = (round(edge * sfreq) for edge in RESPONSE_S)
    results = cut_recording(samples, times, onsets, Shape(sfreq, n_level - begin, end + n_level))
    first, trials, known = [], [], []
    for result, is_error in zip(results, error, strict=True):
        if isinstance(result, Epoch):
            data, n_whole = result.data, 2 * n_level
            levels = np.stack([data[:n_whole].mean(axis=0), data[-n_whole:].mean(axis=0)])
            line = _line(np.array([n_level - 0.5, len(data) - n_level - 0.5]), levels, len(data))
            trials.append(waves.T @ (data - line)[n_level:-n_level])
            first.append(int(np.flatnonzero(times == result.first_time)[0]) + n_level)
            known.append(is_error)
    shape = (len(trials), waves.shape[1], samples.shape[1])
    return first, np.array(trials).reshape(shape), np.array(known, dtype=bool)


def _covariance(noise: Array) -> Array:
    """Of the columns of noise, (n, n_columns), and such that it has an inverse. SetupError when most are flat."""
    covariance: Array = noise.T @ noise / len(noise)
    variance = np.diag(covariance)
    usual = float(np.median(variance))
    if usual <= 0:
        raise SetupError("More than half of this recording's channels are flat. Give one whose electrodes had contact.")
    # A dead channel counts as a usual one, and a bad one for itself only.
    covariance += np.diag(RIDGE * np.maximum(variance, usual))
    return covariance


def _sizes(
    trials: Array, error: NDArray[np.bool_], elsewhere: Array, errp: Array, noise: Noise
) -> tuple[Array, float, float]:
    """Size of each trial's ErrP less its class's mean, their true standard deviation, and the part that isn't noise.

    The sizes are in mean ErrPs, by a matched filter. Where no move was it shows how much the background alone makes
    them vary; what they vary more is the person's.
    """
    template = np.linalg.solve(noise.across, np.linalg.solve(noise.in_time, errp).T).T
    norm = float((template * errp).sum())
    if norm <= 0:  # no ErrP
        return np.zeros(len(trials)), 0.0, 0.0
    sizes, without = (np.tensordot(part, template, axes=2) / norm for part in (trials, elsewhere))
    for which in (error, ~error):
        sizes[which] -= sizes[which].mean()
    own = max(0.0, float(sizes.var() - without.var()))
    return sizes, float(np.sqrt(own)), own / float(sizes.var())


def _waves(sfreq: float) -> Array:
    """Half sines up to `MAX_HZ`, (n_response, n_waves), orthonormal: responses made of them begin and end at 0."""
    begin, end = (round(edge * sfreq) for edge in RESPONSE_S)
    place = (np.arange(end - begin)[:, None] + 1) / (end - begin + 1)
    number = 1 + np.arange(int(2 * MAX_HZ * (RESPONSE_S[1] - RESPONSE_S[0])))
    waves: Array = np.sqrt(2 / (end - begin + 1)) * np.sin(np.pi * number * place)
    return waves


def _line(at: Array, levels: Array, n_times: int) -> Array:
    """The line through two levels, (2, n_channels), at two places: (n_times, n_channels)."""
    slope = (levels[1] - levels[0]) / (at[1] - at[0])
    line: Array = levels[0] + (np.arange(n_times)[:, None] - at[0]) * slope
    return line
