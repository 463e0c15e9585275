"""A calibration rehearsed over real LSL: recorded, learnt, calibrated again, compared, online, replayed."""

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import Cli

from bci_app.recording import read

CONFIG = """
recordings = "{folder}"
[stimulus]
headless = true
[calibration]
n_blocks = 2
moves_per_block = 40
break_s = 3
[online]
distances = [2, 3]
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rehearsal")
    path = folder / "small.toml"
    path.write_text(CONFIG.format(folder=(folder / "recordings").as_posix()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recording(config: Path, cli: Cli) -> Path:
    words = ["--participant", "P007", "--simulate", "--speed", 20, "--decodability", 0.9, "--seed", 5]
    return Path(printed(cli, "calibrate", *words, "--config", config)["recording"])


def printed(cli: Cli, *words: object) -> dict[str, Any]:
    done = cli(*words, "--json")
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def test_a_recorded_person_is_calibrated_again(config: Path, recording: Path, cli: Cli) -> None:
    told = printed(
        cli, "rehearse", "--from", recording, "--config", config, "--seed", 6, "--map", "open", "--speed", 20
    )
    assert told["original"]["n_valid"] == told["rehearsal"]["n_valid"] == 80
    assert told["agrees"]
    assert told["difference"]["low"] <= 0 <= told["difference"]["high"]
    assert Path(told["person"]).name == "sub-P007REHEARSAL_ses-S001_person.safetensors"
    assert told["online"]["n_episodes"] == 2
    mine, original = read(Path(told["recording"])), read(recording)
    assert (mine.eeg.channels, mine.eeg.sfreq) == (original.eeg.channels, original.eeg.sfreq)
    for path in (told["recording"], told["online_recording"]):
        counts = printed(cli, "replay", path)["replay"]
        assert counts["verdicts"] == counts["verdicts_equal"] > 0


def test_what_cant_be_rehearsed_is_refused(config: Path, recording: Path, cli: Cli, tmp_path: Path) -> None:
    def refused(*words: object) -> str:
        done = cli("rehearse", *words)
        assert done.returncode == 2, done.stderr
        assert "Traceback" not in done.stderr
        return done.stderr

    longer = tmp_path / "longer.toml"
    longer.write_text(config.read_text(encoding="utf-8").replace("= 40", "= 50"), encoding="utf-8")
    assert "has 80 moves, and a rehearsal of 2 blocks x 50" in refused("--from", recording, "--config", longer)
    cut = tmp_path / recording.name
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    assert "cut off before it was closed" in refused("--from", cut, "--config", config)
    assert "absent.xdf" in refused("--from", "absent.xdf", "--config", config)
    assert "letters and digits" in refused("--from", recording, "--config", config, "--participant", "../P")
    assert not list(config.parent.glob("recordings/sub-*REHEARSAL/ses-S002"))


def test_a_person_that_isnt_there_is_said_to_be_missing(config: Path, cli: Cli) -> None:
    words = ["--participant", "P1", "--simulate", "--rehearse", "absent.safetensors", "--config", config]
    done = cli("calibrate", *words)
    assert done.returncode == 2, done.stderr
    assert "absent.safetensors" in done.stderr
