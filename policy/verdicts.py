"""Simulated decoders: what each verdict says of a move, as the evidence a policy or a Bayes filter is given.

Evidence is the natural log of P(verdict | error) / P(verdict | correct). It is all that a verdict says about the move;
a missing verdict is evidence 0. What remains to be told of a decoder is how much it will say in the moves to come.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bci_app.errors import SetupError

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Probabilities = float | NDArray[np.float64]

LIMIT = 10.0
"""Largest absolute evidence: a verdict taken for certain, e to the 10 to one."""


def binary_evidence(hit: Probabilities, correct_rejection: Probabilities) -> tuple[Floats, Floats]:
    """Evidence of the verdict `error` and of the verdict `correct`, from a decoder's two rates."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.log(np.divide(hit, np.subtract(1, correct_rejection)))
        correct = np.log(np.divide(np.subtract(1, hit), correct_rejection))
    return _bounded(error), _bounded(correct)


def _bounded(evidence: NDArray[np.float64]) -> Floats:
    # 0/0: a verdict that never comes says nothing.
    return np.clip(np.nan_to_num(evidence, nan=0.0, posinf=LIMIT, neginf=-LIMIT), -LIMIT, LIMIT).astype(np.float32)


def separation(accuracy: Probabilities) -> NDArray[np.float64]:
    """Distance d' of two unit normal distributions of scores whose sign is right with this probability."""
    distance: NDArray[np.float64] = 2 * ndtri(np.minimum(accuracy, _CERTAIN))
    return distance


_CERTAIN = 1 - 1e-6  # scores of an accuracy of one lie infinitely far apart; these are certain, too


def binary_information(hit: Probabilities, correct_rejection: Probabilities) -> NDArray[np.float64]:
    """Bits a binary verdict gives on a move that is an error with probability one half (mutual information)."""
    p_error = (np.asarray(hit) + 1 - np.asarray(correct_rejection)) / 2
    bits = _entropy(p_error) - (_entropy(hit) + _entropy(correct_rejection)) / 2
    # A decoder that says nothing says exactly nothing: what is left are rounding errors.
    return np.where(bits < 1e-9, 0.0, bits)


def score_information(accuracy: Probabilities) -> NDArray[np.float64]:
    """Bits a score of this accuracy gives on a move that is an error with probability one half."""
    grid, bits = _score_bits()
    return np.interp(separation(accuracy), grid, bits)


@cache
def _score_bits() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    grid, x = np.linspace(0, separation(1.0), 400), np.linspace(-16, 16, 3201)
    p_error = 1 / (1 + np.exp(-grid[:, None] * x))
    normal = np.exp(-0.5 * (x - grid[:, None] / 2) ** 2) / np.sqrt(2 * np.pi)
    left = normal * _entropy(p_error)
    return grid, 1 - np.trapezoid(left, x, axis=1)


def _entropy(p: Probabilities) -> NDArray[np.float64]:
    inside = np.clip(p, 1e-15, 1 - 1e-15)
    entropy: NDArray[np.float64] = -(inside * np.log2(inside) + (1 - inside) * np.log2(1 - inside))
    return entropy


@dataclass
class Decoders:
    """The simulated decoder of each of ``n`` episodes; every array is float32 or bool, (n,).

    Attributes
    ----------
    is_score : whether it gives a score, or only its sign.
    hit, correct_rejection : the binary decoder's rates.
    if_error, if_correct : evidence its two verdicts are taken for; of the true rates, or of wrongly told ones.
    distance : d' of the scores of errors and correct moves.
    scale : evidence a unit of the score is taken for; the distance, unless another is told.
    missing : probability that there is no verdict.
    information : bits a verdict as told, 0 to 1: what the policy hears of its decoder.
    """

    is_score: Bools
    hit: Floats
    correct_rejection: Floats
    if_error: Floats
    if_correct: Floats
    distance: Floats
    scale: Floats
    missing: Floats
    information: Floats

    @classmethod
    def nothing(cls, n: int) -> Self:
        """No verdicts at all."""
        return cls.binary(n, 0.5, 0.5, missing=1.0)

    @classmethod
    def binary(
        cls,
        n: int,
        hit: Probabilities,
        correct_rejection: Probabilities,
        told: tuple[Probabilities, Probabilities] | None = None,
        missing: Probabilities = 0.0,
    ) -> Self:
        """Verdicts that are right with two probabilities; ``told`` are the rates they are taken for."""
        believed = told or (hit, correct_rejection)
        if_error, if_correct = binary_evidence(*believed)
        bits = binary_information(*believed)
        values = _filled(n, hit, correct_rejection, if_error, if_correct, 0.0, 0.0, missing, bits)
        return cls(np.zeros(n, bool), *values)

    @classmethod
    def score(
        cls, n: int, accuracy: Probabilities, told: Probabilities | None = None, missing: Probabilities = 0.0
    ) -> Self:
        """Normal scores whose sign is right with this probability; ``told`` is the one they are taken for."""
        believed = accuracy if told is None else told
        distance, scale, bits = separation(accuracy), separation(believed), score_information(believed)
        return cls(np.ones(n, bool), *_filled(n, 0.5, 0.5, 0.0, 0.0, distance, scale, missing, bits))

    def evidence(self, error: Bools, rng: np.random.Generator) -> Floats:
        """Draw the verdicts on moves that were errors or not, (n,), and what each says; 0 where it is missing."""
        n = len(error)
        if self.is_score.all():
            result = self._scores(error, rng)
        else:
            says_error = rng.random(n, np.float32) < np.where(error, self.hit, 1 - self.correct_rejection)
            result = np.where(says_error, self.if_error, self.if_correct)
            if self.is_score.any():
                result = np.where(self.is_score, self._scores(error, rng), result)
        if self.missing.any():
            result = np.where(rng.random(n, np.float32) < self.missing, np.float32(0), result)
        return result

    def _scores(self, error: Bools, rng: np.random.Generator) -> Floats:
        half = self.distance / 2
        score = rng.standard_normal(len(error), np.float32) + np.where(error, half, -half)
        evidence: Floats = np.clip(self.scale * score, -LIMIT, LIMIT)
        return evidence

    def put(self, which: Bools, others: "Decoders") -> None:
        """Give the episodes of the mask ``which`` other decoders, one each per true entry."""
        for name in _NAMES:
            getattr(self, name)[which] = getattr(others, name)

    def take(self, which: Bools | slice) -> "Decoders":
        """The decoders of some episodes: of the mask, or of the slice, ``which``."""
        return Decoders(*(getattr(self, name)[which] for name in _NAMES))


def _filled(n: int, *values: Probabilities | Floats) -> list[Floats]:
    return [np.broadcast_to(np.asarray(value, np.float32), n).copy() for value in values]


_NAMES = tuple(field.name for field in fields(Decoders))


MISJUDGED = 0.1
"""Points by which an accuracy may be told wrongly in training: so far off may a few blocks' estimate be, or a tired
participant. Who never met such a decoder circles for ever where verdicts contradict each other more than expected."""
_MOST_SURE = 0.99  # the highest accuracy that is told wrongly: a verdict taken for certain can't be doubted


def anybody(n: int, rng: np.random.Generator, misjudged: float = 0.0) -> Decoders:
    """Decoders of all kinds, to train the policy that is told which one it has.

    Two in five give a score; the others a sign, a third of them with two rates as unequal as real ones are (SPEC of
    16 people: hit rates .01 to .93 beside correct rejection of .51 to 1). Up to three verdicts in ten are missing.

    Parameters
    ----------
    misjudged : points by which the rates of half of them may be told wrongly.
    """
    accuracy = rng.uniform(0.5, 1, n)
    unequal = rng.random(n) < 0.35
    hit = np.where(unequal, rng.uniform(0, 1, n), accuracy)
    correct_rejection = np.where(unequal, rng.uniform(0.5, 1, n), accuracy)
    off = np.where(rng.random(n) < 0.5, rng.uniform(-misjudged, misjudged, n), 0.0)
    missing = np.where(rng.random(n) < 0.3, rng.uniform(0, 0.3, n), 0.0)
    true, told = _rates(hit, correct_rejection, 0), _rates(hit, correct_rejection, off)
    signs = Decoders.binary(n, *true, told, missing)
    is_score = rng.random(n) < 0.4
    signs.put(is_score, Decoders.score(n, accuracy, _told(accuracy, off).clip(min=0.5), missing).take(is_score))
    return signs


def _rates(
    hit: Probabilities, correct_rejection: Probabilities, off: Probabilities
) -> tuple[Probabilities, Probabilities]:
    """Two rates so many points off. A decoder that calls errors correct more often than correct moves is a dead one: in
    a calibration its sign would have been turned."""
    correct_rejection = _told(correct_rejection, off)
    return np.maximum(_told(hit, off), 1 - correct_rejection), correct_rejection


def _told(rate: Probabilities, off: Probabilities) -> NDArray[np.float64]:
    told: NDArray[np.float64] = np.clip(np.add(rate, off), 0, np.maximum(rate, _MOST_SURE))
    return told


def telling(bits: float) -> "Draw":
    """`anybody`, but only decoders whose verdicts say more than so many bits each."""

    def draw(n: int, rng: np.random.Generator) -> Decoders:
        drawn = anybody(n, rng)
        while (mute := drawn.information <= bits).any():
            drawn.put(mute, anybody(int(mute.sum()), rng))
        return drawn

    return draw


Draw = Callable[[int, np.random.Generator], Decoders]
"""Draws the decoders of so many new episodes."""


class Stock:
    """Decoders drawn thousands at a time and handed out a few by a few: drawing thirty takes as long as drawing 4096.

    Parameters
    ----------
    draw : where they come from.
    """

    SIZE = 4096

    def __init__(self, draw: Draw) -> None:
        self._draw = draw
        self._used, self._kept = self.SIZE, Decoders.nothing(self.SIZE)

    def __call__(self, n: int, rng: np.random.Generator) -> Decoders:
        """The decoders of ``n`` new episodes; a rest that is too small is thrown away."""
        if n > self.SIZE:
            return self._draw(n, rng)
        if self._used + n > self.SIZE:
            self._used, self._kept = 0, self._draw(self.SIZE, rng)
        self._used += n
        return self._kept.take(slice(self._used - n, self._used))


Kind = Literal["none", "binary", "rates", "score", "told"]
_N_NUMBERS: dict[str, int] = {"none": 0, "binary": 1, "rates": 2, "score": 1, "told": 0}


@dataclass(frozen=True)
class Verdicts:
    """A kind of verdicts, in words: ``none``, ``binary:P``, ``rates:HIT:CR``, ``score:P``, or ``told`` for all kinds.

    Calling it draws the decoders of new episodes.

    Attributes
    ----------
    kind : as above.
    numbers : its probabilities.
    missing : probability that there is no verdict.
    taken_for : the verdicts they are taken for, where that isn't what they are; of the same form, a sign or a score.
    """

    kind: Kind
    numbers: tuple[float, ...] = ()
    missing: float = 0.0
    taken_for: "Verdicts | None" = None

    @classmethod
    def parse(cls, text: str, missing: float = 0.0) -> Self:
        """Read the words. Raises SetupError for others, and for an accuracy that isn't above 0.5 and at most 1."""
        kind, *words = text.split(":")
        try:
            numbers = tuple(float(word) for word in words)
        except ValueError:
            numbers = (np.nan,)
        if kind not in _N_NUMBERS or len(numbers) != _N_NUMBERS[kind] or not all(0 <= p <= 1 for p in numbers):
            raise SetupError(
                f"Verdicts must be none, binary:P, rates:HIT:CR, score:P or told, with probabilities; found '{text}'."
            )
        if kind in ("binary", "score") and not 0.5 < numbers[0] <= 1:
            raise SetupError(f"An accuracy must be above 0.5 and at most 1, found {numbers[0]:g} in '{text}'.")
        return cls(kind, numbers, missing)  # type: ignore[arg-type]

    def __str__(self) -> str:
        return ":".join([self.kind, *(f"{number:g}" for number in self.numbers)])

    def __call__(self, n: int, rng: np.random.Generator) -> Decoders:
        """The decoders of ``n`` new episodes."""
        believed = self.taken_for or self
        match self.kind:
            case "none":
                return Decoders.nothing(n)
            case "binary" | "rates":
                told = believed.numbers[0], believed.numbers[-1]
                return Decoders.binary(n, self.numbers[0], self.numbers[-1], told, self.missing)
            case "score":
                return Decoders.score(n, self.numbers[0], believed.numbers[0], self.missing)
            case "told":
                return anybody(n, rng, MISJUDGED)

    @property
    def balanced_accuracy(self) -> float:
        """Mean of the rates at which errors and correct moves are called so; one half without verdicts."""
        return (self.numbers[0] + self.numbers[-1]) / 2 if self.numbers else 0.5

    def signs(self) -> "Verdicts":
        """The same decoder heard for its word alone, not for its score."""
        return replace(self, kind="binary") if self.kind == "score" else self


@dataclass
class Resampled:
    """Evidence drawn anew from what a participant's own decoder gave on moves it was not fitted on.

    Attributes
    ----------
    errors, corrects : float32, evidence on held-out errors and on held-out correct moves; never empty.
    information : float32, (n,), bits a verdict, as told.
    """

    errors: Floats
    corrects: Floats
    information: Floats

    def evidence(self, error: Bools, rng: np.random.Generator) -> Floats:
        """As `Decoders.evidence`."""
        n = len(error)
        return np.where(error, rng.choice(self.errors, n), rng.choice(self.corrects, n))

    def put(self, which: Bools, others: "Resampled") -> None:
        """All episodes have the same decoder."""

    def take(self, which: Bools) -> "Resampled":
        """As `Decoders.take`."""
        return Resampled(self.errors, self.corrects, self.information[which])


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A participant's own verdicts; calling it draws the decoders of new episodes.

    Attributes
    ----------
    errors, corrects : float32, evidence on held-out errors and on held-out correct moves; never empty.
    information : bits a verdict, as told.
    """

    errors: Floats
    corrects: Floats
    information: float

    def __call__(self, n: int, rng: np.random.Generator) -> Resampled:
        """The decoders of ``n`` new episodes."""
        return Resampled(self.errors, self.corrects, np.full(n, self.information, np.float32))
