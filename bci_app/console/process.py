"""The console's process: a thread listens, the main thread serves pages. It gives way to everybody else."""

import os
import threading
from collections.abc import Callable

from bci_app.config import Config
from bci_app.console.listener import Listener
from bci_app.console.server import serve

NICENESS = 10
"""How far it steps back from the processor, of 19 (decided): where cores are short the loop goes first."""


def run(config: Config, session: str | None, port: int, parent: int | None, tell: Callable[[str], None]) -> None:
    """Show sessions until interrupted; ``tell`` is told the page's address.

    Raises SetupError for a port that is taken and where it isn't clear which session to show, LinkLost when the program
    that started it is gone.
    """
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    listener = Listener(config, session, parent)
    thread = threading.Thread(target=listener.run, name="listener")
    thread.start()
    try:
        serve(listener, port, tell)
    except KeyboardInterrupt:
        if parent is None:  # otherwise it's the parent, which ends
            raise
    finally:
        listener.ended.set()
        thread.join()
    if listener.failure is not None:
        raise listener.failure
