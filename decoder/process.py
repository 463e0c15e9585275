"""The decoder process: EEG and move onsets in, verdicts out. It waits for samples, never for the clock."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bci_app.clock import Clock
from bci_app.config import Config
from bci_app.errors import SetupError
from bci_app.lsl import EegInfo, EegInlet, MessageInlet, NoStream, find_eeg, local_clock
from bci_app.peer import Peer
from bci_app.protocol import (
    STIMULUS,
    VERDICTS,
    Continued,
    Electrodes,
    EpisodeStart,
    Link,
    MoveOnset,
    Pause,
    Recall,
    Resume,
    SessionEnd,
    SessionStart,
    Verdict,
)
from bci_app.said import is_void, place_after
from decoder import model as models
from decoder.drift import DriftWatch
from decoder.electrodes import RECORDED_S, Examiner, changes
from decoder.enquiry import Enquiry
from decoder.epochs import EpochBuffer, Rejection
from decoder.judge import Judge, MoveKey, judge_with, judge_without
from decoder.reception import LINK_S, Reception
from decoder.timeline import MAX_JITTER, check_rate

POLL_S = 0.005
"""Longest real time a round waits for a sample before it looks for onsets again."""
PATIENCE_S = 4.0
"""Real seconds of silence after which moves that wait for samples are rejected: what comes late is not lost, but the
policy waits no longer than 5 s for a verdict (decided)."""
REJECTED_BEFORE_A_LOOK = 2
"""Verdicts rejected in a row after which the electrodes are looked at again within an episode (decided)."""
DECISIONS = 20
"""Decisions on the electrodes that are kept: those of moves that a stimulus which died may make again."""
FIND_S = 20.0
"""Real seconds an EEG stream may take to be found (decided)."""
LOST_S = 10.0
"""Real seconds an amplifier may take to deliver its first samples, and samples may be missing after the session's end
(decided)."""
SAME_CLOCK_S = 0.005
"""Seconds two streams of one host may seem apart: `time_correction` is good to 0.2 ms, more when a machine is busy."""
CLOCK_S = 5.0
"""Seconds the newest sample's stamp may be from now; buffers and networks delay by less (decided)."""
LOOK_S = 3.0
"""Session seconds of EEG looked at before the decoder calls itself ready."""
CHECK_S = 2.0
"""Real seconds each step may take of asking a stream that came back what it is and what its clock says."""


def run(
    config: Config,
    session: str,
    clock: Clock,
    model_path: Path | None,
    parent: int | None = None,
    returning: bool = False,
    fingerprint: str | None = None,
) -> None:
    """Serve one session, from the first sample to the verdict on its last move.

    When it is `returning` the session has begun already, with a decoder that is gone; `fingerprint` is then that of the
    stream which that one heard.

    Raises SetupError for an EEG stream that is missing, ambiguous or doesn't fit.
    """
    model = models.load(model_path) if model_path else None
    peer = Peer(VERDICTS, "decoder", session, clock, parent)
    # One that takes a dead one's place may come while the amplifier is away.
    patience = config.eeg.patience_s if returning else FIND_S
    eeg = EegInlet(_find(config, peer, patience), config.eeg.buffer_s)
    if fingerprint not in (None, eeg.description.fingerprint):
        raise SetupError(
            f"Stream '{eeg.description.name}' isn't what the run began with: name, source id, channels, units or rate "
            "have changed. Restore the amplifier's settings and start the run again; what was recorded is kept."
        )
    judge = (
        judge_with(model, config, eeg.description, session)
        if model
        else judge_without(config, eeg.description, session)
    )
    watch = DriftWatch(model.held_out_log_odds, model.held_out_error) if model else None
    server = _Server(config, peer, eeg, judge, watch)
    server.look(patience if returning else LOST_S)
    stimulus = peer.wait_for(STIMULUS)
    if returning:
        server.recall(peer.remember())
    server.serve(stimulus)
    peer.linger()


def _find(config: Config, peer: Peer, patience: float) -> EegInfo:
    """The EEG stream, for which it is waited `patience` real seconds, aloud. Raises SetupError as `find_eeg` does."""
    started = local_clock()
    while True:
        peer.say("waiting", "for an EEG stream")
        try:
            return find_eeg(config.eeg, timeout=1.0)
        except NoStream:
            if local_clock() - started > patience:
                raise


class _Server:
    """One session's buffer and connections."""

    def __init__(self, config: Config, peer: Peer, eeg: EegInlet, judge: Judge, watch: DriftWatch | None) -> None:
        self._watch = watch
        self._config = config
        self._peer = peer
        self._eeg = eeg
        self._judge = judge
        picked = eeg.description.picked
        n_channels = len(picked)
        self._examiner = Examiner(peer.session, picked, eeg.description.sfreq)
        self._decisions: list[Electrodes] = []
        self._n_rejected = 0  # verdicts in a row since the electrodes were looked at
        self._recorded_since = -np.inf  # stamp of the EEG
        self._is_in_trouble = False  # the stimulus waits, and for no person
        self._judges: dict[MoveKey, Judge] = {}
        self._buffer: EpochBuffer[MoveKey] = EpochBuffer(judge.shape, n_channels, config.eeg.buffer_s)
        self._offsets: dict[MoveKey, float] = {}
        self._onsets: dict[MoveKey, float] = {}  # of the last move
        description, settings = eeg.description, config.eeg
        # The rest of an epoch's samples come until its next move.
        until_move = config.stimulus.rest_s + config.stimulus.countdown_s
        lead_s = max(0.0, judge.shape.n_before / judge.shape.sfreq - until_move) + MAX_JITTER
        speed, tolerance, patience_s = peer.clock.speed, settings.rate_tolerance, settings.patience_s
        self._reception = Reception(description.name, description.sfreq, speed, lead_s, tolerance, patience_s)
        self._correction = Enquiry(eeg.clock_correction)
        self._changed = Enquiry(lambda: eeg.look_again(CHECK_S))
        self._eeg_offset = eeg.clock_correction()  # seconds
        self._same_clock = False  # as the stimulus
        self._linked_at = 0.0

    def look(self, patience: float) -> None:
        """Take a few seconds of EEG to see that it is alive, on LSL's clock and at its rate."""
        description = self._eeg.description
        stamps = [np.empty(0)]
        alive, heard_at = False, local_clock()
        # Also so long that the very first move can have its epoch.
        wanted = max(LOOK_S * description.sfreq, self._judge.shape.n_before)
        while sum(map(len, stamps)) < wanted:
            self._peer.say("waiting", f"for {wanted / description.sfreq:.1f} s of EEG from '{description.name}'")
            samples, times = self._eeg.pull(POLL_S)
            self._buffer.push(samples, times)
            stamps.append(times)
            alive |= len(samples) > 0 and bool((samples != samples[:1]).any())
            heard_at = local_clock() if len(times) else heard_at
            if local_clock() - heard_at > patience:
                raise SetupError(
                    f"Stream '{description.name}' is there but delivers no samples. Start the amplifier's acquisition."
                )
        if not alive:
            raise SetupError(
                f"Stream '{description.name}' delivers a flat line on all channels. Connect the electrodes, or the cap."
            )
        self._check_clock(float(stamps[-1][-1]) if len(stamps[-1]) else float(np.concatenate(stamps)[-1]))
        check_rate(np.concatenate(stamps), description.sfreq, description.name, self._config.eeg.rate_tolerance)

    def _check_clock(self, newest: float) -> None:
        """LSL stamps are seconds of LSL's clock; some programs push the time of day or of the amplifier instead."""
        now = self._peer.clock.to_session(local_clock() - self._eeg_offset)
        if abs(now - newest) > CLOCK_S * max(1.0, self._peer.clock.speed):
            raise SetupError(
                f"Stream '{self._eeg.description.name}' stamps its samples {newest - now:+.1f} s from LSL's clock, so "
                "moves and EEG can't be brought together. Set its connector to LSL's own time stamps."
            )

    def recall(self, recall: Recall) -> None:
        """Go on where a decoder before this one ended: its electrodes, and the moves it left unjudged."""
        self._is_in_trouble = True  # the session waits until this process is back
        moves: dict[MoveKey, Verdict | None] = {}
        episode = -1
        for item in recall.said:
            match item.message:
                case EpisodeStart() as start:
                    episode = start.episode
                case Electrodes() as electrodes:
                    self._decide(electrodes)
                case MoveOnset() as move:
                    moves.setdefault((move.episode, move.step), None)
                case Verdict() as verdict:
                    moves[verdict.episode, verdict.step] = verdict
        if episode >= 0 and (self._electrodes is None or self._electrodes.episode < episode):
            # It died before it had looked at them: what held before holds on.
            bad = self._electrodes.bad if self._electrodes else {}
            self._decide(Electrodes(session=self._peer.session, episode=episode, bad=bad))
            self._peer.push(self._decisions[-1])
        for key, verdict_before in moves.items():
            self._buffer.know(key)
            if verdict_before is None:
                reason = "the decoder was started again, and the move's samples were lost with the one before"
                self._tell(self._judge.verdict(key, Rejection(reason, by_time=True), 0.0))
            elif key == max(moves):
                self._peer.push(verdict_before)  # it may not have reached everybody

    def serve(self, stimulus: MessageInlet) -> None:
        """Judge moves until the session has ended and every move has its verdict."""
        # Two streams of one machine share its clock: their difference is exactly nothing. A name can be shared by two
        # machines, though, so it is measured once: that takes half a second, all later measurements are at hand.
        apart = stimulus.clock_correction() - self._eeg_offset
        self._same_clock = stimulus.hostname == self._eeg.description.hostname and abs(apart) < SAME_CLOCK_S

        def offset() -> float:
            behind_s = self._reception.behind_s(local_clock())
            return (0.0 if self._same_clock else stimulus.clock_correction() - self._eeg_offset) - behind_s

        ended, ended_at = False, 0.0
        while not ended or self._buffer.n_waiting:
            lacks = self._reception.lacks
            if lacks is not None:
                self._peer.say("waiting", lacks)
            else:
                self._peer.say("ready", f"{self._buffer.n_waiting} epochs open")
            samples, times = self._eeg.pull(POLL_S)
            arrived = local_clock()
            self._buffer.push(samples, times)
            self._follow(times)
            for item in self._peer.hear(stimulus):
                match item.message:
                    case MoveOnset() as move:
                        if self._n_rejected >= REJECTED_BEFORE_A_LOOK:
                            self._examine((move.episode, move.step))
                        self._expect((move.episode, move.step), item.stamp, offset())
                    case EpisodeStart() as start:
                        self._begin(start.episode)
                    case SessionStart():
                        self._recorded_since = item.stamp + offset() - RECORDED_S
                    case Continued() as continued:
                        self._forget_void(continued)
                    case Pause() as pause:
                        self._is_in_trouble = not pause.by_person
                    case Resume() if self._is_in_trouble:
                        # The recorder may have found the amplifier again later than this process did.
                        self._recorded_since = item.stamp + offset()
                    case SessionEnd():
                        ended, ended_at = True, arrived
            if ended and arrived - ended_at > LOST_S:
                self._buffer.abandon("its samples never came")
            self._answer(arrived)

    def _begin(self, episode: int) -> None:
        if self._electrodes is not None and self._electrodes.episode >= episode:
            return  # said once more, by a stimulus that was started again
        self._buffer.done_with(lambda key: key[0] < episode - 1)
        self._examine((episode, 0))

    def _examine(self, key: MoveKey) -> None:
        """Decide which electrodes are bad; the moves from this one on are judged without them."""
        samples, times = self._buffer.trailing(self._examiner.n_window)
        self._n_rejected = 0
        before = self._electrodes
        electrodes = self._examiner.examine(key, samples, times, self._recorded_since, before)
        self._peer.push(electrodes)
        self._decide(electrodes)
        for sentence in changes(before, electrodes):
            self._peer.note("warning", sentence)
        if self._judge.unusable is not None:
            self._peer.note("error", self._judge.unusable)

    @property
    def _electrodes(self) -> Electrodes | None:
        """The decision that holds."""
        return self._decisions[-1] if self._decisions else None

    def _decide(self, electrodes: Electrodes) -> None:
        self._decisions = [*self._decisions[-DECISIONS:], electrodes]
        self._judge = self._judge.with_bad(electrodes.bad)

    def _expect(self, key: MoveKey, onset: float, offset: float) -> None:
        if not self._buffer.expect(key, onset + offset):
            if self._onsets.get(key) == onset:
                return  # said once more, by a stimulus that was started again
            self._peer.note("warning", f"Episode {key[0]}, step {key[1]} was announced twice; the first counts.")
            return
        self._offsets[key], self._judges[key] = offset, self._judge
        self._onsets = {key: onset}

    def _forget_void(self, continued: Continued) -> None:
        """Moves that the stimulus, started again, doesn't remember come once more."""
        self._buffer.forget(lambda key: key > place_after(continued))
        kept = [decision for decision in self._decisions if not is_void(decision, continued)]
        if len(kept) < len(self._decisions):
            self._decisions = kept
            self._judge = self._judge.with_bad(kept[-1].bad if kept else {})

    def _answer(self, arrived: float) -> None:
        for key, result in self._buffer.poll():
            verdict = self._judges.pop(key).verdict(key, result, self._offsets.pop(key))
            self._tell(verdict.model_copy(update={"latency_ms": (local_clock() - arrived) * 1e3}))

    def _tell(self, verdict: Verdict) -> None:
        key = verdict.episode, verdict.step
        self._peer.push(verdict)
        self._n_rejected = self._n_rejected + 1 if verdict.outcome == "rejected" else 0
        if verdict.outcome == "rejected":
            self._peer.note("warning", f"No verdict on episode {key[0]}, step {key[1]}: {verdict.reason}.")
        if verdict.log_odds is not None:
            self._look_for_drift(verdict.log_odds)

    def _look_for_drift(self, log_odds: float) -> None:
        """Warn once, after the verdict is out; verdicts stay as they are."""
        drift = self._watch.hear(log_odds) if self._watch else None
        if drift and drift.is_drift:
            self._peer.note("warning", drift.sentence)
            self._watch = None

    def _measure(self, is_due: bool) -> None:
        """Measure the amplifier's clock now and then; after a silence ask first what it is by now."""
        reception = self._reception
        found = self._changed.take(reception.n_silences)
        if found is not None:
            # A computer that was changed for another of the same name no longer shares the stimulus's clock.
            self._same_clock &= abs(found - self._eeg_offset) < SAME_CLOCK_S
            self._eeg_offset = found
            reception.is_what_it_was()
        elif reception.is_to_be_asked:
            self._changed.begin(reception.n_silences)
        correction = self._correction.take(reception.n_silences)
        if correction is not None:
            self._eeg_offset = correction
        if is_due and reception.is_known:
            self._correction.begin(reception.n_silences)

    def _follow(self, times: NDArray[np.float64]) -> None:
        """Tell how the EEG comes in; moves that wait for samples which won't come, or not where they belong, are
        rejected."""
        now, reception = local_clock(), self._reception
        is_due = now - self._linked_at >= LINK_S
        self._measure(is_due)
        for level, text in reception.take(times, now, self._peer.clock.to_session(now), self._eeg_offset):
            self._peer.note(level, text)
        if reception.moved_s:
            self._buffer.abandon("the EEG's time stamps have moved against the clock")
        elif reception.quiet_s > PATIENCE_S:
            self._buffer.abandon("the EEG stream is silent")
        if is_due:
            self._linked_at = now
            self._peer.push(
                Link(
                    session=self._peer.session,
                    role="decoder",
                    stream=self._eeg.description.name,
                    age_s=reception.quiet_s,
                    rate_hz=reception.rate_hz,
                    gaps=reception.n_gaps,
                    offset_s=self._eeg_offset,
                    reconnects=reception.n_reconnects,
                )
            )
