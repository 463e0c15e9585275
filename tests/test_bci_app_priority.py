"""The loop's processes go first at real speed, and go on where the system doesn't let them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from lsl_peers import Listener, process, until

from bci_app import priority
from bci_app.gridworld import load_map
from policy import cards

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's scheduler")
LOOP = ["amplifier", "decoder", "policy", "stimulus"]
STREAMS = {"amplifier": "bci-amplifier", "decoder": "bci-verdicts", "policy": "bci-actions", "stimulus": "bci-stimulus"}
BARRED = """
import os, resource
from bci_app import priority
for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
    resource.setrlimit(limit, (0, 0))
os.getuid() or os.setuid(65534)
print(priority.go_first("decoder"), priority.offered())
"""
TOO_LITTLE = """
import os
from bci_app import priority
def up_to_six(who, policy, param):
    if param.sched_priority > 6:
        raise PermissionError("RLIMIT_RTPRIO is 6")
def refuse(*_):
    raise PermissionError("RLIMIT_NICE is 0")
os.sched_setscheduler, os.setpriority = up_to_six, refuse
print(priority.offered(), priority.go_first("policy"), sep=", ")
"""
NO_SUCH_THING = """
import errno, os
from bci_app import priority
def refuse(*_):
    raise OSError(errno.ENOSYS, "no such thing")
os.sched_setscheduler = os.setpriority = refuse
print(priority.go_first("decoder"), priority.offered())
"""


def words(role: str) -> list[object]:
    """What a process of the loop needs to start alone, without a screen."""
    extra: dict[str, list[object]] = {
        "policy": ["--map", "open", "--policy", policy_file()],
        "stimulus": ["--participant", "P1", "--task", "calibration"],
    }
    return [role, *extra.get(role, [])]


def policy_file() -> Path:
    return cards.choose_without(load_map("open")).path


def scheduled(running: subprocess.Popen[str]) -> set[tuple[int, int]]:
    """Scheduler and real-time priority of each thread, LSL's among them."""
    assert running.poll() is None, running.communicate()
    threads = [int(path.name) for path in Path(f"/proc/{running.pid}/task").iterdir()]
    return {(os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority) for thread in threads}


@pytest.mark.skipif(priority.offered() != "real time", reason="this system grants no real-time scheduling")
@pytest.mark.parametrize("role", LOOP)
@pytest.mark.parametrize(
    ("setting", "speed", "is_first"), [("auto", 1, True), ("auto", 2, False), ("high", 2, True), ("normal", 1, False)]
)
def test_who_goes_first(tmp_path: Path, role: str, setting: str, speed: int, is_first: bool) -> None:
    config, session = tmp_path / "lab.toml", f"first-{role}-{setting}-{speed}"
    config.write_text(f'priority = "{setting}"\n[stimulus]\nheadless = true\n', encoding="utf-8")
    with process(*words(role), "--session", session, "--config", config, "--speed", speed) as running:
        listener = Listener(STREAMS[role], session)
        until(lambda: listener.of("Status"), 60, "its first word")
        expected = (os.SCHED_RR, priority.ROUND_ROBIN[role]) if is_first else (os.SCHED_OTHER, 0)
        assert scheduled(running) == {expected}
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # to ask what is offered changed nothing


@pytest.mark.parametrize("circumstances", [BARRED, NO_SUCH_THING])
def test_who_isn_t_granted_it_goes_on(circumstances: str) -> None:
    found = subprocess.run([sys.executable, "-c", circumstances], capture_output=True, text=True, check=True).stdout
    assert found.split() == ["normal", "normal"]
    assert "docs/lab.md" in priority.sentence("normal")


def test_offered_is_what_all_of_them_get() -> None:
    found = subprocess.run([sys.executable, "-c", TOO_LITTLE], capture_output=True, text=True, check=True).stdout
    assert found == "normal, real time\n"


def test_the_console_gives_way() -> None:
    with process("console", "--session", "nobodys", "--port", 0, host=("setsid",)) as running:
        until(lambda: os.getpriority(os.PRIO_PROCESS, running.pid) == priority.LAST, 60, "it to give way")
        group = Path(f"/proc/{running.pid}/autogroup")  # where Linux weighs sessions against each other
        if group.exists():
            until(lambda: group.read_text().split()[-1] == str(priority.LAST), 5, "its session to give way")
