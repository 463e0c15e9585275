"""Whether a rehearsal is as hard to decode as the person it was learnt from.

    python benchmarks/decoder_rehearsal.py
    python benchmarks/decoder_rehearsal.py --decodabilities 0.75 --seeds 2 --background S001R03.edf S001R04.edf

Each original watches 600 calibration moves, 3 s apart, 30 % errors; a likeness is learnt from that, its scale found,
and it watches 600 others twice. Prints a Markdown table of balanced accuracies over contiguous folds: of the original,
of the rehearsal with the ErrP's size as estimated, and with the one that is used; and, of the decoder calibrated on the
first rehearsal, on the second. `original again` is the original's own second 600 moves: what chance does to two
calibrations of one person.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ChainConfig, ClassifierConfig
from decoder.background import Background, RecordedBackground
from decoder.calibration import Estimate, contiguous_folds, held_out_log_odds, score
from decoder.chain import design
from decoder.classifier import fit
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.operator import chain_operator, features
from decoder.participant import Participant
from decoder.rehearsal import learn
from decoder.rehearsal_scale import Watch, scale_for, watched
from decoder.spatial import common_average

N_MOVES, N_ERRORS, MOVE_S = 600, 180, 3.0
CONFIG = ClassifierConfig()


def blocked(rows: NDArray, error: NDArray) -> Estimate:
    """Balanced accuracy over contiguous folds."""
    return score(held_out_log_odds(rows, error, CONFIG, contiguous_folds(error, CONFIG)), error).balanced_accuracy


def real_eeg(paths: list[Path]) -> RecordedBackground:
    """Recordings of one montage after one another, looped."""
    import mne

    parts = [mne.io.read_raw(path, preload=True, verbose="error").pick("eeg") for path in paths]
    data = np.concatenate([part.get_data().T * 1e6 for part in parts])
    return RecordedBackground(data, tuple(parts[0].ch_names), parts[0].info["sfreq"], parts[0].info["sfreq"])


def moves(seed: int, n: int = N_MOVES) -> tuple[NDArray, NDArray]:
    """Onsets and errors of a calibration."""
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(n) < n * N_ERRORS // N_MOVES)
    return 8 + MOVE_S * np.arange(n) + rng.uniform(0, 0.02, n).cumsum(), error


def measure(seed: int, decodability: float, background: Background | None, n: int = N_MOVES) -> dict[str, float]:
    """Figures of one person."""
    began = time.perf_counter()
    person = Participant(seed, 500.0, decodability, background=background)
    onsets, error = moves(seed, 2 * n)
    for onset, wrong in zip(onsets.tolist(), error.tolist(), strict=True):
        person.respond(onset, wrong)
    chain = design(ChainConfig(), person.sfreq)
    shape, spatial = Shape(person.sfreq, chain.n_before, chain.n_after), common_average(len(person.names))
    operator = chain_operator(chain)
    n_times = round((onsets[-1] + 2) * person.sfreq)
    samples = np.concatenate([person.render(k, min(5000, n_times - k)) for k in range(0, n_times, 5000)])
    times = np.arange(n_times) / person.sfreq
    cut = cut_recording(samples, times, onsets.tolist(), shape)
    rows = np.stack([features(epoch.data, operator, spatial) for epoch in cut if isinstance(epoch, Epoch)])
    end = round((onsets[n - 1] + 2) * person.sfreq)
    samples, times = samples[:end].copy(), times[:end]
    original, again = blocked(rows[:n], error[:n]), blocked(rows[n:], error[n:])

    likeness = learn(samples, times, onsets[:n].tolist(), error[:n], person.names, person.sfreq)
    watch = Watch(onsets[:n].tolist(), error[:n], shape, lambda _, epoch: features(epoch.data, operator, spatial))
    scale, _ = scale_for(likeness, original.value, watch, CONFIG, ChainConfig().n_windows, seed)
    likeness = replace(likeness, scale=scale)
    # Other moves, at other times, than the scale was found on.
    other_onsets, other_error = moves(seed + 1000, n)
    other = Watch(other_onsets.tolist(), other_error, shape, watch.features)
    as_estimated = blocked(*watched(replace(likeness, scale=1.0), other, seed, 100))
    first, truth = watched(likeness, other, seed, 100)
    second, second_truth = watched(likeness, other, seed, 101)
    classifier = fit(first, truth, CONFIG)
    online = score(np.array([classifier.log_odds(row) for row in second]), second_truth).balanced_accuracy
    theirs = fit(rows[:n], error[:n], CONFIG)
    transfer = score(np.array([theirs.log_odds(row) for row in rows[n:]]), error[n:]).balanced_accuracy
    by_original = score(np.array([theirs.log_odds(row) for row in first]), truth).balanced_accuracy
    return {
        "original": original.value,
        "low": original.low,
        "high": original.high,
        "again": again.value,
        "transfer": transfer.value,
        "estimated": as_estimated.value,
        "spread": likeness.spread,
        "scale": scale,
        "rehearsal": blocked(first, truth).value,
        "rehearsal2": blocked(second, second_truth).value,
        "online": online.value,
        "by_original": by_original.value,
        "seconds": time.perf_counter() - began,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--decodabilities", type=float, nargs="*", default=[0.65, 0.75, 0.85])
    parser.add_argument("--background", type=Path, nargs="*", help="real EEG (EDF) the originals answer in")
    parser.add_argument("--moves", type=int, default=N_MOVES)
    options = parser.parse_args()
    background = real_eeg(options.background) if options.background else None
    print(
        "| person | original [95 %] | original again | its decoder on that | scale | spread | rehearsal, scale 1 | "
        "rehearsal | rehearsal again | its decoder on that | original's decoder on rehearsal | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    found = []
    for asked in options.decodabilities:
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            f = measure(seed, asked, background, options.moves)
            found.append(f)
            print(
                f"| {asked:.2f}, seed {seed} | {f['original']:.3f} [{f['low']:.3f}, {f['high']:.3f}] "
                f"| {f['again']:.3f} | {f['transfer']:.3f} | {f['scale']:.2f} | {f['spread']:.2f} "
                f"| {f['estimated']:.3f} | {f['rehearsal']:.3f} | {f['rehearsal2']:.3f} "
                f"| {f['online']:.3f} | {f['by_original']:.3f} | {f['seconds']:.0f} |",
                flush=True,
            )
    values = {name: np.array([f[name] for f in found]) for name in found[0]}
    both = np.concatenate((values["rehearsal"], values["rehearsal2"]))
    twice = {name: np.tile(values[name], 2) for name in ("original", "low", "high")}
    inside = (both >= twice["low"]) & (both <= twice["high"])
    print(
        f"\nRehearsal less original: mean {100 * (both - twice['original']).mean():+.1f} points, "
        f"standard deviation {100 * (both - twice['original']).std():.1f}; {inside.sum()} of {len(both)} within the "
        f"original's interval. Scale 1 less original: {100 * (values['estimated'] - values['original']).mean():+.1f}. "
        f"Original again less original: {100 * (values['again'] - values['original']).mean():+.1f}, standard deviation "
        f"{100 * (values['again'] - values['original']).std():.1f}."
    )


if __name__ == "__main__":
    main()
