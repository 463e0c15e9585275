"""Measure whether this machine may run this experiment: its screen, and a short run through all processes.

The run is an online one at real speed with a decoder fitted on noise: what it says means nothing, and takes as long.
"""

import platform
import secrets
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app import certificate, certification, priority, set_up, verbs
from bci_app.certification import NO_SCREEN, UNSEEN, Finding
from bci_app.config import Config, changed
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.lsl import MessageInlet, describe, find_eeg
from bci_app.progress import Progress
from bci_app.protocol import ACTIONS_STREAM, STIMULUS, Action, LateFrame, MoveOnset, SessionEnd, StreamSpec, Verdict
from bci_app.recording import Recording, read
from bci_app.runs import versions
from stimulus.pace import Flips

Key = tuple[int, int]
PARTICIPANT = "CERTIFY"
STEPS = 10
"""Moves of an episode; its goal is farther away, so that none ends before (decided)."""
FARTHEST = 20
"""Distance of the last episode's goal: the longest on `open`."""
MOST_MOVES = STEPS * (FARTHEST - STEPS)
N_FLIPS = 600
"""Flips the screen is measured by: ten seconds at 60 Hz (decided)."""
NAMES = ("photo", "light")
"""What a photodiode's channel is called, somewhere in its name, in any case."""


@dataclass(frozen=True)
class Wanted:
    """What is to be measured.

    Attributes
    ----------
    config : resolved configuration.
    n_moves : moves of the run, rounded up to tens.
    simulate : a simulated amplifier instead of the lab's.
    channel : the photodiode's; None looks for one by its name.
    page : where the page goes.
    """

    config: Config
    n_moves: int
    simulate: bool
    channel: str | None
    page: Path


def examine(wanted: Wanted, progress: Progress) -> dict[str, Any]:
    """``may_run``, ``sentence``, ``findings`` (what, found, limit, why, ok, figures), ``page`` and ``set_up``, which is
    None where no photodiode was seen; ``about`` is what was measured.

    Raises SetupError for a set-up that can't run at all, or a page that is there already.
    """
    config, stimulus = wanted.config, wanted.config.stimulus
    page, set_up_file = wanted.page, wanted.page.with_name(f"{wanted.page.stem}_set-up.json")
    for path in (page, set_up_file):
        if path.exists():
            raise SetupError(f"{path} is there already, and nothing is written over. Choose another file with --out.")
    certificate.make_room(page)
    eeg = _stream(wanted)
    channel = _channel(eeg, wanted.channel)
    progress("measuring the screen", 0, 3)
    flips, refresh_hz, key_ms, screen = _screen(config)
    progress("a short run", 1, 3)
    recording, ear = _run(wanted, eeg, channel is not None, progress)
    progress("reading it", 2, 3)
    light_ms = _light(recording, channel) if channel else None
    findings = [
        NO_SCREEN if flips is None else certification.screen(flips, refresh_hz),
        *_jumps(recording, stimulus.headless),
        UNSEEN if light_ms is None else certification.light(light_ms, key_ms),
    ]
    is_sure = findings[-1].ok is True
    seen_ms = light_ms[np.isfinite(light_ms)] if light_ms is not None else None
    if flips is not None:
        findings.append(certification.onsets(flips, seen_ms if seen_ms is not None and len(seen_ms) else None))
    findings += [certification.markers(_heard_after(recording, ear)), *certification.stages(_ledger(recording, ear))]
    about = _about(config, eeg, screen, recording, channel)
    certificate.write(certificate.html(findings, about), page)
    if is_sure and seen_ms is not None and channel is not None:
        name = None if wanted.simulate else eeg.name
        mean, sd = max(0.0, float(seen_ms.mean())), float(seen_ms.std())
        set_up.write(set_up.describe(config, name, channel, len(seen_ms), mean, sd), set_up_file)
    progress("done", 3, 3)
    return {
        "may_run": certification.may_run(findings),
        "sentence": certificate.sentence(findings),
        "findings": [asdict(finding) for finding in findings],
        "about": about,
        "page": str(page),
        "set_up": str(set_up_file) if is_sure else None,
    }


def findings_of(result: dict[str, Any]) -> list[Finding]:
    """The findings of a result, for the terminal."""
    return [Finding(**each) for each in result["findings"]]


def _stream(wanted: Wanted) -> EegDescription:
    """The EEG stream that is, or in a simulation will be."""
    if not wanted.simulate:
        eeg = describe(find_eeg(wanted.config.eeg, timeout=5.0))
        eeg.check()
        return eeg
    from decoder.amplifier import make_participant
    from decoder.photodiode import Photodiode

    person = make_participant(wanted.config.simulation, 0.0)
    others = Photodiode(wanted.config, 0.0, person.sfreq).names
    names = (*person.names, *others)
    types = (*("EEG",) * len(person.names), *("MISC",) * len(others))
    return EegDescription("SimulatedAmplifier", "", "", names, ("microvolts",) * len(names), types, person.sfreq)


def _channel(eeg: EegDescription, wished: str | None) -> str | None:
    """The photodiode's channel. Raises SetupError where the one wished for isn't there, or is taken for EEG."""
    if wished is not None and wished not in eeg.channels:
        raise SetupError(
            f"Stream '{eeg.name}' has no channel {wished}; it has {', '.join(eeg.channels)}. Name one of them with "
            "--photodiode."
        )
    found = [name for name in eeg.channels if any(word in name.lower() for word in NAMES)]
    channel = wished or (found[0] if found else None)
    if channel is not None and channel in eeg.picked:
        raise SetupError(
            f"The photodiode's channel {channel} of stream '{eeg.name}' is taken for EEG. Give it a type such as MISC "
            "in the amplifier's LSL connector."
        )
    return channel


def _screen(config: Config) -> tuple[Flips | None, float | None, float | None, str]:
    if config.stimulus.headless:
        return None, None, None, "none"
    from stimulus.screen import look

    found = look(config, N_FLIPS)
    words = f"{found.size[0]} x {found.size[1]} pixels, SDL driver {found.driver}"
    return found.flips, found.refresh_hz, found.key_ms, words


def _run(wanted: Wanted, eeg: EegDescription, has_light: bool, progress: Progress) -> tuple[Recording, "_Ear"]:
    """The short run's recording, and when its messages were heard; the files are gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="bci-app-certify-"))
    episodes = -(-wanted.n_moves // STEPS)
    short: dict[str, Any] = {
        "recordings": str(folder),
        "stimulus": {
            "person": False,
            "photon_delay_ms": 0.0,  # it is what is measured
            "set_up": None,
            "photodiode": wanted.config.stimulus.photodiode or ("top-left" if has_light else None),
        },
        "online": {"distances": [FARTHEST - episodes + 1, FARTHEST], "max_steps": STEPS},
    }
    session = f"certify-{secrets.token_hex(4)}"
    wishes = verbs.Wishes(changed(wanted.config, short), PARTICIPANT, simulate=wanted.simulate, session=session)
    ear = _Ear(session)
    ear.start()
    try:
        told, _ = verbs.online(wishes, "open", _noise_decoder(wanted.config, eeg, folder), "told", True, progress)
        if told["reason"] != "complete":
            raise SetupError(f"The short run didn't come to its end: {told['text']} Start it again.")
        return read(Path(told["recording"]), eeg_type=wishes.config.eeg.stream_type), ear
    except KeyboardInterrupt as interrupt:
        interrupt.args = ("Nothing is kept of a certification.",)
        raise
    finally:
        ear.stop()
        shutil.rmtree(folder, ignore_errors=True)


def _noise_decoder(config: Config, eeg: EegDescription, folder: Path) -> Path:
    """A decoder that answers as soon as any other, and as often wrong as right."""
    from decoder import calibration, model
    from decoder.chain import design

    rng, channels = np.random.default_rng(0), eeg.picked
    chain, n_moves = design(config.chain, eeg.sfreq), 80
    error = np.arange(n_moves) % 2 == 0
    features = rng.normal(0, 3, (n_moves, len(channels) * config.chain.n_windows))
    settings = config.classifier.model_copy(update={"estimator": None, "min_per_class": 20})
    fitted = calibration.calibrate(features, error, settings, config.chain.n_windows)
    made = model.make_model(
        fitted, error, chain, settings, participant=PARTICIPANT, channels=tuple(channels), n_rejected=0
    )
    path = folder / "noise_decoder.safetensors"
    model.save(made, path)
    return path


class _Ear(Thread):
    """Hears moves and actions as another program does, at once, and writes down when."""

    def __init__(self, session: str) -> None:
        super().__init__(daemon=True)
        self._session, self._is_over = session, Event()
        self.moves: dict[Key, float] = {}
        """Real time at which each move was heard of."""
        self.actions: dict[Key, float] = {}

    def run(self) -> None:
        """Listen until told to stop."""
        listening = [Thread(target=self._listen, args=(spec,), daemon=True) for spec in (STIMULUS, ACTIONS_STREAM)]
        for thread in listening:
            thread.start()
        for thread in listening:
            thread.join()

    def stop(self) -> None:
        """End it."""
        self._is_over.set()
        self.join()

    def _listen(self, spec: StreamSpec) -> None:
        inlet = None
        while inlet is None and not self._is_over.is_set():
            inlet = MessageInlet.find(spec, self._session, timeout=0.5)
        while inlet is not None and not self._is_over.is_set():
            for item in inlet.pull(timeout=0.2):
                match item.message:
                    case SessionEnd():
                        self._is_over.set()
                    case MoveOnset(episode=episode, step=step):
                        self.moves.setdefault((episode, step), item.arrived)
                    case Action(episode=episode, step=step):
                        self.actions.setdefault((episode, step), item.arrived)


def _onsets(recording: Recording) -> dict[Key, float]:
    return {(move.episode, move.step): stamp for stamp, move in recording.of(MoveOnset)}


def _light(recording: Recording, channel: str) -> NDArray[np.float64]:
    """Delays from flip to light, ms; on the EEG's clock, as the decoder brought the flips there."""
    verdicts = recording.verdicts
    flips = [
        stamp + (verdicts[key].clock_offset if key in verdicts else 0.0) for key, stamp in _onsets(recording).items()
    ]
    samples = recording.samples[:, recording.eeg.channels.index(channel)]
    return certification.light_delays(samples, recording.times, np.array(flips))


def _jumps(recording: Recording, headless: bool) -> list[Finding]:
    if headless:
        return []
    late = [frame for _, frame in recording.of(LateFrame) if frame.step is not None]
    return [certification.late_jumps(len(late), len(recording.of(MoveOnset)))]


def _heard_after(recording: Recording, ear: _Ear) -> NDArray[np.float64]:
    """From each flip to when another program had heard of it, ms."""
    onsets = _onsets(recording)
    return np.array([(ear.moves[key] - stamp) * 1e3 for key, stamp in onsets.items() if key in ear.moves])


def _ledger(recording: Recording, ear: _Ear) -> dict[str, NDArray[np.float64]]:
    """Stages of each move, ms."""
    onsets = _onsets(recording)
    verdict_at = {(verdict.episode, verdict.step): stamp for stamp, verdict in recording.of(Verdict)}
    verdict_ms = [verdict.latency_ms for _, verdict in recording.of(Verdict) if verdict.latency_ms is not None]
    actions: list[float] = []
    ways: list[float] = []
    left: list[float] = []
    for stamp, action in recording.of(Action):
        key, before = (action.episode, action.step), (action.episode, action.step - 1)
        if before in verdict_at:
            actions.append((stamp - verdict_at[before]) * 1e3)
        if key in ear.actions:
            ways.append((ear.actions[key] - stamp) * 1e3)
            if before in onsets and key in onsets:
                left.append((onsets[key] - ear.actions[key]) * 1e3)
    found: dict[str, Sequence[float]] = {"verdict": verdict_ms, "action": actions, "way": ways, "left": left}
    return {name: np.array(values, dtype=np.float64) for name, values in found.items()}


def _about(
    config: Config, eeg: EegDescription, screen: str, recording: Recording, channel: str | None
) -> dict[str, str]:
    packages = versions()
    return {
        "when": datetime.now().astimezone().isoformat(timespec="minutes"),
        "computer": f"{platform.node()}, {platform.platform()}, {platform.machine()}",
        "screen": screen,
        "EEG": f"'{eeg.name}', {len(eeg.picks)} EEG channels at {eeg.sfreq:g} Hz",
        "photodiode": channel or "none",
        "priority": priority.outlook(config.priority),
        "run": f"{len(recording.of(MoveOnset))} moves at real speed, all processes, recorded by LabRecorder",
        "versions": ", ".join(f"{name} {number}" for name, number in packages.items()),
    }
