"""LSL ports for sessions side by side: the usual 32 are soon taken, and a stream beyond them is found by nobody."""

import os
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

FIRST_PORT, N_PORTS, N_RANGES = 17_000, 100, 150
"""Ranges of ports a worker may have, by its process number; two workers of one study never share one, for their numbers
are near each other (decided)."""


@cache
def apart() -> str | None:
    """Give this worker, and all it starts, ports of its own; must be called before liblsl's first call.

    Where the lab has LSL settings of its own, these are kept. Returns the settings' file.
    """
    shipped = files("bci_app") / "lsl_api.cfg"
    if os.environ.get("LSLAPICFG") != str(shipped):
        return None
    base = FIRST_PORT + os.getpid() % N_RANGES * N_PORTS
    text = f"{shipped.read_text(encoding='utf-8')}[ports]\nBasePort = {base}\nPortRange = {N_PORTS}\n"
    path = Path(tempfile.mkdtemp(prefix="bci-app-study-")) / "lsl_api.cfg"
    path.write_text(text, encoding="utf-8")
    os.environ["LSLAPICFG"] = str(path)
    return str(path)
