"""The error potential's size against the number of errors in a row (paper V.C.4, Fig. 13).

The paper takes the difference of the positive and the negative peak of each mean. A mean of few trials has large peaks
by chance, so that grows where trials get few, as they do after many errors. Beside it stands a measure that doesn't:
the mean of each single trial around the two peaks' places, which are the same for all.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bci_app.report import AVERAGED, Row, by_person, distinct, those
from bci_app.report.erp import PEAKS
from bci_app.report.online import mean_interval, over_people
from bci_app.report.waveforms import Waveforms, nearest

Array = NDArray[np.float64]

WIDTH_MS = 50.0
"""Around each peak a trial's mean is taken over this (decided)."""
LAST = 8
"""Errors in a row that are looked at; more are counted with them (decided)."""
FIRST_LEVELS = 4
"""Over which the paper's amplitude falls."""


def level_name(row: Row) -> str:
    """A number of errors in a row, in words."""
    level = row["errors_in_a_row"]
    return f"{level} or more" if level == LAST else str(level)


def trial_amplitudes(waves: Waveforms) -> list[tuple[int, float]]:
    """Of each error move: errors in a row up to it, and how far the positive lies above the negative peak, uV.

    Where the peaks are is taken from the mean of all error moves at the channel next to Fz.
    """
    if not waves.error.any():
        return []
    trials = waves.trials[waves.error, waves.picks.index(nearest("Fz", waves.picks))]
    low, high = (_around(waves.times_ms, moment) for moment in _peaks(waves.times_ms, trials.mean(axis=0)))
    sizes = trials[:, high].mean(axis=1) - trials[:, low].mean(axis=1)
    levels = [min(LAST, move["errors_in_a_row"]) for move in waves.moves if move["error"]]
    return list(zip(levels, sizes.tolist(), strict=True))


def level_rows(waves: Waveforms, **where: object) -> list[Row]:
    """One row for each number of errors in a row: mean amplitude with Student's 95 % interval, and the paper's
    peak-to-peak of the mean."""
    sizes = trial_amplitudes(waves)
    rows = []
    for level in sorted({level for level, _ in sizes}):
        own = [size for each, size in sizes if each == level]
        rows.append({**where, "errors_in_a_row": level, "n": len(own), "unit": "moves", **mean_interval(own)})
    place = waves.picks.index(nearest("Fz", waves.picks))
    for row in rows:
        mine = [move["error"] and min(LAST, move["errors_in_a_row"]) == row["errors_in_a_row"] for move in waves.moves]
        mean = waves.trials[np.array(mine), place].mean(axis=0)
        negative, positive = _peaks(waves.times_ms, mean)
        at = {moment: mean[np.abs(waves.times_ms - moment).argmin()] for moment in (negative, positive)}
        row |= {"peak_to_peak": float(at[positive] - at[negative]), "channel": waves.picks[place]}
    return rows


def trend_row(waves: Waveforms, **where: object) -> list[Row]:
    """How the amplitude changes with each error, over the first `FIRST_LEVELS`: slope of a line through single trials,
    uV an error, with its 95 % interval. Nothing with fewer than two numbers of errors, or three trials."""
    sizes = np.array([pair for pair in trial_amplitudes(waves) if pair[0] <= FIRST_LEVELS])
    if len(sizes) < 3 or len(np.unique(sizes[:, 0])) < 2:
        return []
    line = stats.linregress(sizes[:, 0], sizes[:, 1])
    half = float(stats.t.ppf(0.975, len(sizes) - 2) * line.stderr)
    slope = float(line.slope)
    values = {"slope": slope, "low": slope - half, "high": slope + half, "p": float(line.pvalue)}
    return [{**where, **values, "n": len(sizes), "unit": "trials"}]


def group_levels(rows: Sequence[Row]) -> list[Row]:
    """Over participants: means of their means, each counting alike, with the interval of `over_people`. Before
    that the moves of a participant's visits are taken together. One participant's visits come as one, a single visit's
    rows stay as they are."""
    if len({(row["participant"], row["visit"]) for row in rows}) < 2:
        return list(rows)
    several = len(distinct(list(rows), "participant")) > 1
    found = []
    for source in distinct(list(rows), "source"):
        for level in sorted(set(distinct(those(list(rows), source=source), "errors_in_a_row"))):
            mine = those(list(rows), source=source, errors_in_a_row=level)
            group = [_together(those(mine, participant=person)) for person in distinct(mine, "participant")]
            found.append(
                {"participant": "all", "visit": None, "source": source, "errors_in_a_row": level}
                | {"n": len(group), "unit": "participants"}
                | over_people([row["mean"] for row in group])
                | {"peak_to_peak": float(np.mean([row["peak_to_peak"] for row in group]))}
                | {"channel": group[0]["channel"]}
                if several
                else group[0] | {"visit": AVERAGED}
            )
    return found


def _together(rows: Sequence[Row]) -> Row:
    """One participant's visits at one number of errors in a row as one: mean and interval of all their moves, from the
    number, mean and spread of each; `peak_to_peak` in the mean over moves."""
    if len(rows) == 1:
        return rows[0]
    n, mean, peaks = (np.array([row[name] for row in rows], dtype=float) for name in ("n", "mean", "peak_to_peak"))
    variance = [
        row["n"] * ((row["high"] - row["mean"]) / stats.t.ppf(0.975, row["n"] - 1)) ** 2 if row["n"] > 1 else 0.0
        for row in rows
    ]
    total, middle = int(n.sum()), float(np.average(mean, weights=n))
    squares = float(np.sum((n - 1) * variance + n * (mean - middle) ** 2))
    half = float(stats.t.ppf(0.975, total - 1)) * (squares / (total - 1) / total) ** 0.5
    together = {"n": total, "mean": middle, "low": middle - half, "high": middle + half}
    return {**rows[0], **together, "peak_to_peak": float(np.average(peaks, weights=n))}


def group_trend(rows: Sequence[Row]) -> list[Row]:
    """Over participants: the mean of their slopes, and from `FEWEST_PEOPLE` on Student's interval and test of it. A
    participant's visits are averaged first. Nothing with fewer than two participants."""
    found = []
    for source in distinct(list(rows), "source"):
        slopes = [row["slope"] for row in by_person(those(list(rows), source=source), "slope")]
        if len(slopes) < 2 or not np.ptp(slopes):
            continue
        interval = over_people(slopes)
        values = {"slope": interval["mean"], "low": interval["low"], "high": interval["high"]}
        p = None if interval["low"] is None else float(stats.ttest_1samp(slopes, 0).pvalue)
        found.append(
            {"participant": "all", "visit": None, "source": source, **values, "p": p}
            | {"n": len(slopes), "unit": "participants"}
        )
    return found


def _peaks(times_ms: Array, wave: Array) -> tuple[float, float]:
    """Moments of the negative peak near 200 ms and of the positive one near 300 ms."""
    moments = []
    for begin, end, sign in list(PEAKS.values())[:2]:
        inside = np.flatnonzero((times_ms >= begin) & (times_ms <= end))
        moments.append(float(times_ms[inside[np.argmax(sign * wave[inside])]]))
    return moments[0], moments[1]


def _around(times_ms: Array, moment: float) -> NDArray[np.bool_]:
    return np.abs(times_ms - moment) <= WIDTH_MS / 2
