"""A participant's runs in one process: what `calibrate`, `fit` and `online` do, without LSL and without waiting."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from bci_app.config import Config, changed
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.gridworld import GridWorld, load_map
from bci_app.protocol import Electrodes, MoveOnset, SessionStart
from bci_app.recording import Recording, Stamped
from bci_app.study.loop import LEAD_S, AsHeard, Ideal, Loop, Moments, Stream, described
from bci_app.told import Told
from decoder.amplifier import make_participant
from decoder.attention import Attention
from decoder.judge import judge_with, judge_without
from decoder.model import DecoderModel
from policy import cards, checkpoint
from policy.agent import Agent
from policy.ear import Ear
from policy.navigator import Navigator
from policy.verdicts import Verdicts
from stimulus.paradigm import Paradigm

SESSION = "one-process"
_NO_EEG = EegDescription("none", "", "", (), (), (), 1.0)


def for_run(config: Config, seed: int) -> Config:
    """The configuration of a simulated run, as a live session makes it: nobody turns pages, another hour each run."""
    values = {"stimulus": {"headless": True, "person": False}, "simulation": {"run": seed}}
    return changed(config, values)


def calibrate(
    config: Config,
    participant: str,
    seed: int,
    moments: Moments | None = None,
    t0: float = 0.0,
    model: DecoderModel | None = None,
) -> Recording:
    """A calibration, as a recording in memory. With a decoder `model` its moves are judged, and the person's ErrP is as
    large as online: that tells what verdicts are worth on moves the decoder wasn't fitted on."""
    config = for_run(config, seed)
    world = load_map(config.calibration.map)
    paradigm = Paradigm.calibration(config, world, SESSION, participant, seed)
    stream = Stream(make_participant(config.simulation, t0), t0)
    eeg = described(stream.person)
    judge = judge_with(model, config, eeg, SESSION) if model else judge_without(config, eeg, SESSION)
    attention = Attention(config.simulation, as_online=model is not None)
    loop = Loop(paradigm, stream, attention, judge, None, moments or Ideal())
    loop.run(t0 + LEAD_S)
    return recorded(loop)


def online(
    config: Config,
    participant: str,
    seed: int,
    world: GridWorld,
    model: DecoderModel | None,
    policy: Path,
    told: str | None,
    moments: Moments | None = None,
    t0: float = 0.0,
) -> Recording:
    """An online run, as a recording in memory. Without a model there is no EEG, and all verdicts are missing."""
    config = for_run(config, seed)
    paradigm = Paradigm.online(config, world, SESSION, participant, seed)
    network, card = checkpoint.load(policy)
    cards.check_fits(card, world)
    ear = Ear(Verdicts.parse(card.verdicts), Told.parse(told) if told else None)
    navigator = Navigator(Agent(network, ear, world), world, SESSION)
    moments = moments or Ideal()
    if model is None:
        loop = Loop(paradigm, None, None, None, navigator, moments)
    else:
        stream = Stream(make_participant(config.simulation, t0), t0)
        judge = judge_with(model, config, described(stream.person), SESSION)
        loop = Loop(paradigm, stream, Attention(config.simulation), judge, navigator, moments)
    loop.run(t0 + LEAD_S)
    return recorded(loop)


def recorded(loop: Loop) -> Recording:
    """A run of the loop as a recording that was never a file."""
    if loop.stream is None:
        messages = tuple(Stamped(*item) for item in sorted(loop.messages, key=lambda item: item[0]))
        nothing = np.empty(0)
        return Recording(Path(SESSION), _NO_EEG, nothing.reshape(0, 0), nothing, messages, ())
    made = loop.made()
    return Recording(
        Path(SESSION), made.eeg, made.samples, made.times, tuple(Stamped(*item) for item in made.messages), ()
    )


def again(
    recording: Recording, sidecar: dict[str, object], model: DecoderModel | None, policy: Path | None
) -> Recording:
    """A simulated session that was recorded, in one process: with its flips and its looks at the electrodes, from the
    same seeds; nothing else is taken from the recording.

    Raises SetupError where its sidecar doesn't tell the origin of its clock.
    """
    opening, origin = recording.of(SessionStart)[0][1], sidecar.get("origin")
    if not isinstance(origin, float) or not sidecar.get("simulated"):
        raise SetupError(
            f"{recording.path} must be of a simulated session whose sidecar tells the origin of its clock, and isn't."
        )
    config, seed = Config.model_validate(sidecar["config"]), int(str(sidecar["seed"]))
    moments = as_heard(recording)
    if opening.task == "calibration":
        return calibrate(config, opening.participant, seed, moments, origin)
    assert policy is not None
    told = sidecar.get("told")
    world = load_map(str(sidecar["map"]))
    return online(config, opening.participant, seed, world, model, policy, str(told) if told else None, moments, origin)


def as_heard(recording: Recording) -> Moments:
    """The moments of a recorded session."""
    onsets: Iterable[float] = [stamp for stamp, _ in recording.of(MoveOnset)]
    looks = {(look.episode, look.step): look for _, look in recording.of(Electrodes)}
    return AsHeard(iter(onsets), looks, recording.eeg.sfreq)


def without_eeg(recording: Recording) -> Recording:
    """Its messages alone: a cohort's EEG would fill the memory."""
    return replace(recording, samples=np.empty((0, recording.samples.shape[1])), times=np.empty(0))
