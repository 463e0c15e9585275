"""The console's process: a thread listens, the main thread serves pages. It gives way to everybody else."""

import threading
from collections.abc import Callable

from bci_app import priority
from bci_app.config import Config
from bci_app.console.listener import Listener
from bci_app.console.server import serve


def run(config: Config, session: str | None, port: int, parent: int | None, tell: Callable[[str], None]) -> None:
    """Show sessions until interrupted; ``tell`` is told the page's address.

    Raises SetupError for a port that is taken and where it isn't clear which session to show, LinkLost when the program
    that started it is gone.
    """
    priority.give_way()
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
