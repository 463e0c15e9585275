"""The operator against MNE on a 30-minute recording of 64 channels at 500 Hz: 600 epochs, both from raw samples.

    python benchmarks/decoder_chain_speed.py

MNE resamples, filters and references the whole recording and cuts epochs; the operator looks at the epochs only. MNE
does it as it comes, resampling by FFT, and in the fastest way it has, polyphase. Then the same with four bad channels
repaired and the eyes regressed out, and the time one epoch takes. One thread each, as MNE has by default.
"""

import os
import time

os.environ["OMP_NUM_THREADS"] = "1"

import mne
import numpy as np

from bci_app.config import ChainConfig
from decoder.chain import design
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.montage import MONTAGE_64, template
from decoder.operator import chain_operator, features
from decoder.spatial import common_average, compose, interpolation, ocular

SFREQ, MINUTES, N_MOVES = 500.0, 30, 600


WAYS = ("fft", "polyphase")
BAD = ("Fp1", "T7", "CPz", "O2")
EYES = ("Fp2", "AF7")  # regressed out as they are: it is the time that counts here


def with_operator(samples: np.ndarray, onsets: np.ndarray, repaired: bool) -> tuple[np.ndarray, float, float]:
    """Features (n_moves, 960), and the seconds for the features alone and together with the cutting."""
    chain = design(ChainConfig(), SFREQ)
    operator, spatial = chain_operator(chain), full_spatial(samples) if repaired else common_average(len(MONTAGE_64))
    shape = Shape(SFREQ, chain.n_before, chain.n_after)
    times = np.arange(len(samples)) / SFREQ
    began = time.perf_counter()
    epochs = cut_recording(samples, times, onsets.tolist(), shape)
    cut = time.perf_counter()
    rows = np.stack([features(epoch.data, operator, spatial) for epoch in epochs if isinstance(epoch, Epoch)])
    done = time.perf_counter()
    return rows, done - cut, done - began


def full_spatial(samples: np.ndarray) -> np.ndarray:
    """Repair, regression and average as one matrix; learning it is no part of the time, as with MNE."""
    n = len(MONTAGE_64)
    repair = interpolation(MONTAGE_64, BAD)
    sources = np.eye(n)[[MONTAGE_64.index(name) for name in EYES]]
    centred = (samples - samples.mean(axis=0)) @ repair.T
    weights = np.linalg.lstsq(centred @ sources.T, centred, rcond=None)[0].T
    return compose(n, range(n), repair=repair, eyes=ocular(weights, sources))


def with_mne(samples: np.ndarray, onsets: np.ndarray, repaired: bool, method: str) -> tuple[np.ndarray, float]:
    """Features (n_moves, 960) and seconds, resampled in one of MNE's ways."""
    chain = design(ChainConfig(), 256.0)
    raw = mne.io.RawArray(samples.T * 1e-6, mne.create_info(list(MONTAGE_64), SFREQ, "eeg"), verbose="error")
    raw.set_montage(template(), verbose="error")
    if repaired:
        raw.info["bads"] = list(BAD)
        learnt = raw.copy().interpolate_bads(verbose="error").set_eeg_reference(ref_channels=[], verbose="error")
        regression = mne.preprocessing.EOGRegression(picks="eeg", picks_artifact=list(EYES)).fit(learnt)
        del learnt
    began = time.perf_counter()
    if repaired:
        raw.interpolate_bads(verbose="error").set_eeg_reference(ref_channels=[], verbose="error")
        raw = regression.apply(raw, copy=False)
    raw.resample(256.0, method=method, verbose="error")
    raw.filter(1.0, 50.0, phase="minimum", verbose="error")
    raw.set_eeg_reference("average", verbose="error")
    events = np.stack([np.round(onsets * 256).astype(int), np.zeros(len(onsets), int), np.ones(len(onsets), int)], 1)
    epochs = mne.Epochs(raw, events, tmin=0.0, tmax=0.6, baseline=None, preload=True, verbose="error")
    data = epochs.get_data(copy=False) * 1e6
    windows = [slice(w.start - chain.n_before, w.stop - chain.n_before) for w in chain.windows]
    rows = np.stack([data[..., window].mean(axis=2) for window in windows], axis=2).reshape(len(data), -1)
    return rows, time.perf_counter() - began


def one_epoch(n_channels: int, sfreq: float) -> float:
    """Median seconds for the features of one epoch, every channel contributing to every feature."""
    chain = design(ChainConfig(), sfreq)
    operator = chain_operator(chain)
    rng = np.random.default_rng(0)
    spatial = rng.normal(size=(n_channels, n_channels))
    epochs = rng.normal(0, 20, (5, chain.n_raw, n_channels))
    seconds = []
    for repetition in range(100):
        began = time.perf_counter()
        features(epochs[repetition % 5], operator, spatial)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def main() -> None:
    """Measure and print."""
    rng = np.random.default_rng(0)
    samples = rng.normal(0, 1, (round(MINUTES * 60 * SFREQ), 64)).cumsum(axis=0)
    onsets = 5 + np.linspace(0, MINUTES * 60 - 10, N_MOVES)
    for repaired in (False, True):
        print("with repair and ocular correction" if repaired else "resampled, filtered, common average")
        # The best of three, in turns.
        runs = [
            (with_operator(samples, onsets, repaired), *(with_mne(samples, onsets, repaired, way) for way in WAYS))
            for _ in range(3)
        ]
        features_s, total_s = (min(run[0][column] for run in runs) for column in (1, 2))
        print(f"  operator:       {features_s:.3f} s for the features, {total_s:.3f} s with cutting and checking")
        for place, way in enumerate(WAYS, start=1):
            mne_s = min(run[place][1] for run in runs)
            agreement = np.corrcoef(runs[0][0][0].ravel(), runs[0][place][0].ravel())[0, 1]
            ratios = f"{mne_s / features_s:.0f} (features), {mne_s / total_s:.0f} (with cutting)"
            print(f"  MNE, {way:9}: {mne_s:.3f} s, ratio {ratios}, r = {agreement:.5f}")
    for n_channels, sfreq in ((8, 250.0), (64, 500.0), (256, 2000.0)):
        print(f"one epoch, {n_channels} channels at {sfreq:g} Hz: {1e3 * one_epoch(n_channels, sfreq):.2f} ms")


if __name__ == "__main__":
    main()
