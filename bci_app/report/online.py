"""Online runs: the paper's Tables I, II, A1 and A2, and success and steps by initial distance."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bci_app.report import AVERAGED, FEWEST_PEOPLE, Row, by_person, calibrations, distinct, published, those
from decoder.calibration import wilson

PEOPLE = "Wang et al. 2022, people"


def table_one(scores: Sequence[Row], runs: Sequence[Row], moves: Sequence[Row] = ()) -> list[Row]:
    """Table I: share of right verdicts, cross-validated and on each map, one row a participant and visit.

    Parameters
    ----------
    scores : rows of `report.calibrations.score_rows`; ``source`` is ``tenfold``, ``contiguous`` or a map's name.
    runs : rows of the runs, which tell the order of participants.
    moves : rows of the moves. Those of a visit's several runs on a map are taken together; of its calibrations the last
        one's scores stand here, as in `report.json`.

    Beside the accuracy, which flatters where one kind of move is rare, stand balanced accuracy and AUC.
    """
    rows = []
    for who in _who(runs):
        row: Row = {"series": "ours", **who}
        for source in ("tenfold", "contiguous", *_maps(runs)):
            mine = _of_several_runs(those(list(moves), **who, task="online", map=source), source)
            mine = those(list(scores), **who, source=source) if mine is None else mine
            for measure in ("accuracy", "balanced_accuracy", "auc"):
                found = those(mine, measure=measure)
                for key in ("value", "low", "high"):
                    name = f"{source}_{measure}{'' if key == 'value' else '_' + key}"
                    row[name] = found[-1][key] if found else None
        rows.append(row)
    rows += _mean(rows)
    for number, person in enumerate(published.PEOPLE):
        values = {("tenfold" if key == "offline" else key): each[number] for key, each in published.ACCURACY.items()}
        rows.append(_published(person) | {f"{key}_accuracy": value for key, value in values.items()})
    means = {("tenfold" if key == "offline" else key): value for key, value in published.MEAN_ACCURACY.items()}
    return [*rows, _published("mean") | {f"{key}_accuracy": value for key, value in means.items()}]


def table_two(episodes: Sequence[Row], runs: Sequence[Row]) -> list[Row]:
    """Table II: success within the limit, and mean and standard deviation of the steps of the episodes that succeeded.

    ``..._mean_steps_all`` counts a failed episode with its steps; episodes that were broken off don't count.
    """
    maps, rows = _maps(runs), []
    for who in _who(runs):
        row: Row = {"series": "ours", **who}
        for name in maps:
            row |= {f"{name}_{key}": value for key, value in summary(those(list(episodes), **who, map=name)).items()}
        if any(row.get(f"{name}_n_episodes") for name in maps):
            rows.append(row)
    rows += _mean(rows)
    for number, person in enumerate(published.PEOPLE):
        row = _published(person)
        for name, shares in published.SUCCESS.items():
            mean, sd = published.STEPS[name][number]
            row |= _published_steps(name, shares[number], mean, sd)
        rows.append(row)
    mean_row = _published("mean")
    for name, share in published.MEAN_SUCCESS.items():
        mean_row |= _published_steps(name, share, *published.MEAN_STEPS[name])
    return [*rows, mean_row]


def summary(episodes: Sequence[Row]) -> Row:
    """Success with Wilson's interval, and steps, of episodes that weren't broken off."""
    ended = [row for row in episodes if row["reason"] in ("goal", "limit")]
    steps = [row["steps"] for row in ended if row["success"]]
    if not ended:
        return {"n_episodes": 0}
    success = wilson(len(steps), len(ended))
    return {
        "n_episodes": len(ended),
        "success": success.value,
        "success_low": success.low,
        "success_high": success.high,
        "mean_steps": float(np.mean(steps)) if steps else None,
        "sd_steps": float(np.std(steps, ddof=1)) if len(steps) > 1 else None,
        "mean_steps_all": float(np.mean([row["steps"] for row in ended])),
    }


def table_a(episodes: Sequence[Row], runs: Sequence[Row], map_name: str) -> list[Row]:
    """Tables A1 and A2: steps of each episode on a map, by its initial distance, and how many failed.

    Columns are named ``distance_2`` and so on; several episodes of a distance are a list with commas. The published
    steps of single episodes can't be read in the text at hand; published are the numbers of failed episodes.
    """
    mine = [row for row in episodes if row["map"] == map_name and row["reason"] in ("goal", "limit")]
    distances = sorted({row["distance"] for row in mine if row["distance"] is not None})
    rows = []
    for who in _who(runs):
        own = those(mine, **who)
        if not own:
            continue
        row: Row = {"series": "ours", **who}
        for distance in distances:
            found = [each["steps"] for each in own if each["distance"] == distance]
            row[f"distance_{distance}"] = ", ".join(map(str, found)) or None
        rows.append(row | {"failed": sum(not each["success"] for each in own), "n_episodes": len(own)})
    if map_name in published.SUCCESS:
        failed = zip(published.PEOPLE, published.failed(map_name), strict=True)
        rows += [_published(person) | {"failed": n, "n_episodes": published.N_EPISODES} for person, n in failed]
    return rows


def by_distance(episodes: Sequence[Row]) -> list[Row]:
    """Success and steps of all participants' episodes by map and initial distance, with 95 % intervals.

    The interval of the mean steps is Student's over episodes; None for a single one.
    """
    rows = []
    known = [row for row in episodes if row["distance"] is not None and row["reason"] in ("goal", "limit")]
    for name, distance in sorted({(row["map"], row["distance"]) for row in known}):
        group = those(known, map=name, distance=distance)
        rows.append({"map": name, "distance": distance, **summary(group), **mean_interval([r["steps"] for r in group])})
    return rows


def mean_interval(values: Sequence[float]) -> dict[str, float | None]:
    """``mean``, ``low`` and ``high`` of Student's 95 % interval; without one for fewer than two values."""
    from scipy.stats import t

    n = len(values)
    if n == 0:
        return {"mean": None, "low": None, "high": None}
    mean = float(np.mean(values))
    if n == 1:
        return {"mean": mean, "low": None, "high": None}
    half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n))
    return {"mean": mean, "low": mean - half, "high": mean + half}


def over_people(means: Sequence[float]) -> dict[str, float | None]:
    """As `mean_interval`, of participants' means; without an interval for fewer than `FEWEST_PEOPLE`."""
    found = mean_interval(means)
    if len(means) < FEWEST_PEOPLE:
        found |= {"low": None, "high": None}
    return found


def _of_several_runs(moves: Sequence[Row], source: str) -> list[Row] | None:
    """Scores of the verdicts of a visit's runs on a map, taken together; None where it is no more than one run."""
    if len(distinct(list(moves), "run")) < 2:
        return None
    scored = [move for move in moves if move["error"] is not None and move["log_odds"] is not None]
    log_odds, evidence = (np.array([m[name] for m in scored], dtype=np.float64) for name in ("log_odds", "evidence"))
    found = calibrations.judged_online(log_odds, evidence, np.array([m["error"] for m in scored], dtype=bool))
    return calibrations.score_rows(found, source) if found else []


def _mean(rows: Sequence[Row]) -> list[Row]:
    """The mean of each column over several participants, as in the paper's last rows; no intervals. A participant's
    visits are averaged first; with a single participant they are the mean."""
    if len(rows) < 2:
        return []
    told = dict.fromkeys(name for each in rows for name in each if not name.endswith(("_low", "_high")))
    names = [name for name in told if any(isinstance(each.get(name), int | float) for each in rows)]
    people = by_person(rows, *names)
    if len(people) == 1:
        return [{"series": "ours", "visit": AVERAGED, **people[0]}]
    (mean,) = by_person([{**person, "participant": "mean"} for person in people], *names)
    return [{"series": "ours", "visit": None, **mean}]


def _who(runs: Sequence[Row]) -> list[dict[str, Any]]:
    found = dict.fromkeys((row["participant"], row["visit"]) for row in runs)
    return [{"participant": participant, "visit": visit} for participant, visit in found]


def _maps(runs: Sequence[Row]) -> list[str]:
    return distinct([row for row in runs if row["task"] == "online"], "map")


def _published(person: str) -> Row:
    return {"series": PEOPLE, "participant": person, "visit": None}


def _published_steps(name: str, share: float, mean: float, sd: float) -> Mapping[str, Any]:
    return {
        f"{name}_n_episodes": published.N_EPISODES,
        f"{name}_success": share,
        f"{name}_mean_steps": mean,
        f"{name}_sd_steps": sd,
    }
