"""Names of files, and that nothing is ever overwritten."""

from pathlib import Path

import pytest

from bci_app import runs
from bci_app.errors import SetupError


def test_the_name_is_labrecorders_own_template(tmp_path: Path) -> None:
    run = runs.new_run(tmp_path, "P001", "S001", "online")
    expected = tmp_path / "sub-P001" / "ses-S001" / "eeg" / "sub-P001_ses-S001_task-online_run-001_eeg.xdf"
    assert run.xdf == expected
    assert run.sidecar == expected.with_suffix(".json")


def test_a_run_whose_files_exist_is_never_given_again(tmp_path: Path) -> None:
    numbers = [runs.new_run(tmp_path, "P001", "S001", "online").number for _ in range(3)]
    (tmp_path / "sub-P001/ses-S001/eeg/sub-P001_ses-S001_task-online_run-004_eeg.xdf").write_bytes(b"precious")
    assert [*numbers, runs.new_run(tmp_path, "P001", "S001", "online").number] == [1, 2, 3, 5]
    assert runs.new_run(tmp_path, "P001", "S001", "calibration").number == 1


@pytest.mark.parametrize("label", ["../x", "a/b", "", "P 1", "P_1", "C:\\x", ".."])
def test_a_participant_is_never_a_path(tmp_path: Path, label: str) -> None:
    with pytest.raises(SetupError, match="letters and digits"):
        runs.new_run(tmp_path, label, "S001", "online")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder", encoding="utf-8")
    with pytest.raises(SetupError, match="Can't write recordings below"):
        runs.new_run(blocked, "P001", "S001", "online")


def test_a_sidecar_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "x_eeg.xdf"
    runs.write_sidecar(runs.sidecar_of(path), {"state": "recording"})
    runs.write_sidecar(runs.sidecar_of(path), {"state": "closed"})
    assert runs.read_sidecar(path) == {"state": "closed"}
    assert [file.name for file in tmp_path.iterdir()] == ["x_eeg.json"]


def test_names_that_differ_only_in_case_are_one_folder_elsewhere_and_refused(tmp_path: Path) -> None:
    runs.new_run(tmp_path, "P001", "S001", "calibration")
    for participant, visit, found in (("p001", "S001", "sub-P001"), ("P001", "s001", "ses-S001")):
        with pytest.raises(SetupError, match=f"{found} is there already, and .* only in upper and lower case"):
            runs.new_run(tmp_path, participant, visit, "calibration")
    assert [path.name for path in tmp_path.iterdir()] == ["sub-P001"]
    runs.new_run(tmp_path, "P0010", "S001", "calibration")


def test_a_folder_is_tried_before_the_work(tmp_path: Path) -> None:
    assert not runs.why_not_writable(tmp_path)
    assert not list(tmp_path.iterdir())
    assert runs.why_not_writable(tmp_path / "absent")
