"""The operator against MNE on a 30-minute recording of 64 channels at 500 Hz: 600 epochs, both from raw samples.

    python benchmarks/decoder_chain_speed.py

MNE resamples, filters and references the whole recording and cuts epochs; the operator looks at the epochs only.
"""

import time

import mne
import numpy as np

from bci_app.config import ChainConfig, EegConfig
from decoder.chain import design
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.montage import MONTAGE_64
from decoder.operator import chain_operator, features

SFREQ, MINUTES, N_MOVES = 500.0, 30, 600


def with_operator(samples: np.ndarray, onsets: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Features (n_moves, 960), and the seconds for the features alone and together with the cutting."""
    chain = design(ChainConfig(), SFREQ)
    operator = chain_operator(chain)
    shape = Shape(SFREQ, chain.n_before, chain.n_after, EegConfig().max_uv)
    times = np.arange(len(samples)) / SFREQ
    began = time.perf_counter()
    epochs = cut_recording(samples, times, onsets.tolist(), shape)
    cut = time.perf_counter()
    rows = np.stack([features(epoch.data, operator) for epoch in epochs if isinstance(epoch, Epoch)])
    done = time.perf_counter()
    return rows, done - cut, done - began


def with_mne(samples: np.ndarray, onsets: np.ndarray) -> tuple[np.ndarray, float]:
    """Features (n_moves, 960) and seconds."""
    chain = design(ChainConfig(), 256.0)
    raw = mne.io.RawArray(samples.T * 1e-6, mne.create_info(list(MONTAGE_64), SFREQ, "eeg"), verbose="error")
    began = time.perf_counter()
    raw.resample(256.0, method="polyphase", verbose="error")
    raw.filter(1.0, 50.0, phase="minimum", verbose="error")
    raw.set_eeg_reference("average", verbose="error")
    events = np.stack([np.round(onsets * 256).astype(int), np.zeros(len(onsets), int), np.ones(len(onsets), int)], 1)
    epochs = mne.Epochs(raw, events, tmin=0.0, tmax=0.6, baseline=None, preload=True, verbose="error")
    data = epochs.get_data(copy=False) * 1e6
    windows = [slice(w.start - chain.n_before, w.stop - chain.n_before) for w in chain.windows]
    rows = np.stack([data[..., window].mean(axis=2) for window in windows], axis=2).reshape(len(data), -1)
    return rows, time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    rng = np.random.default_rng(0)
    samples = rng.normal(0, 1, (round(MINUTES * 60 * SFREQ), 64)).cumsum(axis=0)
    onsets = 5 + np.linspace(0, MINUTES * 60 - 10, N_MOVES)
    runs = [(*with_operator(samples, onsets), *with_mne(samples, onsets)) for _ in range(3)]  # the best of three
    features_s, total_s, mne_s = (min(run[column] for run in runs) for column in (1, 2, 4))
    ours, theirs = runs[0][0], runs[0][3]
    agreement = np.corrcoef(ours.ravel(), theirs.ravel())[0, 1]
    print(f"operator: {features_s:.3f} s for the features, {total_s:.3f} s with cutting and checking")
    print(f"MNE:      {mne_s:.3f} s")
    print(f"ratio:    {mne_s / features_s:.0f} (features), {mne_s / total_s:.0f} (with cutting); r = {agreement:.5f}")


if __name__ == "__main__":
    main()
