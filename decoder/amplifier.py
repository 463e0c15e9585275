"""The amplifier process of a simulation: plays a participant's EEG over LSL and listens to nothing but the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from bci_app.clock import Clock
from bci_app.config import Config, SimulationConfig
from bci_app.eeg import EegDescription
from bci_app.errors import SetupError
from bci_app.lsl import EegOutlet, LateInlet, local_clock
from bci_app.peer import Peer
from bci_app.protocol import (
    AMPLIFIER_NOTES,
    STIMULUS,
    TRUTH,
    MoveOnset,
    Position,
    SessionEnd,
    SessionStart,
    Truth,
    simulated_source_id,
)
from decoder.attention import Attention
from decoder.background import read_background
from decoder.montage import match_channels
from decoder.participant import Participant, Person
from decoder.photodiode import Photodiode
from decoder.rehearsal import Rehearsed
from decoder.rehearsal_file import load

INPUT_NOISE_UV = 0.2
"""Standard deviation of an amplifier's own noise, uV (decided; 0.1 to 0.5 are usual)."""
BURST = 5
"""Packets lost in a row, in the mean (decided)."""


def run(
    config: Config,
    session: str,
    clock: Clock,
    parent: int | None = None,
    task: Literal["calibration", "online"] | None = None,
    layout: Sequence[str] = (),
) -> None:
    """Play until the session ends. Samples carry the session time of their acquisition, whenever they are sent.

    Parameters
    ----------
    task, layout : of the run, as in its `SessionStart`, for one that is started when that was said long ago.
    """
    peer = Peer(AMPLIFIER_NOTES, "amplifier", session, clock, parent)
    peer.say("waiting", "for the participant to wake up")
    player = _Player(config, peer)
    if task is not None:
        player.attention.open(task, layout)
    while not player.ended:
        peer.say("ready" if player.listening else "waiting", "playing EEG")
        player.listen(config.simulation.chunk_s)
        player.play()
    peer.linger(player.play)


def make_participant(config: SimulationConfig, t0: float) -> Person:
    """The participant of the configuration; sample 0 is taken at session time `t0`."""
    if config.rehearse:
        return Rehearsed(load(Path(config.rehearse)), config.seed, config.errp, t0=t0, run=config.run)
    background = read_background(Path(config.background), config.sfreq, config.run) if config.background else None
    return Participant(
        config.seed, config.sfreq, config.decodability, config.errp, background=background, t0=t0, run=config.run
    )


class _Player:
    """A participant wired to an EEG outlet and to the stimulus's truth."""

    def __init__(self, config: Config, peer: Peer) -> None:
        self._config = config.simulation
        self._peer = peer
        # One that takes another's place plays the same EEG on.
        self._t0 = peer.clock.origin
        self._participant = make_participant(config.simulation, self._t0)
        names = tuple(self._participant.names)
        self._dead, missing = match_channels(config.simulation.dead, names)
        if missing:
            raise SetupError(
                f"simulation.dead names channels that this participant hasn't got: {', '.join(missing)}. It has "
                f"{', '.join(names)}."
            )
        self.attention = Attention(config.simulation)
        # Of moves of which the other isn't known yet.
        self._truths: dict[tuple[int, int], tuple[float, Truth]] = {}
        self._positions: dict[tuple[int, int], Position] = {}
        self._last_truth: tuple[float, Truth] | None = None
        self._noise = np.random.default_rng(config.simulation.run)
        self._photodiode = Photodiode(config, self._t0, self._participant.sfreq)
        n_eeg, others = len(names), self._photodiode.names
        source_id = config.eeg.source_id or simulated_source_id(peer.session)
        description = EegDescription(
            name="SimulatedAmplifier",
            source_id=source_id,
            hostname="",
            channels=(*names, *others),
            units=("microvolts",) * (n_eeg + len(others)),
            types=(*("EEG",) * n_eeg, *("MISC",) * len(others)),
            sfreq=self._participant.sfreq,
        )
        self._description = description
        self._outlet: EegOutlet | None = EegOutlet(description, peer.session)
        self._began: float | None = None  # real time of the session's start
        self._is_in_burst = False
        # While it waited for a stream, no samples would be sent.
        self._truth, self._stimulus = (LateInlet(spec, peer.session) for spec in (TRUTH, STIMULUS))
        self._played = self._n_acquired()
        self.ended = False

    @property
    def listening(self) -> bool:
        """Whether the stimulus is heard."""
        return self._truth.inlet is not None and self._stimulus.inlet is not None

    def listen(self, timeout: float) -> None:
        """React to moves as soon as their truth is told; the stimulus's own stream tells only when all is over."""
        truths, rest = self._truth.inlet, self._stimulus.inlet
        if truths is None:
            self._peer.rest(timeout)
            return
        for item in self._peer.hear(truths, timeout):
            is_again = (item.stamp, item.message) == self._last_truth  # of a stimulus that was started again
            if isinstance(item.message, Truth) and not is_again:
                self._last_truth = item.stamp, item.message
                self._photodiode.jump(item.stamp)
                if self.attention.is_even:
                    self._respond(item.stamp, item.message, 1.0)
                else:
                    self._truths[item.message.episode, item.message.step] = item.stamp, item.message
        for item in self._peer.hear(rest) if rest is not None else ():
            self.ended |= isinstance(item.message, SessionEnd)
            match item.message:
                case SessionStart() as opening:
                    self._began = local_clock()
                    self.attention.open(opening.task, opening.layout)
                case MoveOnset() as move if not self.attention.is_even:
                    self._positions[move.episode, move.step] = move.position
        # The two streams may bring a move's truth and where it led in either order.
        for key in sorted(self._truths.keys() & self._positions.keys()):
            stamp, truth = self._truths.pop(key)
            self._respond(stamp, truth, self.attention.size(truth, self._positions.pop(key)))

    def _respond(self, onset: float, truth: Truth, size: float) -> None:
        if not self._participant.respond(onset, truth.error, size):
            text = f"The truth of episode {truth.episode}, step {truth.step} came after its samples were sent."
            self._peer.note("error", text)

    def _n_acquired(self) -> int:
        """Samples acquired up to now less the amplifier's own delay."""
        clock = self._peer.clock
        return max(0, int((clock.now() - self._config.delay_s * clock.speed - self._t0) * self._participant.sfreq))

    def play(self) -> None:
        """Send what was acquired up to now less the amplifier's own delay."""
        n_new = self._n_acquired() - self._played
        if n_new <= 0:
            return
        samples = self._participant.render(self._played, n_new)
        self._participant.forget(self._played)
        if self._dead:
            samples = samples.copy()  # the participant keeps what it has rendered
            samples[:, self._dead] = self._noise.normal(0, INPUT_NOISE_UV, (n_new, len(self._dead)))
        if self._photodiode.names:
            samples = np.hstack((samples, self._photodiode.render(self._played, n_new)))
        stamps = self._t0 + np.arange(self._played, self._played + n_new) / self._participant.sfreq
        self._played += n_new
        self._connect_or_not()
        stamps += sum(by for begins, length, by in self._config.clock_jumps if self._is_within(((begins, length),)))
        if self._outlet is not None and not self._is_within(self._config.drop_outs) and not self._is_lost():
            self._outlet.push(samples, stamps)

    def _is_within(self, times: tuple[tuple[float, float], ...]) -> bool:
        """Whether now is one of (beginning, length), s after the session's start."""
        since = -1.0 if self._began is None else local_clock() - self._began
        return any(begins <= since < begins + length for begins, length in times)

    def _connect_or_not(self) -> None:
        if self._is_within(self._config.disconnects):
            self._outlet = None
        elif self._outlet is None:
            self._outlet = EegOutlet(self._description, self._peer.session)

    def _is_lost(self) -> bool:
        """Whether this packet is lost: a burst begins and ends by chance, so that the share is as configured."""
        share = self._config.packet_loss
        if self._began is None or not share:
            return False
        ends, begins = 1 / BURST, share / (1 - share) / BURST
        self._is_in_burst = self._noise.random() < (1 - ends if self._is_in_burst else begins)
        return self._is_in_burst
