"""Where two waveforms differ: cluster-based permutation tests (Maris & Oostenveld 2007,
doi:10.1016/j.jneumeth.2007.03.024), as MNE does them.

The paper marks where its Fig. 11 differs with p < 0.05 and doesn't say by which test. One for each sample would find
differences everywhere by chance; a test of clusters looks at all of them at once.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.report import Row, distinct
from bci_app.report.areas import AREAS
from bci_app.report.erp import FEWEST
from bci_app.report.waveforms import Waveforms, nearest

Array = NDArray[np.float64]

N_PERMUTATIONS = 1000
SEED = 0
ALPHA = 0.05
FEWEST_PARTICIPANTS = 6
"""Below this many 1 participant in 32 signs can't come below p = 0.05 (2 ** (1 - n))."""
COMPARISONS = (
    ("error - correct, all", "all", "all"),
    ("error - correct, central", "central", "central"),
    ("error - correct, edge", "edge", "edge"),
    ("error, central - edge", "central", "edge"),
)


def cluster_rows(waves: Waveforms, **where: object) -> list[Row]:
    """Within one participant: trials against trials. A row for each cluster with p below `ALPHA`, and one without a
    beginning where a comparison was made and found none."""
    area = np.array([move["area"] for move in waves.moves])
    after = waves.times_ms >= 0
    rows = []
    for number, channel in enumerate(waves.picks):
        trials = waves.trials[:, number][:, after]
        for name, first, second in COMPARISONS:
            if not _is_for(name, channel, waves.picks):
                continue
            in_first, in_second = (np.isin(area, AREAS if each == "all" else (each,)) for each in (first, second))
            one = trials[waves.error & in_first]
            other = trials[waves.error & in_second] if first != second else trials[~waves.error & in_second]
            if min(len(one), len(other)) >= FEWEST:
                about = {**where, "comparison": name, "channel": channel, "n": len(one) + len(other), "unit": "trials"}
                rows += _found(_between(one, other), waves.times_ms[after], about)
    return rows


def _is_for(comparison: str, channel: str, picks: Sequence[str]) -> bool:
    """Over all moves Fz is looked at, as in Fig. 9, in the areas FCz, as in Fig. 11."""
    return channel == nearest("Fz" if comparison.endswith("all") else "FCz", picks)


def group_cluster_rows(rows: Sequence[Row], **where: object) -> list[Row]:
    """Over participants: their means of `report.erp.mean_rows` against each other, in pairs. A participant's visits
    are averaged first.

    Nothing with fewer than `FEWEST_PARTICIPANTS`, for then no cluster could be significant.
    """
    found: list[Row] = []
    channels = distinct(list(rows), "channel")
    for channel in channels:
        for name, first, second in COMPARISONS:
            if not _is_for(name, channel, channels):
                continue
            kind = "difference" if first == second else "error"
            times, one = _of_participants(rows, first, kind, channel)
            _, other = _of_participants(rows, second, kind, channel)
            both = [person for person in one if person in other]
            if len(both) < FEWEST_PARTICIPANTS:
                continue
            paired = np.array([one[person] for person in both])
            if first != second:
                paired = paired - np.array([other[person] for person in both])
            about = {**where, "comparison": name, "channel": channel, "n": len(both), "unit": "participants"}
            found += _found(_within(paired), times, about)
    return found


def _of_participants(rows: Sequence[Row], area: str, condition: str, channel: str) -> tuple[Array, dict[str, Array]]:
    waves: dict[str, dict[float, list[float]]] = {}
    for row in rows:
        if (row["area"], row["condition"], row["channel"]) == (area, condition, channel) and row["time_ms"] >= 0:
            wave = waves.setdefault(row["participant"], {})
            wave.setdefault(round(row["time_ms"], 3), []).append(row["mean_uv"])
    times = sorted({time for wave in waves.values() for time in wave})
    whole = {person: wave for person, wave in waves.items() if len(wave) == len(times)}
    means = {person: np.array([np.mean(wave[time]) for time in times]) for person, wave in whole.items()}
    return np.array(times), means


def _between(one: Array, other: Array) -> list[tuple[slice, float, float]]:
    import mne

    with mne.use_log_level("error"):
        statistic, clusters, p, _ = mne.stats.permutation_cluster_test(
            [one, other], n_permutations=N_PERMUTATIONS, seed=SEED, out_type="mask"
        )
    return _stretches(clusters, p, np.sign(one.mean(axis=0) - other.mean(axis=0)) * np.sqrt(statistic))


def _within(paired: Array) -> list[tuple[slice, float, float]]:
    import mne

    with mne.use_log_level("error"):
        statistic, clusters, p, _ = mne.stats.permutation_cluster_1samp_test(
            paired, n_permutations=N_PERMUTATIONS, seed=SEED, out_type="mask"
        )
    return _stretches(clusters, p, statistic)


def _stretches(clusters: list[Any], p: Array, t: Array) -> list[tuple[slice, float, float]]:
    """From MNE's clusters to (stretch of time, p, summed t)."""
    found = []
    for cluster, probability in zip(clusters, p, strict=True):
        part = cluster[0] if isinstance(cluster, tuple) else cluster
        inside = np.zeros(len(t), bool)
        inside[part] = True
        places = np.flatnonzero(inside)
        stretch = slice(int(places[0]), int(places[-1]))
        found.append((stretch, float(probability), float(t[inside].sum())))
    return found


def _found(clusters: list[tuple[slice, float, float]], times: Array, about: Row) -> list[Row]:
    significant = [
        {**about, "begin_ms": float(times[part.start]), "end_ms": float(times[part.stop]), "p": p, "sum_of_t": total}
        for part, p, total in clusters
        if p < ALPHA
    ]
    least = min((p for _, p, _ in clusters), default=1.0)
    return significant or [{**about, "begin_ms": None, "end_ms": None, "p": least, "sum_of_t": None}]
