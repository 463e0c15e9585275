"""Rows about the runs in words: what they were, how quick the loop, how good the signals, what went wrong."""

from collections.abc import Sequence

from bci_app.report import Tables, distinct
from bci_app.report.drawing import percent
from bci_app.report.ledger import WHAT
from bci_app.report.page import Grid
from bci_app.report.words import number, who

SHOWN = 200
"""Lines of a long table that the page shows; its CSV has all."""


def runs(tables: Tables) -> Grid:
    """All runs, a line each."""
    head = ("Participant", "Run", "Map", "Moves", "Minutes", "Ended", "Policy", "Person", "Amplifier")
    rows = [
        (
            who(row),
            row["run"],
            row["map"],
            str(row["n_moves"]),
            number(row["seconds"] / 60),
            row["ended"],
            row["policy"] or "–",
            {True: "simulated", False: "real", None: "not known"}[row["simulated"]]
            + (f", speed {row['speed']:g}" if row["speed"] != 1 else ""),
            f"{row['amplifier']}, {row['n_channels']} channels, {row['sfreq_hz']:g} Hz",
        )
        for row in tables["runs"]
    ]
    is_fast = any(row["speed"] != 1 for row in tables["runs"])
    return Grid("All runs", head, rows, note="Speed: session seconds a real second." if is_fast else "")


def ledger(tables: Tables) -> list[Grid]:
    """Latencies, and what they are of."""
    rows = tables.get("latency", [])
    if not rows:
        return []
    lines = [
        (
            f"{who(row)}, {row['run']}",
            row["what"],
            str(row["n"]),
            *(number(row[f"{name}_ms"], 2) for name in ("min", "p50", "p95", "p99", "max")),
        )
        for row in rows
    ]
    head = ("Run", "What", "n", "Least", "Median", "95 %", "99 %", "Largest")
    known = distinct(rows, "what")
    return [
        Grid("Latency ledger, ms", head, lines),
        Grid("What is in the ledger", ("What", "Meaning"), [(name, WHAT[name]) for name in known]),
    ]


def signals(tables: Tables) -> list[Grid]:
    """Bad electrodes and rejected moves."""
    grids = []
    rows = tables.get("electrodes", [])
    if rows:
        head = ("Run", "Channel", "Faults", "Moves while it was bad")
        lines = [(f"{who(r)}, {r['run']}", r["channel"], r["faults"], percent(r["share_of_moves"])) for r in rows]
        grids.append(Grid("Bad electrodes", head, lines[:SHOWN], note=_more(lines)))
    rows = tables.get("rejected", [])
    if rows:
        headings = ("Run", "Moves", "Reason", "Number", "Of")
        moves = [(f"{who(r)}, {r['run']}", r["outcome"], r["reason"], str(r["n"]), str(r["of"])) for r in rows]
        note = "valid: epochs of a calibration that can be judged; judged: verdicts; rejected: epochs that can't be."
        grids.append(Grid("Moves and their epochs", headings, moves[:SHOWN], note=f"{note} {_more(moves)}".strip()))
    return grids


def events(tables: Tables, levels: Sequence[str], caption: str) -> Grid | None:
    """What went wrong, of these levels."""
    rows = [row for row in tables.get("events", []) if row["level"] in levels]
    lines = [
        (
            f"{who(row)}, {row['run']}",
            "–" if row["time_s"] is None else f"{row['time_s']:.1f}",
            row["kind"],
            row["level"],
            row["role"],
            row["text"],
        )
        for row in rows
    ]
    head = ("Run", "At (s)", "Kind", "Level", "Who says so", "What")
    note = f"Seconds of session time since the run's first message. {_more(lines)}".strip()
    return Grid(caption, head, lines[:SHOWN], note=note) if lines else None


def _more(lines: Sequence[object]) -> str:
    return f"The first {SHOWN} of {len(lines)}; the CSV has all." if len(lines) > SHOWN else ""
