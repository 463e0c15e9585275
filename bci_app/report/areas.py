"""Central against edge area (paper V.C.3): how often verdicts are right in each, and whether the two differ."""

from collections.abc import Sequence
from math import hypot

import numpy as np
from scipy import stats

from bci_app.report import Row, by_person, distinct, those
from bci_app.report.steps import is_right, judged
from decoder.calibration import Estimate, wilson

AREAS = ("central", "edge")
FEWEST_PARTICIPANTS = 6
"""For a signed-rank test that can come below p = 0.05 (2 ** (1 - n))."""


def accuracy_rows(moves: Sequence[Row], **where: object) -> list[Row]:
    """One row an area: shares of right verdicts of all, error and correct moves, with Wilson's 95 % intervals."""
    rows = []
    for area in AREAS:
        mine = those(judged(moves), area=area)
        parts = {
            "accuracy": mine,
            "hit_rate": [move for move in mine if move["error"]],
            "correct_rejection_rate": [move for move in mine if not move["error"]],
        }
        if not mine:
            continue
        row: Row = {**where, "area": area, "n": len(mine), "n_error": len(parts["hit_rate"])}
        for name, part in parts.items():
            share = _share(part)
            row |= {
                name: share.value if share else None,
                f"{name}_low": share.low if share else None,
                f"{name}_high": share.high if share else None,
            }
        rates = [row["hit_rate"], row["correct_rejection_rate"]]
        row["balanced_accuracy"] = None if None in rates else sum(rates) / 2
        rows.append(row)
    return rows


def difference_row(moves: Sequence[Row], **where: object) -> list[Row]:
    """Central less edge accuracy of one participant, with MOVER's 95 % interval from Wilson's (Zou & Donner 2008,
    doi:10.1002/sim.3095), and Fisher's exact test. Nothing without moves in both areas."""
    central, edge = (those(judged(moves), area=area) for area in AREAS)
    if not central or not edge:
        return []
    (k, n), (m, o) = ((sum(map(is_right, part)), len(part)) for part in (central, edge))
    a, b = wilson(k, n), wilson(m, o)
    difference = a.value - b.value
    return [
        {
            **where,
            "measure": "accuracy",
            "central": a.value,
            "edge": b.value,
            "difference": difference,
            "low": difference - hypot(a.value - a.low, b.high - b.value),
            "high": difference + hypot(a.high - a.value, b.value - b.low),
            "p": float(stats.fisher_exact([[k, n - k], [m, o - m]]).pvalue),
            "n": n + o,
            "unit": "moves",
            "test": "Fisher's exact",
        }
    ]


def group_rows(rows: Sequence[Row]) -> list[Row]:
    """Over participants, on each map: mean difference with Student's interval, and Wilcoxon's signed-rank test.

    `rows` are of `difference_row`; a participant's visits and runs are averaged first. Nothing with fewer than
    `FEWEST_PARTICIPANTS`.
    """
    found = []
    for name in distinct(list(rows), "map"):
        group = by_person(those(list(rows), map=name), *AREAS, "difference")
        differences = np.array([row["difference"] for row in group])
        n = len(differences)
        if n < FEWEST_PARTICIPANTS or not differences.any():
            continue
        half = float(stats.t.ppf(0.975, n - 1) * differences.std(ddof=1) / np.sqrt(n))
        mean = float(differences.mean())
        found.append(
            {"participant": "all", "visit": None, "map": name, "measure": "accuracy"}
            | {area: float(np.mean([row[area] for row in group])) for area in AREAS}
            | {"difference": mean, "low": mean - half, "high": mean + half}
            | {"p": float(stats.wilcoxon(differences).pvalue), "n": n, "unit": "participants"}
            | {"test": "Wilcoxon's signed-rank"}
        )
    return found


def _share(moves: Sequence[Row]) -> Estimate | None:
    return wilson(sum(map(is_right, moves)), len(moves)) if moves else None
