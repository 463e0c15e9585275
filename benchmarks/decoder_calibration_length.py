"""How long must a calibration be? Learning curves, the stop rule and the warm start.

    python benchmarks/decoder_calibration_length.py
    python benchmarks/decoder_calibration_length.py --participants 6

Each person watches 600 calibration moves in 5 blocks, 30 % errors, and in another hour 1200 to test decoders on. Prints
Markdown.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from decoder_people import Moves, watch
from numpy.typing import NDArray
from scipy.special import ndtr

from bci_app.config import CalibrationConfig, ChainConfig, ClassifierConfig
from bci_app.terminal import progress_bar
from decoder.calibration import score
from decoder.classifier import fit
from decoder.learning_curve import Outlook, measure, outlook, point, separation_at

Array = NDArray[np.float64]

BLOCK, N_BLOCKS, N_TEST = 120, 5, 1200
LENGTHS = tuple(BLOCK * number for number in range(1, N_BLOCKS + 1))
FIGURES = ("accuracy", "balanced")
DECODABILITIES = (0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9)
CONFIG, N_WINDOWS = ClassifierConfig(), ChainConfig().n_windows


@dataclass(frozen=True)
class Reached:
    """Figures of one decoder on the test moves."""

    accuracy: float
    balanced: float
    separation: float


@dataclass(frozen=True, eq=False)
class Person:
    """By number of calibration moves: decoders, and what the stop rule knew."""

    reached: dict[int, Reached]
    known: dict[int, Outlook]

    def stop(self, worthwhile: float) -> int:
        """Moves after which the rule stops."""
        return next((n for n in LENGTHS[:-1] if self.known[n].is_clear(worthwhile)), LENGTHS[-1])


def measured(calibration: Moves, test: Moves) -> Person:
    """One person's decoders."""
    reached, known = {}, {}
    for n in LENGTHS:
        features, error = calibration.features[:n], calibration.error[:n]
        reached[n] = decoder_on(features, error, test)
        known[n] = outlook(measure(features, error, CONFIG, N_WINDOWS), n, BLOCK, LENGTHS[-1] - n)
    return Person(reached, known)


def decoder_on(features: Array, error: NDArray[np.bool_], test: Moves) -> Reached:
    """A decoder on fresh moves."""
    classifier = fit(features, error, CONFIG, N_WINDOWS)
    log_odds = test.features @ classifier.weights + classifier.bias
    scores = score(log_odds, test.error)
    separation = point(log_odds, test.error, len(error)).separation
    return Reached(scores.accuracy.value, scores.balanced_accuracy.value, separation)


def mean_and_error(values: list[float]) -> str:
    """In points."""
    return f"{100 * np.mean(values):+.2f} ± {100 * np.std(values, ddof=1) / len(values) ** 0.5:.2f}"


def print_curves(people: list[Person]) -> None:
    """Accuracy against the number of trials."""
    print("\n| trials | accuracy | balanced |\n|---|---|---|")
    for n in LENGTHS:
        means = (np.mean([getattr(p.reached[n], name) for p in people]) for name in FIGURES)
        print(f"| {n} | {' | '.join(f'{mean:.3f}' for mean in means)} |")


def print_outlooks(people: list[Person]) -> None:
    """What the rule expected of all remaining blocks beside what they brought."""
    print(
        "\n| after | all that is left should gain, points | it gained | within the 95 % interval |\n|---|---|---|---|"
    )
    for n in LENGTHS[:-1]:
        expected = [person.known[n].total_gain for person in people]
        was = [person.reached[LENGTHS[-1]].balanced - person.reached[n].balanced for person in people]
        inside = np.mean([e.low <= value <= e.high for e, value in zip(expected, was, strict=True)])
        means = f"{100 * np.mean([e.value for e in expected]):.1f} | {mean_and_error(was)}"
        print(f"| {n} | {means} | {inside:.0%} |")


def print_rule(people: list[Person], thresholds: list[float]) -> None:
    """Trials saved and accuracy lost."""
    lengths = " / ".join(map(str, LENGTHS))
    print(f"\n| worthwhile, points | stops after {lengths} | trials saved | lost: accuracy | balanced |")
    print("|---|---|---|---|---|")
    last = LENGTHS[-1]
    for worthwhile in thresholds:
        stops = [person.stop(worthwhile) for person in people]
        pairs = [(p.reached[last], p.reached[n]) for p, n in zip(people, stops, strict=True)]
        cells = [f"{100 * worthwhile:g}", " / ".join(str(stops.count(n)) for n in LENGTHS)]
        cells.append(f"{1 - np.mean(stops) / last:.0%}")
        cells += [mean_and_error([getattr(a, name) - getattr(b, name) for a, b in pairs]) for name in FIGURES]
        print(f"| {' | '.join(cells)} |")


def print_constant(people: list[Person]) -> None:
    """The constant of the learning curve that fits these people best, each with a limit of their own."""
    limits, best = np.linspace(0.2, 6, 300), (np.inf, 0.0)
    lengths = np.array(LENGTHS)[:, None]
    for epochs in np.geomspace(50, 3000, 60).tolist():
        predicted = ndtr(separation_at(lengths, limits, epochs) / 2)
        found = [ndtr(np.array([person.reached[n].separation for n in LENGTHS]) / 2)[:, None] for person in people]
        squared = float(np.mean([((predicted - one) ** 2).mean(axis=0).min() for one in found]))
        best = min(best, (squared, epochs))
    print(f"\nLearning curves fit best with EPOCHS = {best[1]:.0f}, to {100 * best[0] ** 0.5:.1f} points of accuracy.")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=20, help="at least 2")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument(
        "--worthwhile", type=float, nargs="*", default=[0.01, 0.0125, CalibrationConfig().worthwhile, 0.02]
    )
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.participants)
    watched: list[tuple[Moves, Moves]] = []
    people: list[Person] = []
    with progress_bar(quiet=False) as progress:
        for number, seed in enumerate(seeds):
            progress("watching moves", number, 2 * len(seeds))
            decodability = DECODABILITIES[seed % len(DECODABILITIES)]
            watched.append((watch(seed, decodability, LENGTHS[-1]), watch(seed, decodability, N_TEST, run=1)))
        for number, (calibration, test) in enumerate(watched):
            progress("calibrating", len(seeds) + number, 2 * len(seeds))
            people.append(measured(calibration, test))
    print_curves(people)
    print_outlooks(people)
    print_rule(people, options.worthwhile)
    print_constant(people)


if __name__ == "__main__":
    main()
