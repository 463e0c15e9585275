"""Asks the system to let this process go before others: a browser that draws must not delay a verdict.

In real-time scheduling a process that wakes up runs at once, instead of when the one before has used up its turn. The
loop's processes sleep nearly all the time, so that nobody misses them.
"""

import os
import sys
import threading
from typing import Literal

Rank = Literal["real time", "high", "normal"]

ROUND_ROBIN = 5
"""Real-time priority, of 99 (decided: before all ordinary processes, after the drivers' and the sound's)."""
NICENESS = -10
"""Where real-time scheduling isn't to be had (decided)."""


def go_first() -> Rank:
    """Put the calling thread, and the threads it starts from now on, before others; the rank that the system granted.

    On Windows it is the whole process. Nothing is raised where the system refuses: the loop runs all the same.
    """
    if sys.platform == "win32":
        import psutil

        psutil.Process().nice(psutil.HIGH_PRIORITY_CLASS)
        return "high"
    try:
        if sys.platform == "linux":
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(ROUND_ROBIN))
            return "real time"
    except PermissionError:
        pass  # niceness may be allowed all the same
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    except PermissionError:
        return "normal"
    return "high"


def offered() -> Rank:
    """The rank that `go_first` would get, for a thread that ends at once; on macOS, where the process has one niceness,
    what it has."""
    if sys.platform == "win32":
        return "high"
    if sys.platform != "linux":
        return "high" if os.geteuid() == 0 else "normal"
    found: list[Rank] = []
    thread = threading.Thread(target=lambda: found.append(go_first()))
    thread.start()
    thread.join()
    return found[0]


def sentence(rank: Rank) -> str:
    """What the rank means, and what to do for a better one."""
    if rank == "real time":
        return "the loop's processes go before all others, in real-time scheduling"
    if rank == "high":
        return "the loop's processes go before others"
    return (
        "the system doesn't let the loop's processes go first: close what else draws or computes during a session, or "
        "allow it as docs/lab.md says"
    )
