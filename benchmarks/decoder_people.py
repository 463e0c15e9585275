"""Labelled features of simulated participants, made in bulk for the benchmarks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bci_app.config import ChainConfig
from decoder.chain import design
from decoder.operator import chain_operator, features
from decoder.participant import Participant
from decoder.spatial import common_average

Array = NDArray[np.float64]

SFREQ = 256.0
"""Hz. The chain's own rate, so that nothing is resampled and noise costs half of what it does at 500 Hz."""
MOVE_S = 1.0
"""Seconds between moves. Answers are over 0.7 s after a move: closer together than in the experiment, to save noise."""
ERROR_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Moves:
    """Moves a person watched: features (n_moves, n_features) in uV, and error (n_moves,), the truth."""

    features: Array
    error: NDArray[np.bool_]


def watch(seed: int, decodability: float, n_moves: int, run: int = 0, share: float = ERROR_SHARE) -> Moves:
    """What a person's EEG shows of `n_moves` moves, a `share` of them errors; every `run` is another hour."""
    person = Participant(seed, SFREQ, decodability, run=run)
    rng = np.random.default_rng([seed, run])
    blocks = np.array_split(np.arange(n_moves), max(1, n_moves // 60))
    # As many errors in each stretch as the share tells, so that no block of a calibration goes without.
    error = np.concatenate([rng.permutation(np.arange(len(block)) < round(share * len(block))) for block in blocks])
    chain = design(ChainConfig(), SFREQ)
    operator, spatial = chain_operator(chain), common_average(len(person.names))
    starts = chain.n_before + np.round(SFREQ * MOVE_S * np.arange(n_moves)).astype(int)
    for start, wrong in zip(starts.tolist(), error.tolist(), strict=True):
        person.respond(start / SFREQ, wrong)
    rows, held = [], np.empty((0, len(person.names)), np.float32)
    begin = 0
    for start in starts.tolist():
        first, last = start - chain.n_before, start + chain.n_after
        missing = last - begin - len(held)
        if missing > 0:
            held = np.concatenate((held[first - begin :], person.render(begin + len(held), missing + 2048)))
            begin = first
        rows.append(features(held[first - begin : last - begin], operator, spatial))
    return Moves(np.stack(rows), error)
