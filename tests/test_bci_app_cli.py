"""A user's mistakes: one clear sentence, exit code 2, no traceback, nothing written over."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from conftest import Cli

from bci_app.gridworld import load_map
from policy.cards import choose_told


def refused(cli: Cli, *words: object) -> str:
    done = cli(*words)
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("calibrate", "--participant", "../P1", "--simulate"), "letters and digits"),
        (("calibrate", "--participant", "P1", "--speed", 5), "needs --simulate"),
        (("calibrate", "--participant", "P1", "--simulate", "--speed", "nan"), "--speed"),
        (("calibrate", "--participant", "P1", "--simulate", "--decodability", 2), "simulation.decodability"),
        (("calibrate", "--participant", "P1", "--simulate", "--remote", "decoder"), "needs --session"),
        (("calibrate", "--participant", "P1", "--simulate", "--config", "absent.toml"), "absent.toml"),
        (("online", "--participant", "P1", "--map", "nowhere", "--simulate"), "open, obstacles"),
        (("online", "--participant", "NOBODY", "--map", "open", "--simulate"), "No decoder of participant NOBODY"),
        (("fit", "absent.xdf"), "absent.xdf"),
        (("replay", "absent.xdf"), "absent.xdf"),
        (("decoder", "--session", "s", "--model", "absent.safetensors"), "absent.safetensors"),
        (("stimulus", "--session", "s", "--participant", "P1", "--task", "gaming"), "calibration or online"),
    ],
)
def test_a_mistake_is_one_sentence(cli: Cli, words: tuple[object, ...], says: str) -> None:
    assert says in refused(cli, *words)


def test_a_map_with_unreachable_cells_is_refused(cli: Cli, tmp_path: Path) -> None:
    bad = tmp_path / "walled.txt"
    bad.write_text("..#..\n..#..\n", encoding="ascii")
    assert "cut off" in refused(cli, "online", "--participant", "P1", "--map", bad, "--simulate")


def test_a_policy_for_another_map_is_refused(cli: Cli) -> None:
    other = choose_told(load_map("obstacles")).path
    said = refused(cli, "policy", "--session", "s", "--map", "open", "--policy", other)
    assert "trained on map 'obstacles'" in said


def test_a_recordings_folder_that_cannot_be_made_is_named(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    config = tmp_path / "c.toml"
    config.write_text(f'recordings = "{(tmp_path / "taken").as_posix()}"\n', encoding="utf-8")
    said = refused(cli, "calibrate", "--participant", "P1", "--simulate", "--headless", "--config", config)
    assert "Can't write recordings below" in said
    assert (tmp_path / "taken").read_text(encoding="utf-8") == "a file"


def test_help_and_configuration_need_nothing(cli: Cli) -> None:
    assert "calibrate" in cli("--help").stdout
    assert '"n_blocks": 5' in cli("config").stdout
    assert "calibration.n_blocks" in cli("config", "--explain").stdout
    assert cli("--version").stdout.startswith("bci-app 0.")


@pytest.mark.parametrize("modules", ["stimulus.process", "bci_app.session, bci_app.verbs, policy.cards, decoder.model"])
def test_who_shows_and_who_conducts_wait_for_no_torch(modules: str) -> None:
    """It takes seconds to load."""
    code = f"import sys, {modules}; sys.exit('torch' in sys.modules or 'sklearn' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_ctrl_c_while_it_is_still_loading_is_no_traceback() -> None:
    script = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    module, function = script["project"]["scripts"]["bci-app"].split(":")
    code = f"""
import signal, sys

class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == "bci_app.cli":
            signal.raise_signal(signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Pressed())
from {module} import {function}
{function}()
"""
    done = subprocess.run([sys.executable, "-c", code, "fit"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Interrupted.\n")
