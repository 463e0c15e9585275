"""What bci-app does when a process dies or falls silent, with real processes, streams and an empty recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from lsl_peers import Listener, until
from test_bci_app_said import opening

from bci_app.attention import Attention
from bci_app.crew import Crew
from bci_app.errors import LinkLost
from bci_app.heard import Heard
from bci_app.lsl import Received, local_clock, session_clock
from bci_app.peer import Peer
from bci_app.protocol import SESSION, STREAMS, AnyMessage, Pause, Role, Status
from bci_app.supervisor import EEG_PAUSE_S, Recorded, Supervisor
from bci_app.wellness import HANGS_S
from bci_app.xdf import Follower

ROLES: tuple[Role, ...] = ("decoder", "policy", "stimulus")
EEG, SFREQ = "amp", 100.0


class Run:
    """A run as its supervisor sees it."""

    def __init__(self, folder: Path, session: str, remote: frozenset[Role] = frozenset(), speed: float = 1.0) -> None:
        self.real_s = 0.0
        self.peer = Peer(SESSION, "session", session, session_clock(speed))
        self.crew, self.heard = Crew(folder), Heard(ROLES)
        self.follower, self.attention = Follower(folder / "none.xdf"), Attention(lambda: self.real_s)
        self.supervisor = Supervisor(
            ROLES,
            remote,
            lambda role: ["--help"],
            self.peer,
            self.crew,
            self.heard,
            self.follower,
            self.attention,
        )

    def say(self, role: Role, message: AnyMessage) -> None:
        self.supervisor.take(role, Received(message, self.peer.clock.now(), local_clock()))
        self.heard.take(message)

    def all_well(self) -> None:
        for role in ROLES:
            self.say(role, self.ready(role))

    def ready(self, role: Role) -> Status:
        """The word of one who is ready and hears all others."""
        now = self.peer.clock.now()
        hears = {spec.name: now for spec in STREAMS if spec.role in ROLES and spec.role != role}
        return Status(session=self.peer.session, role=role, state="ready", hears=hears)

    def pass_s(self, seconds: float, has_eeg: bool = True) -> None:
        """Time passes, in which the supervisor listens and EEG comes into the recording."""
        ends = self.real_s + seconds
        while self.real_s < ends:
            self.real_s += 0.5
            self.attention.now()
            self.follower.n_samples[EEG] += round(50 * self.peer.clock.speed) if has_eeg else 0


@contextmanager
def running(folder: Path, session: str, remote: frozenset[Role] = frozenset(), speed: float = 1.0) -> Iterator[Run]:
    run = Run(folder, session, remote, speed)
    try:
        yield run
    finally:
        run.crew.end()
        run.peer.close()


def test_a_process_that_dies_three_times_within_a_minute_is_not_started_a_fourth_time(tmp_path: Path) -> None:
    with running(tmp_path, "thrice") as run:
        run.crew.start("policy", ["--help"])
        for _ in range(2):
            run.crew.kill("policy")
            run.supervisor.mend()
            assert run.crew.ended() == set()
        run.crew.kill("policy")
        with pytest.raises(LinkLost, match=r"killed by signal 9.*That was failure 3 within 60 s; no more are mended"):
            run.supervisor.mend()
    assert [note.count("It is started again.") for note in run.heard.notes] == [1, 1]


def test_the_run_begins_some_time_after_the_last_was_started_again(tmp_path: Path) -> None:
    with running(tmp_path, "settles") as run:
        run.all_well()
        assert run.supervisor.may_begin
        run.crew.start("decoder", ["--help"])
        run.crew.kill("decoder")
        run.supervisor.mend()
        assert not run.supervisor.may_begin
        run.all_well()
        assert not run.supervisor.may_begin
        run.pass_s(10)
        assert run.supervisor.may_begin


def test_the_stimulus_is_told_to_wait_and_to_go_on(tmp_path: Path) -> None:
    with running(tmp_path, "waits") as run:
        told = Listener("bci-session", "waits")
        run.all_well()
        run.say("stimulus", opening())
        run.supervisor.tend()
        assert run.supervisor.waits_for is None
        run.say("decoder", Status(session="waits", role="decoder", state="waiting", text="for EEG"))
        run.pass_s(1)
        run.supervisor.tend()
        assert run.supervisor.waits_for == "The decoder waits for EEG."
        until(lambda: told.of("Command"), 30, "the command")
        assert told.of("Command")[-1]["command"] == "pause"
        run.say("stimulus", Pause(session="waits", reason="The decoder waits for EEG."))
        run.all_well()
        run.pass_s(1)
        run.supervisor.tend()
        assert run.supervisor.waits_for is None
        until(lambda: told.of("Command")[-1]["command"] == "resume", 30, "the command")


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_the_stimulus_waits_until_the_recorder_too_has_had_the_eeg_again_for_long_enough(
    tmp_path: Path, speed: float
) -> None:
    """From when the first samples of its first batch were acquired, not from when they came into the file."""
    with running(tmp_path, "lead", speed=speed) as run:
        run.supervisor.eeg = Recorded(EEG, SFREQ, "", 1.25 * speed)
        run.all_well()
        run.say("stimulus", opening())
        run.pass_s(2)
        run.supervisor.tend()
        assert run.supervisor.waits_for is None
        run.pass_s(EEG_PAUSE_S + 0.5, has_eeg=False)
        run.all_well()
        run.supervisor.tend()
        assert run.supervisor.waits_for == "The recorder doesn't hear the EEG yet."
        waits = []
        for _ in range(3):
            run.pass_s(0.5)
            run.all_well()
            run.supervisor.tend()
            waits.append(run.supervisor.waits_for is not None)
        assert waits == [True, True, False]


def test_a_person_who_paused_goes_on_by_themselves(tmp_path: Path) -> None:
    with running(tmp_path, "person") as run:
        told = Listener("bci-session", "person")
        run.all_well()
        run.say("stimulus", opening())
        run.say("stimulus", Pause(session="person", reason="a break", by_person=True))
        run.pass_s(1)
        run.supervisor.tend()
        run.peer.note("info", "and nothing else")
        until(lambda: told.of("Note"), 30, "the note")
        assert told.of("Command") == []


def test_one_on_another_computer_that_falls_silent_ends_the_run(tmp_path: Path) -> None:
    """It can't be started again from here, and the stamps of two computers can't be compared."""
    with running(tmp_path, "remote", frozenset({"policy"})) as run:
        run.all_well()
        run.say("stimulus", opening())
        run.pass_s(HANGS_S + 1)
        for role in ROLES:
            if role != "policy":
                run.say(role, run.ready(role))
        with pytest.raises(LinkLost, match="No word from the policy process for 5 s: it hangs or is cut off"):
            run.supervisor.tend()
