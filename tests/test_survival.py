"""What a session survives, live: a short drill. `bci-app drill --sessions 20` is the long one."""

import json

import pytest
from conftest import Cli


@pytest.mark.timeout(400)
@pytest.mark.trouble("Dareplane, BciPy: a process that dies ends the session, or nobody notices")
def test_processes_that_are_killed_cost_nothing_and_a_lost_recorder_ends_the_run(cli: Cli) -> None:
    faults = ("stimulus killed", "decoder killed", "recorder killed")
    words = [word for fault in faults for word in ("--fault", fault)]
    done = cli("drill", *words, "--seed", 3, "--json", timeout=380)
    rows = {row["fault"]: row for row in json.loads(done.stdout)}
    assert done.returncode == 0, rows
    assert tuple(rows) == faults
    for fault, row in rows.items():
        assert row["survived"] == row["sessions"] == 1, row
        assert row["moves_lost"] == row["wrong_actions"] == 0, row
        assert row["texts"] == []
        if fault.endswith("killed") and fault != "recorder killed":
            assert row["recovery_p50_s"] > 0, row


def test_a_fault_that_isnt_drilled_is_refused(cli: Cli) -> None:
    done = cli("drill", "--fault", "coffee on the keyboard")
    assert done.returncode == 2
    assert "policy killed" in done.stderr
