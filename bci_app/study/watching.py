"""Tells how far a study's participants are, from what their workers keep: a part is minutes, a participant is many."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bci_app.errors import SetupError
from bci_app.progress import Progress
from bci_app.study.conduct import names_of
from bci_app.study.parts import Kept
from bci_app.study.plan import Participant, Study, Through

LOOK_EVERY_S = 1.0
"""Real seconds between two looks at the files (decided)."""


@contextmanager
def told(study: Study, through: Through, people: Sequence[Participant], progress: Progress) -> Iterator[None]:
    """While the block runs, tell which share of what was left of these participants is done.

    Of workers whose folder isn't this one a participant's parts are told all at once, when they are kept here.
    """
    before = {who.name: _left(study, through, who) for who in people}
    total = sum(map(len, before.values()))
    ended = threading.Event()

    def look() -> None:
        left = [len(before[who.name] & _left(study, through, who)) for who in people]
        n = left.count(0)
        progress(f"calibrations and runs, {n} of {len(people)} participants through", total - sum(left), total)

    def watch() -> None:
        while not ended.wait(LOOK_EVERY_S):
            look()

    watching = threading.Thread(target=watch, name="progress")
    if people:
        watching.start()
    try:
        yield
    finally:
        ended.set()
        if people:
            watching.join()
            look()


def _left(study: Study, through: Through, who: Participant) -> set[str]:
    """The parts that aren't done; all where what is kept can't be read, for who conducts this one says so."""
    try:
        done = Kept.of(study, who, through).parts
    except SetupError:
        done = {}
    return set(names_of(study, who)) - set(done)
