"""The loop's processes go first at real speed, and go on where the system doesn't let them."""

import os
import subprocess
import sys

import pytest
from lsl_peers import Listener, process, until

from bci_app import priority

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's scheduler")
ORDINARY = "import os; from bci_app import priority; os.getuid() or os.setuid(65534); print(priority.go_first())"


def policy_of(running: subprocess.Popen[str]) -> int:
    assert running.poll() is None, running.communicate()
    return os.sched_getscheduler(running.pid)


@pytest.mark.skipif(priority.offered() != "real time", reason="this system grants no real-time scheduling")
@pytest.mark.parametrize("role", ["decoder", "amplifier"])
def test_at_real_speed_a_process_goes_first(role: str) -> None:
    with process(role, "--session", f"first-{role}") as running:
        until(lambda: policy_of(running) == os.SCHED_RR, 20, "real-time scheduling")
        assert os.sched_getparam(running.pid).sched_priority == priority.ROUND_ROBIN
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # to ask what is offered changed nothing


def test_in_a_simulation_at_another_speed_it_goes_with_all_others() -> None:
    with process("decoder", "--session", "equal", "--speed", 20) as running:
        listener = Listener("bci-verdicts", "equal")
        until(lambda: listener.of("Status"), 20, "the decoder's first word")
        assert policy_of(running) == os.SCHED_OTHER


def test_who_isn_t_allowed_to_goes_on_and_is_told_what_to_do() -> None:
    found = subprocess.run([sys.executable, "-c", ORDINARY], capture_output=True, text=True, check=True).stdout.strip()
    assert found == ("normal" if os.getuid() == 0 else priority.offered())
    assert "docs/lab.md" in priority.sentence("normal")
