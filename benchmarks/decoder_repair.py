"""What four dead channels of 64 cost: accuracy with them found and repaired, against the same person without.

    python benchmarks/decoder_repair.py [--participants 10] [--dead 4]

Each simulated participant watches 600 moves, on which the decoder is fitted, and 600 more. Channels drawn at random are
dead from the start (cross-validated in contiguous folds), or only after the decoder was fitted. They are found by the
examiner as before an episode, on 10 s of EEG, and then repaired as they are live.
"""

import argparse
from dataclasses import replace

import numpy as np
from decoder_decodability import N_MOVES, record
from rich.console import Console
from rich.table import Table

from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.terminal import progress_bar
from decoder.calibration import calibrate, score
from decoder.electrodes import Examiner
from decoder.epochs import Epoch, Rejection, cut_recording
from decoder.judge import judge_without
from decoder.participant import Participant


def figures(number: int, n_dead: int) -> dict[str, float]:
    """Balanced accuracies of one person, and the share of dead channels that were found, and of good ones that weren't
    called bad."""
    config = Config()
    person = Participant(number, decodability=0.75)
    samples, onsets, error = record(person, 2, number)
    eeg = EegDescription("R", "", "", person.names, ("uV",) * 64, ("EEG",) * 64, person.sfreq)
    times = np.arange(len(samples)) / person.sfreq
    judge = judge_without(config, eeg, "repair")
    epochs = [
        epoch for epoch in cut_recording(samples, times, onsets.tolist(), judge.shape) if isinstance(epoch, Epoch)
    ]
    rng = np.random.default_rng([number, 2])
    places = rng.choice(64, n_dead, replace=False)
    spoilt = samples[: round(10 * person.sfreq)].copy()
    spoilt[:, places] = rng.normal(0, 0.2, (len(spoilt), n_dead))  # an input's noise is all there is
    found = Examiner("repair", person.names, person.sfreq).decide((0, 0), spoilt, times[: len(spoilt)]).bad
    dead = {person.names[place] for place in places}
    mended = judge.with_bad(found)

    def rows(with_dead: bool) -> np.ndarray:
        vectors = []
        for epoch in epochs:
            data = epoch.data
            if with_dead:
                data = data.copy()
                data[:, places] = rng.normal(0, 0.2, (len(data), n_dead))
            vector = (mended if with_dead else judge).features(replace(epoch, data=data))
            assert not isinstance(vector, Rejection), vector.reason
            vectors.append(vector)
        return np.array(vectors)

    whole, repaired = rows(False), rows(True)
    truth, fresh = error[:N_MOVES], error[N_MOVES:]
    fitted, mended_fit = (calibrate(each[:N_MOVES], truth, config.classifier) for each in (whole, repaired))

    def online(each: np.ndarray) -> float:
        log_odds = np.array([fitted.classifier.log_odds(row) for row in each[N_MOVES:]])
        return score(log_odds, fresh).balanced_accuracy.value

    return {
        "found": len(dead & set(found)) / n_dead,
        "wrongly": len(set(found) - dead) / (64 - n_dead),
        "CV whole": fitted.blocked.balanced_accuracy.value,
        "CV dead": mended_fit.blocked.balanced_accuracy.value,
        "online whole": online(whole),
        "online dead": online(repaired),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=10)
    parser.add_argument("--dead", type=int, default=4)
    options = parser.parse_args()
    people = []
    with progress_bar(quiet=False) as show:
        for number in range(1, options.participants + 1):
            show("participants", number - 1, options.participants)
            people.append(figures(number, options.dead))
    values = {name: np.array([person[name] for person in people]) for name in people[0]}
    found, wrongly = values["found"].mean(), values["wrongly"].mean()
    print(f"{options.dead} dead of 64: found {found:.1%}; good ones called bad {wrongly:.2%}")
    table = Table("balanced accuracy", "all good", "dead and repaired", "difference, points", "worst person")
    for when, label in (("CV", "dead in the calibration too"), ("online", "dead after it, fresh moves")):
        change = 100 * (values[f"{when} dead"] - values[f"{when} whole"])
        error = change.std(ddof=1) / np.sqrt(len(change))
        cells = (f"{values[f'{when} {kind}'].mean():.3f}" for kind in ("whole", "dead"))
        table.add_row(label, *cells, f"{change.mean():+.2f} +- {error:.2f}", f"{change.min():+.2f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
