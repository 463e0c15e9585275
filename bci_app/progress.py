"""How long work tells how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with (what is going on, how much of it is done, how much there is)."""


def named(progress: Progress, stage: str) -> Progress:
    """The same progress, each word of it after the stage's name."""

    def report(what: str, done: int, total: int) -> None:
        progress(f"{stage}: {what}", done, total)

    return report
