"""What a session survives, live: a short drill. `bci-app drill --sessions 20` is the long one."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import Cli
from lsl_peers import lab_config, process, until

from bci_app.protocol import MoveOnset
from bci_app.recording import read


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


def test_a_calibration_that_was_interrupted_goes_on_where_it_stopped(cli: Cli, tmp_path: Path) -> None:
    words = ("--participant", "P001", "--simulate", "--speed", 20, "--config", lab_config(tmp_path))
    made = tmp_path / "recordings"
    with process("calibrate", *words) as running:
        until(lambda: any(path.stat().st_size > 4_000_000 for path in made.rglob("*.xdf")), 60, "some moves")
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 130
    resumed = cli("calibrate", *words, "--resume", "--json")
    assert resumed.returncode == 0, resumed.stderr
    runs = sorted(made.rglob("*.xdf"))
    n_moves = [len(read(path).of(MoveOnset)) for path in runs]
    assert len(runs) == 2
    assert n_moves[0] > 0
    # Of the first run's last moves one may have had no verdict yet.
    assert n_moves[1] == json.loads(resumed.stdout)["moves"] < 40 <= sum(n_moves) <= 42
    done = cli("calibrate", *words, "--resume")
    assert done.returncode == 2
    assert "is complete: there is nothing to go on with" in done.stderr
    fitted = cli("fit", *runs, "--config", tmp_path / "lab.toml")
    assert "error epochs; this calibration has" in fitted.stderr
    assert "(of 40)" in fitted.stderr


def test_a_calibration_of_which_no_epoch_is_valid_wastes_nobodys_time(cli: Cli, tmp_path: Path) -> None:
    config = lab_config(tmp_path)
    with config.open("a", encoding="utf-8") as file:
        file.write("[eeg]\nmax_band_uv = 0.001\n")
    done = cli("calibrate", "--participant", "P001", "--simulate", "--speed", 20, "--config", config)
    assert done.returncode == 3
    assert "The last 10 moves gave no valid epoch" in done.stderr


@pytest.mark.trouble("App-LabRecorder #107: a disk that fills, and nobody notices")
def test_a_disk_that_fills_ends_the_run_while_there_is_room_to_close_it(tmp_path: Path) -> None:
    """On a disk of 40 MB, which only this test's processes see."""
    alone = ["unshare", "--map-root-user", "--mount"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this system doesn't let us have a small disk of our own")
    disk, config = tmp_path / "recordings", lab_config(tmp_path)
    disk.mkdir()
    program = f"{sys.executable} -m bci_app"
    words = f"calibrate --participant P001 --simulate --speed 20 --config {config}"
    kept = tmp_path / "kept"
    script = f"""
        mount -t tmpfs -o size=40m tmpfs {disk} || exit 77
        {program} {words} 2> {tmp_path}/said; echo $? > {tmp_path}/code
        {program} replay {disk}/sub-P001/ses-S001/eeg/*_eeg.xdf --json > {tmp_path}/replay.json; cp -r {disk} {kept}
    """
    done = subprocess.run([*alone, "sh", "-c", script], capture_output=True, text=True, timeout=200, check=False)
    if done.returncode == 77:
        pytest.skip("this system doesn't let us have a small disk of our own")
    assert (tmp_path / "code").read_text() == "3\n"
    assert "MB are left on the disk" in (tmp_path / "said").read_text()
    sidecar = json.loads(next(kept.rglob("*_eeg.json")).read_text())
    assert sidecar["state"] == "closed"
    assert "nothing that was heard is missing" in sidecar["verified"]
    replayed = json.loads((tmp_path / "replay.json").read_text())
    assert replayed["replay"]["verdicts"] == replayed["replay"]["verdicts_equal"]
    assert not list(kept.rglob("reserve"))
