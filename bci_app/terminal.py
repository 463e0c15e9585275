"""How a verb shows progress and results: words for people, one JSON object for programs."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.table import Table

from bci_app.progress import Progress


@contextmanager
def if_interrupted(then: str) -> Iterator[None]:
    """Say after Ctrl-C what to do with what was recorded until then, if anything was."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        if interrupt.args:
            interrupt.args = (f"{interrupt.args[0]} {then}",)
        raise


def finish(result: dict[str, Any], as_json: bool, hint: str = "") -> None:
    """Print a result, and what to do next."""
    if as_json:
        print_json(result)
        return
    console = Console()
    for line in lines(result):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if hint:
        console.print(hint, style="dim", markup=False, soft_wrap=True)


def lines(result: dict[str, Any], indent: str = "") -> Iterator[str]:
    """A result for people: estimates with their intervals, sentences a line each; what is empty is left out."""
    plain = {name: value for name, value in result.items() if _is_plain(value) and value not in (None, "", (), [], {})}
    if indent and plain:
        yield indent + ", ".join(f"{name} {_short(value)}" for name, value in plain.items())
    for name, value in result.items():
        if name in plain:
            if not indent:
                yield f"{name}: {_short(value)}"
        elif isinstance(value, dict) and "sentence" in value:
            yield f"{indent}{value['sentence']}"
        elif isinstance(value, dict) and value:
            yield f"{indent}{name}:"
            yield from lines(value, f"{indent}  ")
        elif isinstance(value, list | tuple) and value:
            texts = [item for item in value if isinstance(item, str)]
            yield f"{indent}{name}:" + ("" if texts else f" {len(value)} rows, see --json")
            yield from (f"{indent}  {text}" for text in texts)


def _is_plain(value: Any) -> bool:
    """Whether it fits into a line with others: a number, a word, an estimate, an interval."""
    if isinstance(value, dict):
        return set(value) == {"value", "low", "high"}
    if isinstance(value, list | tuple):
        return len(value) == 2 and all(isinstance(item, float) for item in value)
    return True


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return f"{value['value']:.3f} [{value['low']:.3f}, {value['high']:.3f}]"
    if isinstance(value, list | tuple):
        return f"[{value[0]:.3f}, {value[1]:.3f}]"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def print_json(result: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Print a result on stdout as JSON."""
    typer.echo(json.dumps(result, indent=2))


def show_settings(settings: Iterable[tuple[str, str, str]]) -> None:
    """A table of (name, value, what it is)."""
    table = Table("setting", "value", "what it is")
    for name, value, what in settings:
        table.add_row(escape(name), escape(value), escape(what))
    Console().print(table)


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
