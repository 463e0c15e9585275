"""How a verb shows progress and results: words for people, one JSON object for programs."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from bci_app.progress import Progress


def finish(result: dict[str, Any], as_json: bool, hint: str = "") -> None:
    """Print a result, and what to do next."""
    if as_json:
        print_json(result)
        return
    console = Console()
    for key, value in result.items():
        if isinstance(value, dict):
            value = ", ".join(f"{name} {_short(item)}" for name, item in value.items() if not isinstance(item, dict))
        console.print(f"{key}: {value}", markup=False, highlight=False, soft_wrap=True)
    if hint:
        console.print(hint, style="dim", markup=False, soft_wrap=True)


def _short(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def print_json(result: dict[str, Any]) -> None:
    """Print one JSON object on stdout."""
    typer.echo(json.dumps(result, indent=2))


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress]:
    """A bar with a time to go on stderr; none with --json or where nobody watches."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with RichProgress(*columns, console=console, disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None)

        def report(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        yield report
