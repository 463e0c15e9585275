"""The loop in one process against the loop of three processes over LSL: identical actions?

    python benchmarks/study_equivalence.py --sessions 100 --folder FOLDER
    python benchmarks/study_equivalence.py --recordings FOLDER ...

Simulated sessions are recorded over LSL, each of another participant, run and map. Each is then made again in one
process. From the recording come only what a live session owes to the moment: the origin of its clock, the times of its
flips, and over which samples the decoder looked at the electrodes. Everything else is made anew: episodes, EEG, truths,
verdicts, actions. Compared are all of them, to the bit; one action that differed would lead the run elsewhere.

Where the simulated amplifier heard of a move only after it had sent samples that answer it, as on a busy machine at
high speed, the live EEG lacks part of the answer, and the session says so: those are counted as `late`, and can't be
the same.

With --recordings sessions that are there already are compared. What one process does when it is left to its own
moments isn't the same session, for its EEG has other samples at the flips: that is an equality of distributions only.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from bci_app import fitting, verbs
from bci_app.config import Config, changed, validated
from bci_app.errors import SetupError
from bci_app.protocol import Action, Continued, Electrodes, Message, Note, Truth, Verdict
from bci_app.recording import Recording, read
from bci_app.runs import checksum, eeg_type, read_sidecar
from bci_app.study import alone
from decoder.amplifier import make_participant
from decoder.model import load
from decoder.model import save as save_model

KINDS: tuple[type[Message], ...] = (Electrodes, Verdict, Action, Truth)
SEARCHED = 200_000
"""Samples of a session that are searched for its beginning."""
MISSING = Path("missing")
NOT_COMPARED = {"latency_ms", "protocol", "session"}


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument(
        "--recordings", type=Path, nargs="*", help="Recordings or folders of some, instead of making some."
    )
    parser.add_argument("--folder", type=Path, default=Path("equivalence"), help="Where those that are made go.")
    parser.add_argument("--speed", type=float, default=24.0)
    parser.add_argument("--participants", type=int, default=4, help="Calibrated in one process, for the sessions.")
    parser.add_argument("--longest", type=int, default=20, help="Longest initial distance; 20 is a whole session.")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.recordings:
        paths = [
            path
            for each in asked.recordings
            for path in ([each] if each.is_file() else sorted(each.rglob("*_eeg.xdf")))
        ]
    else:
        paths = sessions(asked.folder, asked.sessions, asked.participants, asked.speed, asked.longest)
    found: list[dict[str, Any]] = []
    left_out: list[str] = []
    for path in paths:
        try:
            row = compare(path)
        except SetupError as error:  # damaged on purpose by a drill, or a decoder of an older version
            left_out.append(f"{path}: {error}")
            continue
        if row is None:
            left_out.append(f"{path}: not a whole simulated session without faults, or its files are gone")
        else:
            found.append(row)
            if not asked.json:
                print(row, flush=True)
    same = sum(row["identical"] for row in found)
    total = {f"{kind.__name__}": sum(row[kind.__name__][0] for row in found) for kind in KINDS}
    late = sum(bool(row["late"]) for row in found)
    summary: dict[str, Any] = {
        "sessions": len(found),
        "identical": same,
        "with_late_truths": late,
        "identical_of_the_others": sum(row["identical"] for row in found if not row["late"]),
        **total,
        "left_out": len(left_out),
    }
    print(json.dumps(summary | ({"rows": found, "reasons": left_out} if asked.json else {}), indent=1))


def sessions(folder: Path, n: int, n_participants: int, speed: float, longest: int) -> Any:
    """Record sessions over LSL, one after the other; those that are there already aren't made again."""
    base = {
        "recordings": str(folder),
        "stimulus": {"headless": True},
        "online": {"distances": [2, longest]},
        "simulation": {"sfreq": 256.0, "errp_at_edge": 0.8, "errp_habituation": 0.1, "errp_online": 0.9},
    }
    for number in range(n):
        who = number % n_participants
        skill = {"seed": 40 + who, "decodability": 0.6 + 0.3 * who / max(1, n_participants - 1)}
        config = changed(Config(), base | {"simulation": base["simulation"] | skill})  # type: ignore[operator]
        name, visit = f"E{who:02d}", f"S{number:03d}"
        made = sorted((folder / f"sub-{name}" / f"ses-{visit}").rglob("*_eeg.xdf"))
        if made:
            yield made[0]
            continue
        model = decoder_of(config, name, folder)
        wishes = verbs.Wishes(config, name, visit, simulate=True, speed=speed, seed=number)
        map_name = ("open", "obstacles")[number // n_participants % 2]
        told, _ = verbs.online(
            wishes, map_name, model, ("told", "accuracy")[number % 2], True, lambda what, done, of: None
        )
        yield Path(told["recording"])


def decoder_of(config: Config, name: str, folder: Path) -> Path:
    """A participant's decoder, calibrated in one process."""
    path = folder / f"{name}_decoder.safetensors"
    if not path.exists():
        short = changed(config, {"calibration": {"n_blocks": 2}})
        _, _, fitted = fitting.decoder_of(alone.calibrate(short, name, 1), name, short)
        folder.mkdir(parents=True, exist_ok=True)
        save_model(fitted, path)
    return path


def compare(path: Path) -> dict[str, Any] | None:
    """A recorded session against the same in one process; None for one that isn't simulated or has no origin."""
    sidecar = read_sidecar(path)
    if not is_whole(sidecar):
        return None
    recording = read(path, eeg_type=eeg_type(sidecar))
    model, policy = (file_of(path, sidecar, name) for name in ("model", "policy"))
    if recording.of(Continued) or (model is None) != (sidecar["model"] is None) or policy is MISSING:
        return None
    sidecar.setdefault("origin", origin_of(recording, validated(sidecar["config"], str(path))))
    if sidecar["origin"] is None:
        return None
    late = sum(note.role == "amplifier" and note.level == "error" for _, note in recording.of(Note))
    row: dict[str, Any] = {"late": late, "recording": path.name, "visit": path.parent.parent.name}
    try:
        again = alone.again(recording, sidecar, load(model) if model else None, policy)
    except StopIteration:  # it asks for the flip of a move that the live session didn't make
        return row | {kind.__name__: (len(plain(recording, kind)), 0, 0) for kind in KINDS} | {"identical": False}
    for kind in KINDS:
        live, made = plain(recording, kind), plain(again, kind)
        row[kind.__name__] = (len(live), sum(a == b for a, b in zip(live, made, strict=False)), len(made))
    return row | {"identical": all(row[kind.__name__] == (row[kind.__name__][0],) * 3 for kind in KINDS)}


def is_whole(sidecar: dict[str, Any]) -> bool:
    """Whether it is of a simulated session that ended well, without any fault that was asked for, from the start on."""
    if not sidecar.get("simulated") or sidecar.get("reason") != "complete" or sidecar.get("continues"):
        return False
    simulation = sidecar["config"]["simulation"]
    faults = (
        "dead",
        "drop_outs",
        "disconnects",
        "clock_jumps",
        "packet_loss",
        "photodiode_ms",
        "rehearse",
        "background",
    )
    return not any(simulation.get(name) for name in faults)


def file_of(path: Path, sidecar: dict[str, Any], name: str) -> Path | None:
    """The decoder or policy of a run, if it had one and it is still there."""
    if not sidecar[name]:
        return None
    named = Path(sidecar[name]["path"])
    for each in (named, path.with_name(named.name)):
        if each.exists() and checksum(each) == sidecar[name]["sha256"]:
            return each
    return MISSING if name == "policy" else None


def origin_of(recording: Recording, config: Config) -> float | None:
    """The origin of a session's clock where its sidecar doesn't tell it: the place of its first sample in the EEG of
    the same participant says how long after the origin that was taken."""
    person, size = make_participant(config.simulation, 0.0), 2000
    for begin in range(0, SEARCHED, size):
        found = np.flatnonzero((person.render(begin, size) == recording.samples[0]).all(axis=1))
        if len(found):
            rows = begin + int(found[0]) + np.arange(len(recording.times))
            about = float(recording.times[0] - rows[0] / person.sfreq)
            near = [about, np.nextafter(about, np.inf), np.nextafter(about, -np.inf)]
            return next((float(t0) for t0 in near if np.array_equal(t0 + rows / person.sfreq, recording.times)), None)
    return None


def plain(recording: Recording, kind: type[Message]) -> list[dict[str, Any]]:
    """The messages of a kind, without what tells the moment or the session."""
    return [message.model_dump(exclude=NOT_COMPARED) for _, message in recording.of(kind)]


if __name__ == "__main__":
    main()
