"""Which streams are there, does the EEG fit, what is missing: a first look before a participant comes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bci_app.config import Config
from bci_app.errors import LinkLost, SetupError
from bci_app.lsl import EegInlet, all_streams, find_eeg, local_clock

LOOK_S = 10.0
"""Real seconds of EEG that are looked at: as many as before an episode."""


def examine(config: Config, model_path: Path | None) -> dict[str, Any]:
    """``streams`` on the network, ``checks`` (what, ok, text), and ``fit``: whether all checks passed."""
    streams = all_streams()
    checks = [_check("streams on the network", bool(streams), f"{len(streams)} found")]
    try:
        info = find_eeg(config.eeg, timeout=2.0)
        inlet = EegInlet(info, config.eeg.buffer_s)
        description = inlet.description
        text = f"'{description.name}', {len(description.picks)} EEG channels at {description.sfreq:g} Hz"
        samples, times = _listen(inlet)
        checks += [_check("EEG stream with labels and units", True, text), _rate(inlet, config, times)]
        checks.append(_electrodes(inlet, samples, times, config))
        if model_path:
            checks.append(_fits(model_path, inlet))
    except (SetupError, LinkLost) as error:
        checks.append(_check("EEG stream with labels and units", False, str(error)))
    return {"streams": streams, "checks": checks, "fit": all(check["ok"] for check in checks)}


def _listen(inlet: EegInlet) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Samples (n_times, n_channels), uV, of `LOOK_S` from now, and their stamps."""
    parts, started = [], local_clock()
    while local_clock() - started < LOOK_S:
        parts.append(inlet.pull(0.1))
    samples, times = zip(*parts, strict=True)
    return np.concatenate(samples), np.concatenate(times)


def _rate(inlet: EegInlet, config: Config, times: NDArray[np.float64]) -> dict[str, Any]:
    from decoder.timeline import check_rate

    description = inlet.description
    try:
        rate = check_rate(times, description.sfreq, description.name, config.eeg.rate_tolerance)
    except SetupError as error:
        return _check("samples at the nominal rate", False, str(error))
    return _check("samples at the nominal rate", True, f"{rate:.2f} Hz over {LOOK_S:g} s")


def _electrodes(
    inlet: EegInlet, samples: NDArray[np.float32], times: NDArray[np.float64], config: Config
) -> dict[str, Any]:
    """The bad ones are repaired in a run, unless they are too many; better mend them now."""
    from decoder.electrodes import Examiner
    from decoder.judge import judge_without

    description, what = inlet.description, "electrodes"
    try:
        judge = judge_without(config, description, "")
        found = Examiner("", description.picked, description.sfreq).examine((0, 0), samples, times, since=-np.inf)
    except SetupError as error:
        return _check(what, False, str(error))
    if not found.n_samples:
        return _check(what, False, f"too little EEG in {LOOK_S:g} s to tell")
    if not found.bad:
        return _check(what, True, f"all {len(description.picked)} are good")
    text = "; ".join(f"{name}: {', '.join(faults)}" for name, faults in found.bad.items())
    unusable = judge.with_bad(found.bad).unusable
    return _check(what, unusable is None, text if unusable is None else f"{text}. {unusable}")


def _fits(model_path: Path, inlet: EegInlet) -> dict[str, Any]:
    from decoder.model import fit_stream, load

    description = inlet.description
    try:
        fit_stream(load(model_path), description.name, description.picked, description.sfreq)
    except SetupError as error:
        return _check("EEG fits the decoder", False, str(error))
    return _check("EEG fits the decoder", True, f"all channels of {model_path.name} are there")


def _check(what: str, ok: bool, text: str) -> dict[str, Any]:
    return {"check": what, "ok": ok, "text": text}


def show(result: dict[str, Any], console: Console) -> None:
    """The findings as two tables."""
    streams = Table("name", "type", "channels", "Hz", "source id", "host", title="Streams")
    for stream in result["streams"]:
        values = ("name", "type", "channels", "sfreq", "source_id", "hostname")
        streams.add_row(*(escape(str(stream[key])) for key in values))
    checks = Table("", "check", "found", title="Checks")
    for check in result["checks"]:
        checks.add_row("[green]ok[/]" if check["ok"] else "[red]no[/]", check["check"], escape(check["text"]))
    console.print(streams, checks)
