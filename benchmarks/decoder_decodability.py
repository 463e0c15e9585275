"""How decodable the simulated participant really is: the table behind `decoder.participant.SEPARATION`.

    python benchmarks/decoder_decodability.py                          # check: asked for against measured
    python benchmarks/decoder_decodability.py --separations 0.5 1 2    # measure a new table

Each person watches 600 calibration moves, 3 s apart, 30 % errors, and 600 more; epochs are cut, features taken and
classifiers fitted by the decoder's own functions. Prints balanced accuracies: cross-validated on the first 600, and on
the fresh 600 of the decoder fitted on the first.
"""

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from scipy.stats import skew

from bci_app.config import ChainConfig, ClassifierConfig
from decoder import participant as simulated
from decoder.calibration import held_out_log_odds, score, stratified_folds
from decoder.chain import design
from decoder.classifier import fit
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.operator import chain_operator, features
from decoder.spatial import common_average

N_MOVES, N_ERRORS, MOVE_S = 600, 180, 3.0


def record(person: simulated.Participant, n_blocks: int, seed: int) -> tuple[NDArray, NDArray, NDArray]:
    """Samples, onsets and errors of `n_blocks` times 600 moves."""
    rng = np.random.default_rng(seed)
    error = np.concatenate([rng.permutation(np.arange(N_MOVES) < N_ERRORS) for _ in range(n_blocks)])
    onsets = 6 + MOVE_S * np.arange(len(error)) + rng.uniform(0, 0.02, len(error))
    for onset, wrong in zip(onsets.tolist(), error.tolist(), strict=True):
        person.respond(onset, wrong)
    n_times = round((onsets[-1] + 2) * person.sfreq)
    chunks = [person.render(start, min(5000, n_times - start)) for start in range(0, n_times, 5000)]
    return np.concatenate(chunks), onsets, error


def measure(seed: int, decodability: float, n_blocks: int = 2, phase: str = "minimum") -> dict[str, float]:
    """Figures of one person."""
    config = ClassifierConfig()
    person = simulated.Participant(seed, decodability=decodability)
    began = time.perf_counter()
    samples, onsets, error = record(person, n_blocks, seed)
    speed = len(samples) / person.sfreq / (time.perf_counter() - began)
    chain = design(ChainConfig(phase=phase), person.sfreq)
    shape = Shape(person.sfreq, chain.n_before, chain.n_after)
    operator, spatial = chain_operator(chain), common_average(len(person.names))
    epochs = cut_recording(samples, np.arange(len(samples)) / person.sfreq, onsets.tolist(), shape)
    rows = np.stack([features(epoch.data, operator, spatial) for epoch in epochs if isinstance(epoch, Epoch)])
    known, truth = rows[:N_MOVES], error[:N_MOVES]
    held_out = held_out_log_odds(known, truth, config, stratified_folds(truth, config))
    tenfold = score(held_out, truth)
    figures = {
        "cv": tenfold.balanced_accuracy.value,
        "hit": tenfold.hit_rate.value,
        "cr": tenfold.correct_rejection_rate.value,
        "auc": tenfold.auc.value,
        "skew": float(max(abs(skew(held_out[truth])), abs(skew(held_out[~truth])))),
        "speed": speed,
    }
    if n_blocks > 1:
        classifier = fit(known, truth, config)
        fresh = np.array([classifier.log_odds(row) for row in rows[N_MOVES:]])
        figures["fresh"] = score(fresh, error[N_MOVES:]).balanced_accuracy.value
    return figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--decodabilities", type=float, nargs="*", default=[0.60, 0.75, 0.90])
    parser.add_argument("--separations", type=float, nargs="*", help="instead: distances of the means in GAIN_UV")
    options = parser.parse_args()
    for asked in options.separations or options.decodabilities:
        if options.separations:
            simulated.separation = lambda _, asked=asked: asked
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        people = [
            measure(seed, 0.5 if options.separations else asked, 1 if options.separations else 2) for seed in seeds
        ]
        values = {name: np.array([person[name] for person in people]) for name in people[0]}
        means = "  ".join(f"{name} {value.mean():.3f}" for name, value in values.items())
        accuracies = " ".join(f"{value:.3f}" for value in values["cv"])
        print(
            f"{asked:.3f}  {means}  sd(cv) {values['cv'].std(ddof=1):.4f}  max|cv-asked| "
            f"{np.abs(values['cv'] - asked).max():.3f}  cv: {accuracies}",
            flush=True,
        )


if __name__ == "__main__":
    main()
