"""Whether faulty channels are found and good ones left alone: 12 kinds of faults put into one channel of real EEG.

    python benchmarks/decoder_quality.py                # what is reported: runs 4, 6, 8; made-up people 200 to 229
    python benchmarks/decoder_quality.py --half tune    # what thresholds were chosen on: runs 3, 5, 7; people 100-129

Windows of 10 s begin anywhere. A fault is `found` when the channel is called bad, `named` when the name fits. Of clean
windows one is taken every second, as live; ten in a row overlap, so the intervals of their rates are too narrow. No
window was left out by eye; in the `undisturbed` ones the whole head's level (median over channels of the means of
seconds) stays within 100 uV, so that nobody pulled at the reference.
The 12 kinds are those an operator can do something about, and that differ in what gives them away:

flat, nearly flat         cable out, or a bridge to the reference: an amplifier's noise of 0.1-0.5 uV is all there is
railed, now and then      electrode off the head, the input saturates; or it touches the head once in a while
NaN, infinite             lost packets, a wrong unit, a filter that ran away, in a few samples
drift                     sweat, fresh gel: 400-1500 uV in 10 s
pops                      an electrode that is pulled: 2-6 steps of 150-600 uV, held or decaying
line                      high impedance, an unshielded cable: 20-100 uV rms in one channel, with harmonics
broadband                 a bad contact, a twitching muscle: 26-45 Hz, five times what the neighbours have
floating                  no contact: noise of ordinary size and spectrum, unrelated to the head
gain                      ten times too much or too little: a wrong setting, a wrong unit
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from decoder.background import SyntheticBackground
from decoder.montage import directions
from decoder.quality import Inspector

Array = NDArray[np.float64]
DATA = Path(os.environ.get("BCI_APP_DATA", Path(__file__).parents[2] / "shared" / "data"))
WINDOW_S = 10
RUNS = {"tune": (3, 5, 7), "report": (4, 6, 8)}
PEOPLE = {"tune": range(100, 130), "report": range(200, 230)}


def _noise(rng: np.random.Generator, n_times: int, exponent: float) -> Array:
    """Noise of unit variance whose power falls with frequency to the `exponent` above 1 Hz of 10 s."""
    spectrum = rng.standard_normal(n_times // 2 + 1) + 1j * rng.standard_normal(n_times // 2 + 1)
    spectrum /= np.maximum(np.arange(len(spectrum)), WINDOW_S) ** (exponent / 2)
    spectrum[:WINDOW_S] *= np.arange(WINDOW_S) / WINDOW_S
    noise = np.fft.irfft(spectrum, n_times)
    return noise / noise.std()


def _band_rms(samples: Array, sfreq: float, low: float, high: float) -> Array:
    sos = signal.butter(4, (low, high), "bandpass", fs=sfreq, output="sos")
    filtered = signal.sosfiltfilt(sos, samples, axis=0)[int(sfreq) : -int(sfreq)]
    return np.sqrt(np.median(filtered**2, axis=0) / 0.455)  # of a normal distribution: robust against blinks


class Faults:
    """Puts faults into channels of a montage."""

    def __init__(self, names: tuple[str, ...], sfreq: float) -> None:
        self.sfreq = sfreq
        where = directions(names)
        self.nearest = np.argsort(-(where @ where.T), axis=1)[:, 1:7]

    def flat(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        eeg[:, channel] = eeg[0, channel]

    def nearly_flat(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        eeg[:, channel] = eeg[0, channel] + rng.uniform(0.1, 0.5) * rng.standard_normal(len(eeg))

    def railed(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        rail = rng.choice([-1, 1]) * rng.choice([187_500.0, 250_000.0, 341_600.0, 400_000.0])
        eeg[:, channel] = rail + rng.choice([0.0, 0.02]) * rng.integers(-1, 1, len(eeg))

    def railed_now_and_then(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        rail = eeg[:, channel].mean() + rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(500), np.log(200_000)))
        for _ in range(rng.integers(2, 6)):
            n_held = int(rng.uniform(0.1, 0.6) * self.sfreq)
            first = rng.integers(len(eeg) - n_held)
            eeg[first : first + n_held, channel] = rail

    def nan(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        eeg[rng.integers(len(eeg), size=rng.integers(1, 20)), channel] = np.nan

    def infinite(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        eeg[rng.integers(len(eeg), size=rng.integers(1, 20)), channel] = rng.choice([-np.inf, np.inf])

    def drift(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        x = np.linspace(0, 1, len(eeg))
        tau = rng.uniform(0.3, 1)
        shape = [x, (1 - np.exp(-x / tau)) / (1 - np.exp(-1 / tau)), (1 - np.cos(np.pi * x)) / 2][rng.integers(3)]
        eeg[:, channel] += rng.choice([-1, 1]) * rng.uniform(400, 1500) * shape

    def pops(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        for _ in range(rng.integers(2, 7)):
            first = rng.integers(int(0.2 * self.sfreq), len(eeg) - int(0.2 * self.sfreq))
            seconds = np.arange(len(eeg) - first) / self.sfreq
            tau = rng.choice([np.inf, rng.uniform(0.3, 2)])
            eeg[first:, channel] += rng.choice([-1, 1]) * rng.uniform(150, 600) * np.exp(-seconds / tau)

    def line(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        hz, size = rng.choice([50, 60]) + rng.uniform(-0.1, 0.1), np.sqrt(2) * rng.uniform(20, 100)
        seconds = np.arange(len(eeg)) / self.sfreq
        for harmonic, share in ((1, 1.0), (2, 0.1), (3, 0.3)):
            if harmonic * hz < 0.45 * self.sfreq:
                phase = rng.uniform(0, 2 * np.pi)
                eeg[:, channel] += size * share * np.sin(2 * np.pi * harmonic * hz * seconds + phase)

    def broadband(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        around = np.median(_band_rms(eeg[:, self.nearest[channel]], self.sfreq, 26, 45))
        noise = rng.standard_normal(len(eeg))
        if rng.random() < 0.5:
            sos = signal.butter(2, (20, 0.45 * self.sfreq), "bandpass", fs=self.sfreq, output="sos")
            noise = signal.sosfilt(sos, noise)
        eeg[:, channel] += 5 * around * noise / _band_rms(noise[:, None], self.sfreq, 26, 45)

    def floating(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        size = np.median(_band_rms(eeg, self.sfreq, 1, 40))
        eeg[:, channel] = eeg[0, channel] + rng.uniform(0.7, 1.5) * size * _noise(rng, len(eeg), rng.uniform(0.5, 2))

    def gain(self, eeg: Array, channel: int, rng: np.random.Generator) -> None:
        eeg[:, channel] *= rng.choice([0.1, 10.0])


KINDS: dict[str, tuple[Callable[[Faults, Array, int, np.random.Generator], None], set[str]]] = {
    "flat": (Faults.flat, {"flat"}),
    "nearly flat": (Faults.nearly_flat, {"flat"}),
    "railed": (Faults.railed, {"railed"}),
    "railed now and then": (Faults.railed_now_and_then, {"railed"}),
    "NaN now and then": (Faults.nan, {"not finite"}),
    "infinite": (Faults.infinite, {"not finite"}),
    "slow drift": (Faults.drift, {"drifting"}),
    "pops": (Faults.pops, {"jumping"}),
    "line noise": (Faults.line, {"line noise"}),
    "broadband noise": (Faults.broadband, {"noisy"}),
    "floating": (Faults.floating, {"unrelated"}),
    "gain x10 or /10": (Faults.gain, {"too large", "too small", "flat"}),
}


class Source:
    """EEG to put faults into: runs of (n_times, n_channels) in uV."""

    def __init__(self, title: str, runs: list[Array], names: tuple[str, ...], sfreq: float) -> None:
        self.title, self.runs, self.names, self.sfreq = title, runs, names, sfreq
        self.n_window = int(WINDOW_S * sfreq)
        self.inspector, self.faults = Inspector(names, sfreq), Faults(names, sfreq)

    def part(self, n_channels: int) -> "Source":
        """The same with fewer channels, from all over the head."""
        picks = np.linspace(0, len(self.names) - 1, n_channels).astype(int)
        runs = [run[:, picks] for run in self.runs]
        return Source(self.title, runs, tuple(self.names[pick] for pick in picks), self.sfreq)


def recorded(half: str, folder: Path) -> Source:
    """The runs of a half, in uV as they were recorded, without the zeros at their ends."""
    import mne

    runs = []
    for number in RUNS[half]:
        raw = mne.io.read_raw_edf(folder / "eegmmidb_s001" / f"S001R0{number}.edf", preload=True, verbose="error")
        samples = raw.get_data().T * 1e6
        runs.append(samples[: np.flatnonzero(samples.any(axis=1))[-1] + 1])
    return Source(f"real EEG, runs {RUNS[half]}", runs, tuple(raw.ch_names), float(raw.info["sfreq"]))


def made_up(half: str) -> Source:
    """Twenty seconds of each of 30 simulated people at 500 Hz."""
    people = [SyntheticBackground(seed, 500.0) for seed in PEOPLE[half]]
    return Source("made-up EEG", [person.samples(0, 20 * 500) for person in people], people[0].names, 500.0)


def wilson(n: int, of: int) -> str:
    """A rate and its 95 % interval (Wilson 1927)."""
    z, share = 1.96, n / of
    middle, spread = share + z * z / (2 * of), z * np.sqrt(share * (1 - share) / of + (z / (2 * of)) ** 2)
    low, high = (max(0.0, (middle + sign * spread) / (1 + z * z / of)) for sign in (-1, 1))
    return f"{100 * share:.2f} % ({100 * low:.2f}-{100 * high:.2f})"


def clean_windows(source: Source) -> Iterator[Array]:
    """A window every second of every run."""
    for run in source.runs:
        for first in range(0, len(run) - source.n_window + 1, int(source.sfreq)):
            yield run[first : first + source.n_window]


def undisturbed(window: Array, sfreq: float) -> bool:
    """Whether the whole head's level stays where it is."""
    seconds = window[: WINDOW_S * int(sfreq)].reshape(WINDOW_S, int(sfreq), -1).mean(axis=1)
    return float(np.ptp(np.median(seconds - seconds.mean(axis=0), axis=1))) <= 100


def inject(source: Source, kind: str, seed: int) -> tuple[bool, bool, int]:
    """Put one fault into one channel: whether it's found, and by name, and how many others are called bad."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    run, channel, n_window = (
        source.runs[rng.integers(len(source.runs))],
        rng.integers(len(source.names)),
        source.n_window,
    )
    first = rng.integers(len(run) - n_window + 1)
    window = run[first : first + n_window].copy()
    put, expected = KINDS[kind]
    put(source.faults, window, int(channel), rng)
    result = source.inspector.inspect(window)
    others = sum(quality.is_bad for quality in result) - result[channel].is_bad
    return result[channel].is_bad, bool(expected & set(result[channel].faults)), others


def measure(source: Source, n_seeds: int) -> None:
    """Print the table of faults for one source of EEG."""
    print(f"\n{source.title}: {len(source.names)} channels, {source.sfreq:g} Hz, {WINDOW_S} s\n")
    print("| fault in one channel | found | named | other channels called bad |\n|---|---|---|---|")
    for kind in KINDS:
        found, named, others = np.array([inject(source, kind, seed) for seed in range(n_seeds)]).sum(axis=0)
        of_others = n_seeds * (len(source.names) - 1)
        print(f"| {kind} | {wilson(found, n_seeds)} | {wilson(named, n_seeds)} | {others} of {of_others} |")


def measure_clean(source: Source) -> None:
    """Print how many clean channels and windows are called bad."""
    windows = list(clean_windows(source))
    results = [source.inspector.inspect(window) for window in windows]
    calm = [undisturbed(window, source.sfreq) for window in windows]
    alarms = [quality for result in results for quality in result if quality.is_bad]
    any_bad = [any(quality.is_bad for quality in result) for result in results]
    calm_bad = sum(bad for bad, is_calm in zip(any_bad, calm, strict=True) if is_calm)
    print(
        f"| {source.title}, {len(source.names)} channels | {wilson(len(alarms), len(results) * len(source.names))} "
        f"| {wilson(sum(any_bad), len(results))} of {len(results)} | {wilson(calm_bad, sum(calm))} of {sum(calm)} "
        f"| {', '.join(sorted({f'{quality.name} {fault}' for quality in alarms for fault in quality.faults}))} |"
    )


def measure_speed() -> None:
    """Print the time for 256 channels at 2000 Hz."""
    person = SyntheticBackground(1, 2000.0)
    noise = np.random.default_rng(0).standard_normal((WINDOW_S * 2000, 256))
    samples = np.tile(person.samples(0, WINDOW_S * 2000), 4) + noise
    copies = [f"{name}h{copy}" if copy else name for copy in range(4) for name in person.names]
    for what, names in (("64 places known", copies), ("no place known", [f"E{number}" for number in range(256)])):
        inspector, times = Inspector(names, 2000.0), []
        for _ in range(15):
            began = time.process_time()
            inspector.inspect(samples)
            times.append(time.process_time() - began)
        print(f"256 channels, {what}, 2000 Hz, 10 s: {1e3 * np.median(times):.0f} ms of CPU (median of 15)")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of real recordings")
    parser.add_argument("--half", choices=("tune", "report"), default="report")
    parser.add_argument("--seeds", type=int, default=50)
    options = parser.parse_args()
    sources = [made_up(options.half)]
    if options.data.exists():
        sources.insert(0, recorded(options.half, options.data))
    else:
        print(f"No real recordings at {options.data}: set BCI_APP_DATA or give --data.")
    for source in sources:
        measure(source, options.seeds)
    print("\n| clean EEG | channel-windows called bad | windows with any | undisturbed windows with any | which |")
    print("|---|---|---|---|---|")
    for source in sources:
        for part in (source, *(source.part(n_channels) for n_channels in (32, 16, 8))):
            measure_clean(part)
    print()
    measure_speed()


if __name__ == "__main__":
    main()
