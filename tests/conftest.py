"""Tests isolate themselves on LSL: machine scope, a session id and ports of their own, this computer asked directly."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

# Ports of our own: once LSL's usual 32 are taken, by other sessions on this machine, a stream gets one nobody asks at.
_LSL = f"""
[ports]
BasePort = {20000 + os.getpid() % 100 * 100}
PortRange = 100
[lab]
SessionID = errp-bci-tests-{os.getpid()}
KnownPeers = {{127.0.0.1}}
[multicast]
ResolveScope = machine
[tuning]
MulticastMinRTT = 0.02
MulticastMaxRTT = 0.1
[log]
level = -2
"""
_folder = tempfile.TemporaryDirectory()
_file = Path(_folder.name) / "lsl_api.cfg"
_file.write_text(_LSL, encoding="utf-8")
os.environ["LSLAPICFG"] = str(_file)  # before liblsl's first call, and inherited by every process a test starts
os.environ["SDL_VIDEODRIVER"] = "dummy"
# A shell starts what it runs in the background with Ctrl-C ignored, and every process a test starts would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

import bci_app.threads  # noqa: E402, F401

DATA = Path(os.environ.get("BCI_APP_DATA", Path(__file__).parents[2] / "shared" / "data"))
Cli = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of real recordings; the test skips where it is absent."""
    if not DATA.exists():
        pytest.skip(f"real recordings are not at {DATA} (set BCI_APP_DATA)")
    return DATA


@pytest.fixture(scope="session")
def cli() -> Cli:
    """Run `bci-app` as a user does; returns the finished process."""

    def run(*words: object, timeout: float = 200.0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "bci_app", *map(str, words)],
            capture_output=True,
            text=True,
            timeout=timeout,
            cwd=cwd,
            check=False,
        )

    return run


@pytest.fixture(scope="session")
def any_decoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A decoder for the foreign amplifier, fitted on noise: it answers, and its answers mean nothing."""
    import numpy as np
    from lsl_peers import LABELS

    from bci_app.config import Config
    from decoder import calibration, model
    from decoder.chain import design

    rng = np.random.default_rng(0)
    chain, settings = design(Config().chain, 250.0), Config().classifier
    error = np.arange(80) % 2 == 0
    fitted = calibration.calibrate(rng.normal(0, 3, (80, len(LABELS) * 15)), error, settings)
    made = model.make_model(fitted, error, chain, settings, participant="NOISE", channels=LABELS, n_rejected=0)
    path = tmp_path_factory.mktemp("model") / "noise_decoder.safetensors"
    model.save(made, path)
    return path
