"""Tables over all participants of a report: the paper's, and averages and tests over participants."""

from bci_app.report import Tables, areas, clusters, distinct, erp, in_a_row, online, those

ORDER = (
    "runs",
    "table_1",
    "table_2",
    "table_a",
    "scores",
    "confusion",
    "roc",
    "reliability",
    "learning_curve",
    "by_distance",
    "area_accuracy",
    "area_test",
    "erp",
    "erp_average",
    "erp_peaks",
    "erp_maps",
    "erp_clusters",
    "errors_in_a_row",
    "errors_in_a_row_trend",
    "waveforms",
    "latency",
    "electrodes",
    "rejected",
    "events",
    "episodes",
    "moves",
    "maps",
)
"""All tables a report may have, as `docs/report.md` lists them; ``table_a`` stands for one a map."""


def complete(tables: Tables) -> Tables:
    """Add the tables that need all participants to those of each put together.

    Parameters
    ----------
    tables : of `report.visits.Seen.tables`, of one participant or of many.
    """
    runs, episodes = tables.get("runs", []), those(tables.get("episodes", []), task="online")
    found: Tables = {name: list(rows) for name, rows in tables.items()}
    found["maps"] = [dict(items) for items in dict.fromkeys(tuple(row.items()) for row in tables.get("maps", []))]
    found["table_1"] = online.table_one(tables.get("scores", []), runs, tables.get("moves", []))
    if episodes:
        found["table_2"] = online.table_two(episodes, runs)
        found["by_distance"] = online.by_distance(episodes)
        for name in distinct(episodes, "map"):
            found[f"table_a_{name}"] = online.table_a(episodes, runs, name)
    found["area_test"] = [*tables.get("area_test", []), *areas.group_rows(tables.get("area_test", []))]
    means = tables.get("erp", [])
    for source in distinct(means, "source"):
        mine = those(means, source=source)
        average = erp.grand_average(mine, ("source", "area"))
        if average == mine:
            continue
        where = {"participant": average[0]["participant"], "visit": average[0]["visit"], "source": source}
        found.setdefault("erp_average", []).extend(average)
        found["erp_peaks"] += erp.peak_rows(those(average, area="all"), **where)
        found["erp_clusters"] += clusters.group_cluster_rows(mine, **where)
    levels, trends = tables.get("errors_in_a_row", []), tables.get("errors_in_a_row_trend", [])
    for source in distinct(levels, "source"):
        mine = those(levels, source=source)
        average = in_a_row.group_levels(mine)
        found["errors_in_a_row"] += average if average != mine else []
    found["errors_in_a_row_trend"] = [*trends, *in_a_row.group_trend(trends)]
    return found
