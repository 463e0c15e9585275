"""LSL ports for sessions side by side: the usual 32 are soon taken, and a stream beyond them is found by nobody."""

import os
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

SHIPPED = files("bci_app") / "lsl_api.cfg"
FIRST_PORT, N_PORTS, N_RANGES = 17_000, 48, 300
"""Ranges of ports a worker may have, by its process number; two workers of one study never share one, for their numbers
are near each other (decided)."""


def has_own_ports() -> bool:
    """Whether workers get ports of their own: where the lab has no LSL settings."""
    return os.environ.get("LSLAPICFG") == str(SHIPPED)


@cache
def apart() -> str | None:
    """Give this worker, and all it starts, ports of its own; must be called before liblsl's first call.

    Where the lab has LSL settings of its own, these are kept. Returns the settings' file.
    """
    if not has_own_ports():
        return None
    base = FIRST_PORT + os.getpid() % N_RANGES * N_PORTS
    text = f"{SHIPPED.read_text(encoding='utf-8')}[ports]\nBasePort = {base}\nPortRange = {N_PORTS}\n"
    path = Path(tempfile.mkdtemp(prefix="bci-app-study-")) / "lsl_api.cfg"
    path.write_text(text, encoding="utf-8")
    os.environ["LSLAPICFG"] = str(path)
    return str(path)
