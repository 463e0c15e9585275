"""Can a decoder's own figures be trusted? Probabilities, predicted intervals, threshold and drift warnings.

    python benchmarks/decoder_reliability.py
    python benchmarks/decoder_reliability.py --participants 10

Each person watches a calibration of 600 moves, 30 % errors, and in another hour a session of 200. A decoder is fitted
on the first and judges the second. Prints Markdown.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from decoder_people import Moves, watch
from numpy.typing import NDArray

from bci_app.config import ClassifierConfig
from bci_app.terminal import progress_bar
from decoder.calibration import calibrate, contiguous_folds, score
from decoder.drift import N_WINDOW, DriftWatch
from decoder.evidence import calibrate_evidence, held_out_evidence
from decoder.reliability import Prediction, Reliability, predict_session, reliability

Array = NDArray[np.float64]

N_CALIBRATION, N_SESSION, SHARE = 600, 200, 0.3
DECODABILITIES = (0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9)
CONFIG = ClassifierConfig()


@dataclass(frozen=True, eq=False)
class Person:
    """What one person's decoder said of itself, and what became of it.

    `held_out` and `online` hold natural log-likelihood ratios and the truth; `raw` the session's log odds.
    """

    prediction: Prediction
    wilson: tuple[float, float]
    held_out: tuple[Array, NDArray[np.bool_]]
    online: tuple[Array, NDArray[np.bool_]]
    raw: Array
    middle: float
    watch_on: tuple[Array, NDArray[np.bool_]]


def measure(seed: int) -> Person:
    """One person's calibration and session."""
    decodability = DECODABILITIES[seed % len(DECODABILITIES)]
    known = watch(seed, decodability, N_CALIBRATION, share=SHARE)
    later: Moves = watch(seed, decodability, N_SESSION, run=1, share=SHARE)
    result = calibrate(known.features, known.error, CONFIG)
    evidence = calibrate_evidence(result.tenfold_log_odds, known.error)
    blocked, error = result.blocked_log_odds, known.error
    stretches = [test for _, test in contiguous_folds(error, CONFIG)]
    prediction = predict_session((blocked > 0) == error, error, stretches, N_SESSION, SHARE)
    raw = np.array([result.classifier.log_odds(row) for row in later.features])
    accuracy = score(blocked, error).accuracy
    return Person(
        prediction,
        (accuracy.low, accuracy.high),
        (held_out_evidence(blocked, error), error),
        (np.array([evidence.of(value) for value in raw.tolist()]), later.error),
        raw,
        float(blocked[error].mean() + blocked[~error].mean()) / 2,
        (result.tenfold_log_odds, error),
    )


def accuracies(log_odds: Array, error: NDArray[np.bool_]) -> tuple[float, float]:
    """Plain and balanced accuracy."""
    scores = score(log_odds, error)
    return scores.accuracy.value, scores.balanced_accuracy.value


def pooled(pairs: list[tuple[Array, NDArray[np.bool_]]]) -> Reliability:
    """Of all people's moves together."""
    return reliability(np.concatenate([values for values, _ in pairs]), np.concatenate([truth for _, truth in pairs]))


def warned(person: Person, change: float = 0.0, factor: float = 1.0) -> bool:
    """Whether a drift warning came in the session, its log odds multiplied, then moved by their own deviations."""
    drift = DriftWatch(*person.watch_on)
    changed = factor * person.raw + change * person.raw.std()
    found = [drift.hear(value) for value in changed.tolist()]
    return any(one is not None and one.is_drift for one in found)


def print_probabilities(people: list[Person]) -> None:
    """Brier scores, expected calibration errors and the online reliability diagram."""
    print(f"\n| {len(people)} participants' log-likelihood ratios | moves | Brier | uninformed | ECE | ECE by chance |")
    print("|---|---|---|---|---|---|")
    online = pooled([person.online for person in people])
    for name, found in (("held out", pooled([person.held_out for person in people])), ("online", online)):
        n = sum(one.n for one in found.bins)
        print(
            f"| {name} | {n} | {found.brier:.3f} | {found.brier_uninformed:.3f} | {found.ece:.3f} | "
            f"{found.ece_by_chance:.3f} |"
        )
    print("\n| online: said to be an error with | happened | moves |\n|---|---|---|")
    for one in online.bins:
        print(f"| {one.said:.2f} | {one.happened:.2f} | {one.n} |")


def print_coverage(people: list[Person]) -> None:
    """How often a session's accuracy lay where it was said to."""
    reached = [accuracies(person.raw, person.online[1]) for person in people]
    plain, balanced = (
        [person.prediction.accuracy for person in people],
        [p.prediction.balanced_accuracy for p in people],
    )
    print(f"\n| 95 % interval for a session of {N_SESSION} moves | covers, of {len(people)} sessions | mean width |")
    print("|---|---|---|")
    rows = {
        "predicted accuracy": [(i.low, i.high, value) for i, (value, _) in zip(plain, reached, strict=True)],
        "predicted balanced accuracy": [
            (i.low, i.high, value) for i, (_, value) in zip(balanced, reached, strict=True)
        ],
        "Wilson's, of the calibration alone": [
            (*person.wilson, value) for person, (value, _) in zip(people, reached, strict=True)
        ],
    }
    for name, values in rows.items():
        covered = np.mean([low <= value <= high for low, high, value in values])
        print(f"| {name} | {covered:.0%} | {np.mean([high - low for low, high, _ in values]):.3f} |")
    bias = 100 * np.mean([value - i.value for i, (_, value) in zip(balanced, reached, strict=True)])
    print(f"\nOnline balanced accuracy less the predicted: {bias:+.1f} points in the mean.")


def print_threshold(people: list[Person]) -> None:
    """Would another threshold be better?"""
    print("\n| `error` is said where | accuracy | balanced accuracy | gain in balanced accuracy |\n|---|---|---|---|")
    kinds = {
        "log odds > 0": [accuracies(person.raw, person.online[1]) for person in people],
        "evidence > 0": [accuracies(*person.online) for person in people],
        "nearer the errors' mean": [accuracies(person.raw - person.middle, person.online[1]) for person in people],
    }
    first = np.array(kinds["log odds > 0"])
    for name, values in kinds.items():
        plain, balanced = np.mean(values, axis=0)
        gain = 100 * (np.array(values) - first)[:, 1]
        error = gain.std(ddof=1) / len(people) ** 0.5
        print(f"| {name} | {plain:.3f} | {balanced:.3f} | {gain.mean():+.2f} ± {error:.2f} points |")


def print_drift(people: list[Person]) -> None:
    """Warnings with and without drift."""
    print(f"\n| session's log odds (a window of {N_WINDOW}) | sessions warned of |\n|---|---|")
    changes = {
        "as they are": (0.0, 1.0),
        "one standard deviation up": (1.0, 1.0),
        "one standard deviation down": (-1.0, 1.0),
        "half as large": (0.0, 0.5),
        "twice as large": (0.0, 2.0),
    }
    for name, change in changes.items():
        print(f"| {name} | {np.mean([warned(person, *change) for person in people]):.0%} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=20, help="for the probabilities; at least 2")
    parser.add_argument("--sessions", type=int, default=50, help="for everything else, each of another person")
    parser.add_argument("--first-seed", type=int, default=1000)
    options = parser.parse_args()
    people: list[Person] = []
    n = max(options.participants, options.sessions)
    with progress_bar(quiet=False) as progress:
        for number in range(n):
            progress("participants", number, n)
            people.append(measure(options.first_seed + number))
    print_probabilities(people[: options.participants])
    print_coverage(people[: options.sessions])
    print_threshold(people[: options.sessions])
    print_drift(people[: options.sessions])


if __name__ == "__main__":
    main()
