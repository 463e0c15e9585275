"""The console finds sessions by itself, follows one after the other, and asks for what it missed."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from lsl_peers import ForeignStimulus, Listener, until

from bci_app.config import Config
from bci_app.console.listener import Listener as Console
from bci_app.lsl import MessageOutlet, local_clock, session_clock
from bci_app.protocol import CONSOLE, SESSION, EpisodeStart, Note, Recall, Said, SessionStart, Status


@contextmanager
def listening(session: str | None = None) -> Iterator[Console]:
    console = Console(Config(), session)
    thread = threading.Thread(target=console.run)
    thread.start()
    try:
        yield console
    finally:
        console.ended.set()
        thread.join(30)
        assert not thread.is_alive()


def shown(console: Console, section: str) -> Any:
    return console.snapshot().get(section)


def test_it_finds_the_session_that_runs_and_asks_which_of_several() -> None:
    """It comes in the middle of a run at twice real speed, and is told how far that is."""
    stimulus = ForeignStimulus("first")
    leader = MessageOutlet(SESSION, "first", session_clock(2.0, 5.0))
    with listening() as console:
        until(lambda: shown(console, "session").get("id") == "first", 60, "the session")
        asks = Listener("bci-console", "first")
        running = Status(session="first", role="session", state="running")
        leader.push(running, 1.0)

        def say_so() -> None:
            """Twenty times a second: who floods a listener keeps it from ever speaking."""
            leader.push(running, 1.0)
            console.ended.wait(0.05)

        until(lambda: asks.of("Returned"), 60, "to be asked", say_so)
        opening = SessionStart(session="first", task="online", participant="P", map="open", layout=["..", ".."])
        start = EpisodeStart(session="first", episode=3, position=(0, 1), sensed=(False,) * 5, max_steps=60)
        said = (Said(stamp=1.0, message=opening), Said(stamp=2.0, message=start))
        leader.push(Recall(session="first", role="console", said=said), 3.0)
        until(lambda: shown(console, "episode"), 60, "the episode")
        assert shown(console, "session")["speed"] == 2.0
        assert shown(console, "session")["is_late"]
        console.ask(lambda session: Note(session=session, role="console", level="info", text="hello"))
        until(lambda: asks.of("Note"), 60, "the note")
        stimulus.say("SessionEnd", local_clock(), reason="complete")
        following = ForeignStimulus("second")
        until(lambda: shown(console, "session")["id"] == "second", 60, "the next session")
        with listening() as other:
            until(other.ended.is_set, 60, "it to say that there are two")
        assert "2 sessions are running: first, second" in str(other.failure)
        with listening("second") as named:
            until(named.ended.is_set, 60, "it to say that there is a console")
        assert "has a console already" in str(named.failure)
        following.say("SessionEnd", reason="complete")
    assert console.failure is None


def test_a_second_console_is_refused() -> None:
    stimulus = ForeignStimulus("mine")
    theirs = MessageOutlet(CONSOLE, "mine")
    with listening("mine") as console:
        until(console.ended.is_set, 60, "it to say that there is a console")
    assert "has a console already" in str(console.failure)
    del theirs, stimulus


def test_of_two_consoles_started_at_once_one_stays() -> None:
    stimulus = ForeignStimulus("mine")
    with listening("mine") as one, listening("mine") as two:
        until(lambda: one.ended.is_set() or two.ended.is_set(), 60, "one of them to give way")
        given_way, stays = (one, two) if one.ended.is_set() else (two, one)
        assert "has a console already" in str(given_way.failure)
        until(lambda: shown(stays, "session").get("id") == "mine", 60, "the session")
        assert not stays.ended.is_set()
    assert stays.failure is None
    del stimulus


def test_nobody_is_asked_where_nobody_follows() -> None:
    console = Console(Config())
    assert shown(console, "session")["phase"] == "looking"
    from bci_app.errors import SetupError

    with pytest.raises(SetupError, match="nobody would follow"):
        console.ask(lambda session: Note(session=session, role="console", level="info", text="hello"))
    with pytest.raises(KeyError):
        console.average("Fz")
