"""One place for defaults; a typo is an error that names the known keys."""

from pathlib import Path

import pytest

from bci_app import config
from bci_app.errors import SetupError


def test_defaults_are_the_papers() -> None:
    defaults = config.load()
    assert (defaults.stimulus.countdown_s, defaults.stimulus.arrow_s, defaults.stimulus.rest_s) == (1, 1, 1)
    assert (defaults.calibration.n_blocks, defaults.calibration.moves_per_block) == (5, 120)
    assert defaults.online.distances == (2, 20)
    assert (defaults.chain.sfreq, defaults.chain.low_hz, defaults.chain.high_hz) == (256, 1, 50)
    assert (defaults.chain.start_ms, defaults.chain.window_ms, defaults.chain.n_windows) == (150, 30, 15)


def test_file_overrides_defaults_and_the_command_line_overrides_the_file(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text('recordings = "elsewhere"\n[calibration]\nn_blocks = 3\nbreak_s = 20\n', encoding="utf-8")
    loaded = config.load(path, {"calibration": {"n_blocks": 2}})
    assert (loaded.recordings, loaded.calibration.n_blocks, loaded.calibration.break_s) == ("elsewhere", 2, 20)
    resolved = tmp_path / "resolved.json"
    resolved.write_text(loaded.model_dump_json(), encoding="utf-8")
    assert config.load(resolved) == loaded


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[stimulus]\ncoutdown_s = 1", "unknown key 'stimulus.coutdown_s'; known: countdown_s"),
        ("[stimulation]\n", "unknown key 'stimulation'; known: recordings"),
        ("[chain]\nsfreq = -1", "'chain.sfreq'"),
        ("[chain]\nn_windows = 1000", "must end within 1500 ms of a move"),
        ("[chain", "not valid TOML"),
    ],
)
def test_a_mistake_is_one_clear_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SetupError) as error:
        config.load(path)
    assert says in str(error.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"absent\.toml"):
        config.load(tmp_path / "absent.toml")


def test_every_setting_says_what_it_is() -> None:
    settings = {name: (value, what) for name, value, what in config.explained(config.load())}
    assert settings["calibration.n_blocks"][0] == "5"
    assert settings["eeg.stream_name"][0] == "null"
    assert [name for name, (_, what) in settings.items() if len(what) < 10] == []
