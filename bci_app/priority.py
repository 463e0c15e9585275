"""Asks the system to let this process go before others, or after them: a browser that draws must not delay a verdict.

In real-time scheduling a process that wakes up runs at once, instead of when the one before has used up its turn. The
loop's processes, once they are loaded, sleep nearly all the time, so that nobody misses them.
"""

import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Literal

Setting = Literal["auto", "high", "normal"]
Rank = Literal["real time", "high", "normal"]

ROUND_ROBIN = {"stimulus": 8, "decoder": 7, "policy": 6, "amplifier": 5}
"""Real-time priorities, of 99 (decided: before all ordinary processes, after the drivers' and the sound's; a jump
before a verdict, a verdict before a choice, and all before the simulated amplifier, which computes most)."""
FIRST, LAST = -10, 10
"""Niceness of whoever goes first and isn't granted real-time scheduling, and of whoever gives way (decided)."""


def is_wished(setting: Setting, speed: float) -> bool:
    """Whether the loop's processes go first by the configuration's `priority`, in a session of this speed."""
    return setting == "high" or (setting == "auto" and speed == 1.0)


def go_first(role: str) -> Rank:
    """Put the calling thread, and the threads it starts from now on, before others; the rank that the system granted.

    On Windows it is the whole process. Nothing is raised where the system refuses or knows no such thing: the loop runs
    all the same.
    """
    rank = _granted(ROUND_ROBIN[role])
    if rank == "high":
        _among_groups(FIRST)
    return rank


def give_way() -> None:
    """Let this process go after all others."""
    if sys.platform == "win32":
        import psutil

        _on_windows(psutil.BELOW_NORMAL_PRIORITY_CLASS)
        return
    os.nice(LAST)
    _among_groups(LAST)


def offered() -> Rank:
    """The rank that `go_first` would get for every process of the loop.

    On Linux it is tried in a thread that ends at once. Elsewhere priority is the whole process's, so it is told from
    the rights: Windows grants it to everybody, others to root.
    """
    if sys.platform == "win32":
        return "high"
    if sys.platform != "linux":
        return "high" if os.geteuid() == 0 else "normal"
    found: list[Rank] = []
    thread = threading.Thread(target=lambda: found.append(_granted(max(ROUND_ROBIN.values()))))
    thread.start()
    thread.join()
    return found[0]


def expected(setting: Setting, speed: float) -> Rank:
    """The rank of the loop's processes that are started on this computer."""
    return offered() if is_wished(setting, speed) else "normal"


def outlook(setting: Setting) -> str:
    """What a session with people may expect of this computer."""
    if not is_wished(setting, speed=1.0):
        return "the loop's processes go with all others (priority = normal)"
    return sentence(offered())


def sentence(rank: Rank) -> str:
    """What the rank means, and what to do for a better one."""
    if rank == "real time":
        return "the loop's processes go before all others, in real-time scheduling"
    if rank == "high" and sys.platform == "linux":
        return "the loop's processes go before others, but real-time scheduling isn't granted: docs/lab.md says how"
    if rank == "high":
        return "the loop's processes go before others"
    return (
        "the system doesn't let the loop's processes go first: close what else draws or computes during a session, or "
        "allow it as docs/lab.md says"
    )


def _granted(real_time: int) -> Rank:
    """What the calling thread gets, on Windows the process, without what concerns the session."""
    if sys.platform == "win32":
        import psutil

        return _on_windows(psutil.HIGH_PRIORITY_CLASS)
    try:
        if sys.platform == "linux":
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(real_time))
            return "real time"
    except OSError:
        pass  # niceness may be allowed all the same
    try:
        os.setpriority(os.PRIO_PROCESS, 0, FIRST)
    except OSError:
        return "normal"
    return "high"


def _among_groups(niceness: int) -> None:
    """Linux may weigh sessions against each other first, and niceness only within one: then the session's counts too.

    Only for a process that leads its session, as all do that bci-app starts: not for everything in somebody's terminal.
    """
    group = Path("/proc/self/autogroup")
    if not group.exists() or os.getsid(0) != os.getpid():
        return
    with suppress(OSError):  # not this process's to say, or said a moment ago: its niceness remains
        group.write_text(str(niceness), encoding="ascii")


def _on_windows(wanted: int) -> Rank:
    """Ask for a priority class; the rank there is then, for a job the process belongs to may forbid it."""
    import psutil

    this = psutil.Process()
    try:
        this.nice(wanted)
        return "high" if this.nice() == wanted else "normal"
    except (OSError, psutil.Error):
        return "normal"
