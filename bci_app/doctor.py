"""Which streams are there, does the EEG fit, what is missing: a first look before a participant comes.

Everything that would keep a session from starting, or from being worth its hours, is a check that fails.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bci_app import certification, priority, trial
from bci_app.config import Config
from bci_app.eeg import EegDescription
from bci_app.errors import LinkLost, SetupError
from bci_app.lsl import EegInlet, all_streams, find_eeg, finds_streams, local_clock
from bci_app.progress import Progress
from bci_app.set_up import applied, check_stream
from bci_app.trial import check
from bci_app.verbs import disk

FIND_S = 5.0
"""Real seconds in which LSL must find a stream on this computer (decided; it takes one)."""
CLOCK_S = 5.0
"""Seconds the newest sample's stamp may be from now, as in the decoder (decided)."""
NO_SOURCE_ID = (
    "'{name}' has no source_id, so that LSL can't find it again after an interruption: neither the session nor the "
    "recording would go on. Give it one in the amplifier's LSL connector"
)
LOOK_S = 10.0
"""Real seconds of EEG that are looked at: as many as before an episode."""


def examine(config: Config, model_path: Path | None, progress: Progress, in_trial: bool = False) -> dict[str, Any]:
    """``streams`` on the network, ``checks`` (what, ok, text), and ``fit``: whether all checks passed.

    With ``in_trial`` also a few moves are made for real.
    """
    progress("looking at the network", 0, 3)
    streams = all_streams()
    checks = [_network(), check("streams on the network", bool(streams), f"{len(streams)} found")]
    progress("looking at the EEG", 1, 3)
    stream = None
    try:
        info = find_eeg(config.eeg, timeout=2.0)
        inlet = EegInlet(info, config.eeg.buffer_s)
        description = inlet.description
        stream = description.name
        text = f"'{description.name}', {len(description.picks)} EEG channels at {description.sfreq:g} Hz"
        samples, times = _listen(inlet)
        checks += [check("EEG stream with labels and units", True, text), _rate(inlet, config, times)]
        checks += [_clock(inlet, times), _electrodes(inlet, samples, times, config), _disk(config, description)]
        if not description.source_id:
            checks.append(check("the stream can come back", False, NO_SOURCE_ID.format(name=description.name)))
        if model_path:
            checks.append(_fits(model_path, inlet))
    except (SetupError, LinkLost) as error:
        checks.append(check("EEG stream with labels and units", False, str(error)))
    checks += [_screen(config), *_set_up(config, stream), _priority(config)]
    progress("making a few moves", 2, 3)
    if in_trial and all(each["ok"] for each in checks):
        checks += trial.run(config, model_path, progress)
    progress("done", 3, 3)
    return {"streams": streams, "checks": checks, "fit": all(each["ok"] for each in checks)}


def _screen(config: Config) -> dict[str, Any]:
    """Whether the stimulus's window opens, its texts fit, and how it shows its pictures; `certify` tells more."""
    what = "screen"
    if config.stimulus.headless:
        return check(what, True, "not looked at (--headless)")
    from stimulus.screen import look

    try:
        found = look(config)
    except SetupError as error:
        return check(what, False, str(error))
    finding = certification.screen(found.flips, found.refresh_hz)
    return check(what, finding.ok is True, f"{found.size[0]} x {found.size[1]} pixels, {finding.found}")


def _set_up(config: Config, stream: str | None) -> list[dict[str, Any]]:
    """Whether what `certify` measured is of this screen and, where there is one, this EEG stream; nothing where no file
    of it is named."""
    if config.stimulus.set_up is None:
        return []
    what = "set-up file"
    try:
        delay_ms = applied(config).stimulus.photon_delay_ms
        if stream is not None:
            check_stream(config, stream)
    except SetupError as error:
        return [check(what, False, str(error))]
    of = "this set-up" if stream is not None else "this screen, and without EEG nobody knows whether of its amplifier"
    return [check(what, True, f"of {of}: light comes {delay_ms:g} ms after the flip")]


def _priority(config: Config) -> dict[str, Any]:
    """No reason not to start: on a computer that has nothing else to do a loop is as fast without."""
    return check("priority", True, priority.outlook(config.priority))


def _network() -> dict[str, Any]:
    """Whether LSL finds a stream at all, for which one of ours is opened: else nothing would be found however well it
    ran."""
    what = "LSL finds streams"
    if not finds_streams(FIND_S):
        text = (
            f"not even one on this computer within {FIND_S:g} s: a firewall or the network keeps LSL's multicast from "
            "its way, so that no amplifier can be found though it runs. Let UDP and TCP 16571-16604 through"
        )
        return check(what, False, text)
    return check(what, True, "one of our own was found")


def _clock(inlet: EegInlet, times: NDArray[np.float64]) -> dict[str, Any]:
    what, now = "the amplifier's clock", local_clock()
    offset = inlet.clock_correction()
    age = now - (float(times[-1]) + offset) if len(times) else float("nan")
    text = f"{offset * 1e3:+.2f} ms to this computer's; the newest sample is {age * 1e3:.0f} ms old"
    return check(what, abs(age) < CLOCK_S, text)


def _disk(config: Config, eeg: EegDescription) -> dict[str, Any]:
    what, (needed, free) = "room for a session on the disk", disk(config, eeg)
    return check(what, free >= needed, f"{free / 1e9:.1f} GB free, about {needed / 1e9:.1f} GB needed")


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
        return check("samples at the nominal rate", False, str(error))
    return check("samples at the nominal rate", True, f"{rate:.2f} Hz over {LOOK_S:g} s")


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
        return check(what, False, str(error))
    if not found.n_samples:
        return check(what, False, f"too little EEG in {LOOK_S:g} s to tell")
    if not found.bad:
        return check(what, True, f"all {len(description.picked)} are good")
    text = "; ".join(f"{name}: {', '.join(faults)}" for name, faults in found.bad.items())
    unusable = judge.with_bad(found.bad).unusable
    return check(what, unusable is None, text if unusable is None else f"{text}. {unusable}")


def _fits(model_path: Path, inlet: EegInlet) -> dict[str, Any]:
    from decoder.model import fit_stream, load

    description = inlet.description
    try:
        fit_stream(load(model_path), description.name, description.picked, description.sfreq)
    except SetupError as error:
        return check("EEG fits the decoder", False, str(error))
    return check("EEG fits the decoder", True, f"all channels of {model_path.name} are there")


def _table(title: str, *heads: str) -> Table:
    """An id or a path that is cut off is of no use: what is too long goes on in the next line."""
    table = Table(title=title)
    for head in heads:
        table.add_column(head, overflow="fold")
    return table


def show(result: dict[str, Any], console: Console) -> None:
    """The findings as two tables."""
    streams = _table("Streams", "name", "type", "channels", "Hz", "source id", "host")
    checks = _table("Checks", "", "check", "found")
    for stream in result["streams"]:
        values = ("name", "type", "channels", "sfreq", "source_id", "hostname")
        streams.add_row(*(escape(str(stream[key])) for key in values))
    for each in result["checks"]:
        checks.add_row("[green]ok[/]" if each["ok"] else "[red]no[/]", each["check"], escape(each["text"]))
    console.print(streams, checks)
