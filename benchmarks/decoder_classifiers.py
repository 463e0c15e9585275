"""Which classifier decodes best? Shrinkage LDA (the paper's) against others, on the same epochs and contiguous folds.

    python benchmarks/decoder_classifiers.py
    python benchmarks/decoder_classifiers.py --data ../shared/data --participants 6
    python benchmarks/decoder_classifiers.py --epochs 100

Each person watches 600 moves, 30 % errors; the kinds of people differ in what makes single trials hard to tell apart.
With --data they also answer in real EEG: the EDF files of the EEG Motor Movement/Imagery Database in that folder, one
after the other and never twice. xDAWN with Riemannian tangent space (pyriemann, `pip install errp-bci[benchmark]`) gets
whole epochs, 0-1 s, 1-20 Hz at 62.5 Hz, filtered forwards and backwards, which no live decoder could; the others get
the decoder's features. All are fitted in the folds alone. Prints Markdown: balanced accuracy / AUC in percent, the
mean difference of balanced accuracy from shrinkage LDA's with its 95 % interval over people, and a fit's time.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import mne
import numpy as np
from decoder_eyes import eye_movements
from numpy.typing import NDArray
from scipy import fft, linalg, signal, stats

from bci_app.config import ChainConfig, ClassifierConfig
from bci_app.terminal import progress_bar
from decoder import participant as simulated
from decoder.background import Background, RecordedBackground, bump
from decoder.calibration import auc, contiguous_folds, score
from decoder.chain import design
from decoder.classifier import fit
from decoder.epochs import Epoch, Shape, cut_recording
from decoder.eyes import learn_eyes
from decoder.montage import directions
from decoder.operator import chain_operator, features
from decoder.separable import separable_covariance
from decoder.spatial import compose, ocular

Array = NDArray[np.float64]
Labels = NDArray[np.bool_]

N_MOVES, N_ERRORS, SFREQ = 600, 180, 500.0
MOVE_S = {False: 1.5, True: 1.2}
"""Seconds a move, the second on recorded EEG: 600 moves fit into the database's 750 s of one person."""
SLOWER = 8  # Riemann's epochs: 500 / 8 Hz
N_WINDOWS = ChainConfig().n_windows
PAPER = "shrinkage LDA (paper)"


@dataclass(frozen=True)
class Kind:
    """People of a kind: `separation` of the classes' mean amplitudes in `gain_uv`, the spread of single trials."""

    name: str
    separation: float
    gain_uv: float = simulated.GAIN_UV
    latency_s: float = simulated.LATENCY_S
    eyes: bool = False
    two: bool = False
    recorded: bool = False


KINDS = (
    Kind("ErrP small", 0.8),
    Kind("ErrP middling", 1.8),
    Kind("ErrP large", 3.0),
    Kind("steady, weak", 1.6, gain_uv=2.0),
    Kind("latency ±30 ms", 1.8, latency_s=0.03),
    Kind("two sources", 1.8, two=True),
    Kind("eyes, corrected", 1.8, eyes=True),
    Kind("recorded", 1.8, recorded=True),
    Kind("recorded, steadier", 2.4, gain_uv=4.0, recorded=True),
)


@dataclass(frozen=True, eq=False)
class Session:
    """A person's 600 epochs.

    Attributes
    ----------
    features : (n_epochs, n_features), uV.
    epochs : (n_epochs, n_channels, n_times), uV, for Riemann.
    error : bool, (n_epochs,).
    """

    features: Array
    epochs: Array
    error: Labels


Judged = Callable[[Session, NDArray[np.int64], NDArray[np.int64]], Array]
"""Log odds of test epochs by a classifier fitted on training epochs."""


def record(kind: Kind, seed: int, background: Background | None) -> Session:
    """Render a person, and cut epochs and features with the decoder's own functions."""
    simulated.GAIN_UV, simulated.LATENCY_S = kind.gain_uv, kind.latency_s
    simulated.separation = lambda _: kind.separation
    person = simulated.Participant(seed, SFREQ, background=background)
    rng = np.random.default_rng(seed)
    error = rng.permutation(np.arange(N_MOVES) < N_ERRORS)
    onsets = 6 + MOVE_S[kind.recorded] * np.arange(N_MOVES) + rng.uniform(0, 0.02, N_MOVES)
    for onset, wrong in zip(onsets.tolist(), error.tolist(), strict=True):
        person.respond(onset, wrong)
    n_times = round((onsets[-1] + 2) * SFREQ)
    chunks = [person.render(start, min(5000, n_times - start)) for start in range(0, n_times, 5000)]
    samples = np.concatenate(chunks).astype(np.float64)
    if kind.two:
        add_second_source(samples, onsets, error, person.names, rng)
    n, eyes = len(person.names), None
    if kind.eyes:
        samples += eye_movements(onsets, np.zeros(N_MOVES, dtype=bool), n_times, person.names, seed)
        learnt = learn_eyes(samples, SFREQ, person.names)
        eyes = ocular(learnt.weights, learnt.sources)
    spatial, chain = compose(n, range(n), eyes=eyes), design(ChainConfig(), SFREQ)
    operator, shape = chain_operator(chain), Shape(SFREQ, chain.n_before, chain.n_after)
    cut = cut_recording(samples, np.arange(n_times) / SFREQ, onsets.tolist(), shape)
    rows = np.stack([features(epoch.data, operator, spatial) for epoch in cut if isinstance(epoch, Epoch)])
    band = signal.butter(4, (1, 20), "bandpass", fs=SFREQ, output="sos")
    slow = signal.sosfiltfilt(band, samples @ spatial.T, axis=0)[::SLOWER]
    firsts = np.round(onsets * SFREQ / SLOWER).astype(int)
    return Session(rows, np.stack([slow[first : first + round(SFREQ / SLOWER)].T for first in firsts]), error)


def add_second_source(
    samples: Array, onsets: Array, error: Labels, names: tuple[str, ...], rng: np.random.Generator
) -> None:
    """A parietal positivity at 420 ms, 6 uV larger after errors, whose amplitude varies by itself."""
    course = np.exp(-0.5 * ((np.arange(500) / SFREQ - 0.42) / 0.05) ** 2)
    response = np.outer(course, bump(directions(names), (0.3, -0.5, 0.9), 0.5))
    for onset, height in zip(onsets, rng.normal(6 * error, 3), strict=True):
        first = round(onset * SFREQ)
        samples[first : first + 500] += height * response


def read_database(folder: Path, seed: int) -> RecordedBackground:
    """All runs of the database one after the other; another seed begins elsewhere."""
    paths = sorted(folder.rglob("S001R*.edf"))
    if not paths:
        raise SystemExit(f"No S001R*.edf below {folder}. Give the folder of the EEG Motor Movement/Imagery Database.")
    parts = []
    for path in paths:
        raw = mne.io.read_raw(path, preload=True, verbose="error").pick("eeg")
        volts = raw.get_data()
        parts.append((volts - volts.mean(axis=1, keepdims=True)).T * 1e6)
    return RecordedBackground(np.concatenate(parts), tuple(raw.ch_names), float(raw.info["sfreq"]), SFREQ, seed)


def decoder(config: ClassifierConfig) -> Judged:
    """The decoder's own classifier."""

    def judged(session: Session, train: NDArray[np.int64], test: NDArray[np.int64]) -> Array:
        classifier = fit(session.features[train], session.error[train], config)
        return session.features[test] @ classifier.weights + classifier.bias

    return judged


def lda(covariance: Callable[[Array], Array]) -> Judged:
    """LDA with a covariance estimated from residuals, (n_epochs, n_features)."""

    def judged(session: Session, train: NDArray[np.int64], test: NDArray[np.int64]) -> Array:
        rows, error = session.features[train], session.error[train]
        means = np.stack((rows[~error].mean(axis=0), rows[error].mean(axis=0)))
        factor = linalg.cho_factor(covariance(rows - means[error.astype(int)]), overwrite_a=True)
        return (session.features[test] - means.mean(axis=0)) @ linalg.cho_solve(factor, means[1] - means[0])

    return judged


def shrunk(residuals: Array, shrinkage: float) -> Array:
    """Pooled covariance with a share of its diagonal that is set, not Ledoit and Wolf's."""
    covariance = residuals.T @ residuals / len(residuals)
    return (1 - shrinkage) * covariance + shrinkage * np.diag(np.diag(covariance))


def block_toeplitz(residuals: Array, shrinkage: float) -> Array:
    """Covariance that depends on the lag between windows alone (ToeplitzLDA, doi:10.1088/1741-2552/ac9c98).

    The mean block of each lag, tapered linearly with it, is the spectra's product: (n - lag) / n times their mean.
    """
    grid = residuals.reshape(len(residuals), -1, N_WINDOWS)
    spectra = fft.rfft(grid.transpose(2, 0, 1), 2 * N_WINDOWS, axis=0)
    of_lag = fft.irfft(spectra.conj().transpose(0, 2, 1) @ spectra, 2 * N_WINDOWS, axis=0) / residuals.size
    of_lag *= grid.shape[1]
    variances = np.diag(of_lag[0]).copy()
    of_lag *= 1 - shrinkage
    np.fill_diagonal(of_lag[0], variances)
    n = grid.shape[1]
    blocks = np.empty((n, N_WINDOWS, n, N_WINDOWS))
    for a in range(N_WINDOWS):
        for b in range(a, N_WINDOWS):
            blocks[:, a, :, b], blocks[:, b, :, a] = of_lag[b - a], of_lag[b - a].T
    return blocks.reshape(n * N_WINDOWS, -1)


def logistic(session: Session, train: NDArray[np.int64], test: NDArray[np.int64]) -> Array:
    """Ridge logistic regression on standardised features."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    model = make_pipeline(StandardScaler(), LogisticRegression(C=3e-3, class_weight="balanced", max_iter=2000))
    return model.fit(session.features[train], session.error[train]).decision_function(session.features[test])


def riemann(evoked: str, shrinkage: float) -> Judged:
    """XDAWN covariances, tangent space, logistic regression.

    ``evoked`` estimates the evoked responses' covariance for xDAWN, and that of all EEG is shrunk: of a common average,
    and of synthetic EEG, some dimensions are all but empty, and xDAWN with "oas" and without shrinkage chooses those.
    """

    def judged(session: Session, train: NDArray[np.int64], test: NDArray[np.int64]) -> Array:
        from pyriemann.estimation import XdawnCovariances
        from pyriemann.tangentspace import TangentSpace
        from sklearn.linear_model import LogisticRegression
        from sklearn.pipeline import make_pipeline

        by_channel = session.epochs[train].transpose(1, 0, 2).reshape(session.epochs.shape[1], -1)
        noise = by_channel @ by_channel.T / by_channel.shape[1]
        noise += shrinkage * np.trace(noise) / len(noise) * np.eye(len(noise))
        model = make_pipeline(
            XdawnCovariances(4, estimator="oas", xdawn_estimator=evoked, baseline_cov=noise),
            TangentSpace(),
            LogisticRegression(C=0.1, class_weight="balanced", max_iter=2000),
        )
        error = session.error.astype(int)
        return model.fit(session.epochs[train], error[train]).decision_function(session.epochs[test])

    return judged


CLASSIFIERS: dict[str, Judged] = {
    PAPER: decoder(ClassifierConfig(covariance="ledoit-wolf")),
    "separable LDA (ours)": decoder(ClassifierConfig(covariance="separable")),
    "the same, means as they are": lda(
        lambda rows: np.kron(*separable_covariance(rows.reshape(len(rows), -1, N_WINDOWS)))
    ),
    "block-Toeplitz LDA": lda(lambda rows: block_toeplitz(rows, 1e-3)),
    "LDA, shrunk by 0.1": lda(lambda rows: shrunk(rows, 0.1)),
    "LDA, shrunk by 0.4": lda(lambda rows: shrunk(rows, 0.4)),
    "logistic regression": logistic,
}
if find_spec("pyriemann"):
    CLASSIFIERS["xDAWN + Riemann"] = riemann("scm", 1e-3)
    CLASSIFIERS["xDAWN by OAS + Riemann"] = riemann("oas", 1e-3)


def measure(session: Session, judged: Judged, n_train: int) -> tuple[float, float, float]:
    """Balanced accuracy and AUC, percent, of contiguous folds, and seconds a fold."""
    log_odds, began = np.empty(N_MOVES), time.perf_counter()
    folds = contiguous_folds(session.error, ClassifierConfig())
    for train, test in folds:
        # The epochs that follow the test's, or else begin the recording: contiguous as well.
        kept = np.sort(np.roll(train, -int(np.searchsorted(train, test[0])))[:n_train])
        log_odds[test] = judged(session, kept, test)
    took = (time.perf_counter() - began) / len(folds)
    balanced = score(log_odds, session.error).balanced_accuracy.value
    return 100 * balanced, 100 * auc(log_odds, session.error).value, took


def table(kinds: list[Kind], figures: Array) -> list[str]:
    """Markdown of (n_kinds, n_people, n_classifiers, 3) figures."""
    lines = [f"| classifier | {' | '.join(kind.name for kind in kinds)} | mean | difference [95 %] | ms a fit |"]
    lines.append("|---" * (len(kinds) + 4) + "|")
    paper = list(CLASSIFIERS).index(PAPER)
    for number, name in enumerate(CLASSIFIERS):
        cells = [f"{each[0]:.1f} / {each[1]:.1f}" for each in figures[:, :, number].mean(axis=1)]
        mean = figures[:, :, number].mean(axis=(0, 1))
        gains = (figures[:, :, number, 0] - figures[:, :, paper, 0]).ravel()
        half = stats.t.ppf(0.975, len(gains) - 1) * gains.std(ddof=1) / np.sqrt(len(gains))
        gain = (
            "" if number == paper else f"{gains.mean():+.1f} [{gains.mean() - half:+.1f}, {gains.mean() + half:+.1f}]"
        )
        lines.append(f"| {name} | {' | '.join(cells)} | {mean[0]:.1f} / {mean[1]:.1f} | {gain} | {1e3 * mean[2]:.0f} |")
    return lines


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=3, help="people of each kind, at least 2 in all")
    parser.add_argument("--data", type=Path, help="folder with real EEG (S001R*.edf)")
    parser.add_argument("--epochs", type=int, default=N_MOVES, help="train on no more than so many")
    options = parser.parse_args()
    kinds = [kind for kind in KINDS if options.data or not kind.recorded]
    figures = np.empty((len(kinds), options.participants, len(CLASSIFIERS), 3))
    with progress_bar(False) as progress:
        for i, kind in enumerate(kinds):
            for j in range(options.participants):
                progress(kind.name, i * options.participants + j, len(kinds) * options.participants)
                background = read_database(options.data, j + 1) if kind.recorded else None
                session = record(kind, j + 1, background)
                for k, judged in enumerate(CLASSIFIERS.values()):
                    figures[i, j, k] = measure(session, judged, options.epochs)
    print("\n".join(table(kinds, figures)))


if __name__ == "__main__":
    main()
