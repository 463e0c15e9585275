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
    found["table_1"] = online.table_one(tables.get("scores", []), runs)
    if episodes:
        found["table_2"] = online.table_two(episodes, runs)
        found["by_distance"] = online.by_distance(episodes)
        for name in distinct(episodes, "map"):
            found[f"table_a_{name}"] = online.table_a(episodes, runs, name)
    found["area_test"] = [*tables.get("area_test", []), *areas.group_rows(tables.get("area_test", []))]
    means = tables.get("erp", [])
    people = len(distinct(means, "participant"))
    if people > 1:
        found["erp_average"] = erp.grand_average(means, ("source", "area"))
        for source in distinct(means, "source"):
            where = {"participant": "all", "visit": None, "source": source}
            everywhere = those(found["erp_average"], source=source, area="all")
            found["erp_peaks"] += erp.peak_rows(everywhere, **where)
            found["erp_clusters"] += clusters.group_cluster_rows(those(means, source=source), **where)
        found["errors_in_a_row"] += in_a_row.group_levels(tables.get("errors_in_a_row", []))
        found["errors_in_a_row_trend"] += in_a_row.group_trend(tables.get("errors_in_a_row_trend", []))
    return found
