"""Event-related potentials as rows: means with their spread, the difference wave, its peaks, its map over the head."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bci_app.report import AVERAGED, Row, distinct, unit_of
from bci_app.report.online import over_people
from bci_app.report.waveforms import Waveforms
from decoder.calibration import Z95

Array = NDArray[np.float64]

PEAKS = {"negative 200": (150.0, 250.0, -1), "positive 300": (250.0, 350.0, 1), "negative 400": (350.0, 500.0, -1)}
"""Where each peak of the difference wave is looked for, ms, and its sign. The paper's are "approximately" at 200, 300
and 400 ms (V.B.1); the windows are decided."""
MAPS_MS = (200.0, 300.0, 400.0)
"""Moments of the maps over the head (paper's peaks)."""
MAP_WIDTH_MS = 20.0
"""Around each of them the mean is taken (decided)."""
FEWEST = 5
"""Trials of a kind below which a mean isn't worth drawing (decided)."""


def mean_rows(waves: Waveforms, trials: NDArray[np.bool_], **where: object) -> list[Row]:
    """Means of error and correct moves and their difference, at each moment, of some trials, (n_trials,).

    ``sd_uv`` is over trials, ``low_uv`` and ``high_uv`` the 95 % interval of the mean. A kind of move with fewer than
    two trials has no rows.
    """
    rows = []
    for number, channel in enumerate(waves.picks):
        found = {
            name: waves.trials[trials & kind, number]
            for name, kind in (("error", waves.error), ("correct", ~waves.error))
        }
        found = {name: each for name, each in found.items() if len(each) > 1}
        parts = {name: (each.mean(axis=0), each.std(axis=0, ddof=1), len(each)) for name, each in found.items()}
        for name, (mean, sd, n) in parts.items():
            rows += _rows(waves.times_ms, mean, sd, sd / np.sqrt(n), n, where, name, channel)
        if len(parts) == 2:
            (error, sd_error, n_error), (correct, sd_correct, n_correct) = parts["error"], parts["correct"]
            spread = np.sqrt(sd_error**2 / n_error + sd_correct**2 / n_correct)
            n = n_error + n_correct
            rows += _rows(waves.times_ms, error - correct, None, spread, n, where, "difference", channel)
    return rows


def _rows(
    times: Array, mean: Array, sd: Array | None, spread: Array, n: int, where: Row, condition: str, channel: str
) -> list[Row]:
    return [
        {
            **where,
            "condition": condition,
            "channel": channel,
            "time_ms": float(time),
            "mean_uv": float(value),
            "sd_uv": None if sd is None else float(sd[place]),
            "low_uv": float(value - Z95 * spread[place]),
            "high_uv": float(value + Z95 * spread[place]),
            "n": n,
        }
        for place, (time, value) in enumerate(zip(times, mean, strict=True))
    ]


def grand_average(rows: Sequence[Row], by: Sequence[str]) -> list[Row]:
    """Rows of `mean_rows` averaged over visits, and over participants: each counts alike.

    Of several participants ``sd_uv`` is over their means, the interval is `over_people`'s, and ``n`` counts them. Of
    one participant's visits, whose mean is ``visit`` `AVERAGED`, ``sd_uv`` is that within them, the interval normal,
    and ``n`` counts trials; a single visit's rows stay as they are. `by` names the columns that tell means apart,
    beside participant, condition, channel and time. Who has no such channel or moment leaves it to the others.
    """
    people = {row["participant"] for row in rows}
    if len({(row["participant"], row["visit"]) for row in rows}) < 2:
        return list(rows)
    groups: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        key = (*(row[name] for name in by), row["condition"], row["channel"], round(row["time_ms"], 3))
        groups.setdefault(key, []).append(row)
    averaged = []
    for key, members in groups.items():
        about = {**dict(zip(by, key, strict=False)), "condition": key[-3], "channel": key[-2]}
        if len(people) == 1:
            averaged.append(about | _over_visits(members))
            continue
        mine: dict[str, list[float]] = {}
        for row in members:
            mine.setdefault(row["participant"], []).append(row["mean_uv"])
        means = np.array([np.mean(values) for values in mine.values()])
        n, mean = len(means), float(means.mean())
        found = over_people(means.tolist())
        averaged.append(
            {**about, "participant": "all", "visit": None}
            | {"time_ms": members[0]["time_ms"], "mean_uv": mean, "sd_uv": float(means.std(ddof=1)) if n > 1 else None}
            | {"low_uv": found["low"], "high_uv": found["high"], "n": n}
        )
    return averaged


def _over_visits(rows: Sequence[Row]) -> Row:
    """One moment of one participant's visits as one."""
    mean = float(np.mean([row["mean_uv"] for row in rows]))
    half = float(np.linalg.norm([row["high_uv"] - row["mean_uv"] for row in rows])) / len(rows)
    sd = None if rows[0]["sd_uv"] is None else float(np.sqrt(np.mean([row["sd_uv"] ** 2 for row in rows])))
    return {
        "participant": rows[0]["participant"],
        "visit": AVERAGED,
        "time_ms": rows[0]["time_ms"],
        "mean_uv": mean,
        "sd_uv": sd,
        "low_uv": mean - half,
        "high_uv": mean + half,
        "n": sum(row["n"] for row in rows),
    }


def peak_rows(rows: Sequence[Row], **where: object) -> list[Row]:
    """The peaks of difference waves, one row for each channel and peak: where, how large, with its interval there.

    The peak is picked where it is largest, so the interval, that of the mean at that moment, is a little optimistic.
    """
    found = []
    waves = [row for row in rows if row["condition"] == "difference"]
    for channel in distinct(waves, "channel"):
        wave = [row for row in waves if row["channel"] == channel]
        for name, (begin, end, sign) in PEAKS.items():
            inside = [row for row in wave if begin <= row["time_ms"] <= end]
            if inside:
                peak = max(inside, key=lambda row: sign * row["mean_uv"])
                values = {key: peak[key] for key in ("time_ms", "mean_uv", "low_uv", "high_uv", "n")}
                values["unit"] = unit_of(peak)
                found.append({**where, "channel": channel, "peak": name, **values})
    return found


def map_rows(waves: Waveforms, **where: object) -> list[Row]:
    """The difference wave over the head at the moments of `MAPS_MS`; nothing unless there are both kinds of move."""
    difference = waves.difference
    if difference is None:
        return []
    rows = []
    for moment in MAPS_MS:
        inside = np.abs(waves.times_ms - moment) <= MAP_WIDTH_MS / 2
        for channel, value in zip(waves.channels, difference[:, inside].mean(axis=1), strict=True):
            rows.append({**where, "time_ms": moment, "channel": channel, "difference_uv": float(value)})
    return rows
