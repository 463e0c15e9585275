"""Whether epochs and accuracy depend on how an amplifier stamps its samples.

    python benchmarks/decoder_time_stamps.py [--participants 5]

The same simulated participants, 600 moves each, with the stamps that amplifiers and networks are known to give; onsets
stay where they are in the EEG. Prints how many epochs begin at the same sample as with even stamps, how far the others
lie off, how many are rejected, and the balanced accuracy in contiguous folds.
"""

import argparse
from collections.abc import Callable

import numpy as np
from decoder_decodability import record
from rich.console import Console
from rich.table import Table

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.terminal import progress_bar
from decoder.calibration import contiguous_folds, held_out_log_odds, score
from decoder.chain import design
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.operator import chain_operator, features
from decoder.participant import Participant
from decoder.spatial import common_average

Array = np.ndarray
Stamped = tuple[Array, Array]
"""Stamps of the samples, and of the onsets as they are used on the EEG's clock."""
CHUNK_S = 0.035
DRIFT = 100e-6
JITTER_S = 0.003
AWAY_S, UNSURE_S = 1000.0, 0.0002  # LSL knows another host's clock to 0.2 ms


def _even(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    return times, onsets


def _arrival(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    """Stamped on arrival: 10 us apart, then nothing until the next chunk is there."""
    n_chunk = round(CHUNK_S / (times[1] - times[0]))
    index = np.arange(len(times))
    last = np.minimum((index // n_chunk + 1) * n_chunk - 1, len(times) - 1)
    return times[last] + (index % n_chunk) * 1e-5, onsets


def _drifting(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    return times * (1 + DRIFT), onsets * (1 + DRIFT)


def _jittered(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    return times + rng.uniform(-JITTER_S, JITTER_S, len(times)), onsets


def _second_host(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    offset = AWAY_S + rng.normal(0, UNSURE_S / 2, len(onsets))
    return times, (onsets - AWAY_S) + offset


def _all_at_once(times: Array, onsets: Array, rng: np.random.Generator) -> Stamped:
    times, onsets = _drifting(*_arrival(times, onsets, rng), rng)
    return _second_host(times, onsets, rng)


WAYS: dict[str, Callable[[Array, Array, np.random.Generator], Stamped]] = {
    "even": _even,
    f"stamped on arrival, every {CHUNK_S * 1e3:g} ms": _arrival,
    f"{DRIFT * 1e6:g} ppm fast": _drifting,
    f"jitter of {JITTER_S * 1e3:g} ms either way": _jittered,
    f"second host, {AWAY_S:g} s away": _second_host,
    "arrival, drift and second host": _all_at_once,
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=5)
    n_people = parser.parse_args().participants
    config = ClassifierConfig()
    places: dict[str, list[Array]] = {way: [] for way in WAYS}
    accuracies: dict[str, list[float]] = {way: [] for way in WAYS}
    with progress_bar(quiet=False) as show:
        for number in range(n_people):
            show("participants", number, n_people)
            person = Participant(number + 1, decodability=0.75)
            samples, onsets, error = record(person, 1, number + 1)
            chain = design(ChainConfig(), person.sfreq)
            shape = Shape(person.sfreq, chain.n_before, chain.n_after)
            operator, spatial = chain_operator(chain), common_average(len(person.names))
            # A channel that counts samples tells where an epoch begins.
            counted = np.column_stack((samples, np.arange(len(samples))))
            for way, stamp in WAYS.items():
                rng = np.random.default_rng([number, 1])
                times, at = stamp(4000 + np.arange(len(samples)) / person.sfreq, 4000 + onsets, rng)
                epochs = cut_recording(counted, times, at.tolist(), shape)
                valid = np.array([isinstance(epoch, Epoch) for epoch in epochs])
                place = [epoch.data[shape.n_before, -1] if isinstance(epoch, Epoch) else np.nan for epoch in epochs]
                places[way].append(np.array(place))
                rows = [features(e.data[:, :-1], operator, spatial) for e in epochs if isinstance(e, Epoch)]
                truth = error[valid]
                log_odds = held_out_log_odds(np.array(rows), truth, config, contiguous_folds(truth, config))
                accuracies[way].append(score(log_odds, truth).balanced_accuracy.value)
    table = Table("stamps", "same sample", "farthest off", "rejected", "balanced accuracy", "against even")
    even, plain = np.concatenate(places["even"]), np.array(accuracies["even"])
    for way in WAYS:
        off = np.concatenate(places[way]) - even
        known = off[np.isfinite(off)]
        change = np.array(accuracies[way]) - plain
        table.add_row(
            way,
            f"{np.mean(known == 0):.2%}",
            f"{np.abs(known).max():g} samples",
            f"{np.isnan(off).sum()} of {len(off)}",
            f"{np.mean(accuracies[way]):.4f}",
            f"{change.mean():+.4f} (worst {change[np.abs(change).argmax()]:+.4f})",
        )
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
