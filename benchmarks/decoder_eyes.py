"""Do verdicts come from the eyes? Participants whose blinks and saccades follow errors, with and without correction.

    python benchmarks/decoder_eyes.py
    python benchmarks/decoder_eyes.py --background RECORDING.edf

Each person watches 600 moves, 3 s apart, 30 % errors. Printed is the AUC of tenfold cross-validation: for the EEG as it
is, with the eyes regressed out (learnt from the very same calibration), and for the ocular sources alone.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from bci_app.config import ChainConfig, ClassifierConfig
from decoder.background import bump, read_background
from decoder.calibration import auc, held_out_log_odds, stratified_folds
from decoder.chain import design
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.eyes import learn_eyes
from decoder.montage import directions
from decoder.operator import chain_operator, features
from decoder.participant import Participant
from decoder.spatial import compose, ocular

Array = NDArray[np.float64]

N_MOVES, MOVE_S = 600, 3.0
AFTER_ERROR, AFTER_CORRECT = 0.6, 0.15
"""Probabilities of a blink, and of each kind of saccade, within the epoch (decided: a strong confound)."""
BLINK_UV, SACCADE_UV = 100.0, 40.0


def eye_movements(onsets: Array, error: NDArray[np.bool_], n_times: int, names: tuple[str, ...], seed: int) -> Array:
    """Blinks, and gaze going aside or up and back, that follow errors: (n_times, n_channels) in uV at 500 Hz."""
    rng = np.random.default_rng([seed, 77])
    blink_map, side_map, up_map = topographies(names, rng)
    blink = signal.windows.hann(150) ** 1.5
    course = np.zeros((n_times + 2000, 3))
    for onset, wrong in zip(onsets, error, strict=True):
        chance = AFTER_ERROR if wrong else AFTER_CORRECT
        happens = rng.random(3) < chance
        begins = np.round(500 * (onset + rng.normal((0.22, 0.25, 0.25), 0.05))).astype(int)
        if happens[0]:
            course[begins[0] : begins[0] + 150, 0] += rng.gamma(9, BLINK_UV / 9) * blink
        for kind in (1, 2):
            if happens[kind]:
                looking = round(500 * max(0.15, rng.normal(0.4, 0.1)))
                course[begins[kind] : begins[kind] + looking, kind] += rng.gamma(9, SACCADE_UV / 9)
    course[:, 1:] = signal.convolve(course[:, 1:], np.full((15, 1), 1 / 15), mode="same")  # a saccade takes 30 ms
    movements: Array = course[:n_times] @ np.stack([blink_map, side_map, up_map])
    return movements


def topographies(names: tuple[str, ...], rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Of a blink, of gaze to the side and of gaze upwards: 1 at their strongest; every person a little different."""
    where = directions(names)
    x, z = rng.normal(0, 0.05, 2)
    up = bump(where, (x, 1.0, -0.35 + z), 0.75)
    side = bump(where, (-0.7, 1.0, -0.4 + z), 0.45) - bump(where, (0.7, 1.0, -0.4 + z), 0.45)
    return bump(where, (0.0, 1.0, -0.3), 0.6), side, up  # blinks as in the background


def record(person: Participant, seed: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Samples, onsets and errors."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(N_MOVES) < 0.3 * N_MOVES)
    onsets = 6 + MOVE_S * np.arange(N_MOVES) + rng.uniform(0, 0.02, N_MOVES)
    for onset, wrong in zip(onsets.tolist(), error.tolist(), strict=True):
        person.respond(onset, wrong)
    n_times = round((onsets[-1] + 2) * person.sfreq)
    chunks = [person.render(start, min(5000, n_times - start)) for start in range(0, n_times, 5000)]
    return np.concatenate(chunks).astype(np.float64), onsets, error


class Laboratory:
    """Cutting, features and cross-validation, always the decoder's own."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.chain = design(ChainConfig(), 500.0)
        self.operator = chain_operator(self.chain)
        self.raw = compose(len(names), range(len(names)))

    def auc(self, samples: Array, onsets: Array, error: NDArray[np.bool_], spatial: Array) -> float:
        """AUC of held-out verdicts with this spatial matrix."""
        shape = Shape(500.0, self.chain.n_before, self.chain.n_after)
        epochs = cut_recording(samples, np.arange(len(samples)) / 500.0, onsets.tolist(), shape)
        rows = np.stack([features(epoch.data, self.operator, spatial) for epoch in epochs if isinstance(epoch, Epoch)])
        config = ClassifierConfig()
        return auc(held_out_log_odds(rows, error, config, stratified_folds(error, config)), error).value

    def corrected(self, samples: Array) -> tuple[Array, Array]:
        """The spatial matrix with ocular correction learnt from these samples, and the one of the sources alone."""
        eyes = learn_eyes(samples, 500.0, self.names)
        n = len(self.names)
        return compose(n, range(n), eyes=ocular(eyes.weights, eyes.sources)), eyes.sources


def measure(seed: int, background: Path | None) -> dict[str, float]:
    """AUCs of one person."""
    figures = {}
    for errp in (True, False):
        person = Participant(seed, errp=errp, background=read_background(background, run=seed) if background else None)
        lab = Laboratory(person.names)
        samples, onsets, error = record(person, seed)
        cleaned, sources = lab.corrected(samples)
        if errp:
            figures["ErrP"] = lab.auc(samples, onsets, error, lab.raw)
            figures["ErrP corrected"] = lab.auc(samples, onsets, error, cleaned)
            figures["eyes alone, no cheat"] = lab.auc(samples, onsets, error, sources)
        samples += eye_movements(onsets, error, len(samples), person.names, seed)
        cleaned, sources = lab.corrected(samples)
        cheat = "ErrP + cheat" if errp else "cheat only"
        figures[cheat] = lab.auc(samples, onsets, error, lab.raw)
        figures[f"{cheat} corrected"] = lab.auc(samples, onsets, error, cleaned)
        if errp:
            figures["eyes alone, cheat"] = lab.auc(samples, onsets, error, sources)
    return figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--background", type=Path, help="a recording instead of synthetic EEG")
    options = parser.parse_args()
    people = [measure(seed, options.background) for seed in range(1, options.seeds + 1)]
    print(f"{'AUC':26}{'mean':>7}   each person")
    for name in people[0]:
        values = [person[name] for person in people]
        print(f"{name:26}{np.mean(values):7.3f}   {' '.join(f'{value:.3f}' for value in values)}")


if __name__ == "__main__":
    main()
