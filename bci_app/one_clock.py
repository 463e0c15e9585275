"""Messages of processes on several machines, stamped by one clock: a message is stamped by its sender's.

LabRecorder measures every few seconds what is to be added to a stream's stamps to put them on its own clock, which is
bci-app's. Pure.
"""

from dataclasses import replace
from typing import cast

import numpy as np

from bci_app.protocol import (
    SESSION,
    STIMULUS,
    STREAMS,
    Action,
    Belief,
    Command,
    Electrodes,
    Message,
    Recall,
    Role,
    Verdict,
)
from bci_app.recording import Recording, SenderClock, Stamped

APART_S = 0.005
"""Seconds the clocks of two machines of one name are apart at least: two streams of one may seem so by less, as in the
decoder."""


def on_one_clock(recording: Recording) -> tuple[Recording, frozenset[Role]]:
    """The recording with its messages stamped by the recorder's clock, in order; and whose clock it doesn't tell.

    Between two measurements the clocks are taken to drift evenly. The stamps of those whose clock isn't known, for they
    were on another machine and LabRecorder measured nothing, are as they were. So are EEG and markers.
    """
    here = recording.clocks.get(SESSION.name, recording.clocks.get(STIMULUS.name))
    apart: dict[Role, SenderClock] = {}
    unknown: set[Role] = set()
    for spec in STREAMS:
        clock = recording.clocks.get(spec.name)
        if clock is None or here is None:
            continue
        is_elsewhere = clock.hostname != here.hostname
        if clock.offsets and (is_elsewhere or abs(np.median(clock.offsets)) > APART_S):
            apart[spec.role] = clock
        elif is_elsewhere:
            unknown.add(spec.role)
    unknown -= apart.keys()
    if not apart:
        return recording, frozenset(unknown)
    messages = []
    for item in recording.messages:
        theirs = apart.get(sender(item.message))
        shift = 0.0 if theirs is None else float(np.interp(item.stamp, theirs.times, theirs.offsets))
        messages.append(Stamped(item.stamp + shift, item.message))
    placed = tuple(sorted(messages, key=lambda item: item.stamp))
    return replace(recording, messages=placed), frozenset(unknown)


def sender(message: Message) -> Role:
    """Who stamped a message. What was said at the console bci-app has repeated."""
    match message:
        case Verdict() | Electrodes():
            return "decoder"
        case Action() | Belief():
            return "policy"
        case Command() | Recall():
            return "session"
    role = cast(Role, getattr(message, "role", "stimulus"))
    return "session" if role == "console" else role
