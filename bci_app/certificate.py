"""The page that says whether this machine may run this experiment: for the terminal and as one HTML file."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from rich.console import Console
from rich.markup import escape as plain
from rich.table import Table

from bci_app.certification import Finding, may_run
from bci_app.errors import SetupError

WORDS = {True: "yes", False: "NO", None: "not measured"}
# Blue, vermilion and grey of Okabe and Ito (2008): told apart by the colour-blind, and each has its word besides.
STYLE = """
:root { color-scheme: light dark }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem }
p.verdict { font-size: 1.2rem; font-weight: 600; padding: .6rem 1rem; border-left: .5rem solid }
p.verdict.yes { border-left-color: #0072b2 } p.verdict.no { border-left-color: #d55e00 }
table { border-collapse: collapse; width: 100%; font-size: .9rem; line-height: 1.35 }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem; border-bottom: 1px solid #8886 }
td:first-child { border-left: .5rem solid; white-space: nowrap; font-weight: 600 }
td:first-child.yes { border-left-color: #0072b2 } td:first-child.no { border-left-color: #d55e00 }
td:first-child.none { border-left-color: #777 } small { opacity: .8 }
dl { font-size: .9rem } dt { font-weight: 600 } dd { margin: 0 0 .3rem 1rem }
@media print { body { margin: 0; font-size: 11px } }
"""


def sentence(findings: Sequence[Finding]) -> str:
    """The answer."""
    if not may_run(findings):
        failed = ", ".join(finding.what for finding in findings if finding.ok is False)
        return f"This machine may not run this experiment as it is. Beyond its limit: {failed}."
    unknown = ", ".join(finding.what for finding in findings if finding.ok is None)
    but = f" Not measured: {unknown}." if unknown else ""
    return f"This machine may run this experiment.{but}"


def show(findings: Sequence[Finding], about: Mapping[str, str], console: Console) -> None:
    """The findings as a table, and what was measured."""
    table = Table("", "what", "found, limit and why", title="bci-app certify", show_lines=True)
    styles = {True: "[green]yes[/]", False: "[red]NO[/]", None: "[dim]not measured[/]"}
    for each in findings:
        limit = f"Limit: {each.limit}, for {each.why}." if each.limit else f"{each.why}."
        table.add_row(styles[each.ok], each.what, f"{plain(each.found)}\n[dim]{plain(limit)}[/]")
    console.print(table)
    for name, value in about.items():
        console.print(f"{name}: {plain(value)}", soft_wrap=True, highlight=False)
    console.print(sentence(findings), soft_wrap=True)


def html(findings: Sequence[Finding], about: Mapping[str, str]) -> str:
    """One page that needs nothing else. `about`: what was measured where, and when."""
    kind = {True: "yes", False: "no", None: "none"}
    rows = "".join(
        f'<tr><td class="{kind[each.ok]}">{WORDS[each.ok]}</td><td>{escape(each.what)}</td>'
        f"<td>{escape(each.found)}</td><td>{escape(each.limit)}</td><td><small>{escape(each.why)}</small></td></tr>\n"
        for each in findings
    )
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in about.items())
    good = "yes" if may_run(findings) else "no"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>bci-app certify</title><style>{STYLE}</style></head><body><main><h1>May this machine run this "
        f'experiment?</h1><p class="verdict {good}">{escape(sentence(findings))}</p><table><thead><tr><th>within its '
        f"limit</th><th>what</th><th>found</th><th>limit</th><th>why</th></tr></thead><tbody>\n{rows}</tbody></table>"
        f"<h2>Measured</h2><dl>{facts}</dl></main></body></html>\n"
    )


def make_room(path: Path) -> None:
    """Make the page's folder, before anybody waits for what can't be written. Raises SetupError where it can't be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError(f"Can't write {path}: {error.strerror}. Choose another file with --out.") from error


def write(text: str, path: Path) -> None:
    """Write the page. Nothing is written over: SetupError where it is there already."""
    make_room(path)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise SetupError(f"Can't write {path}: {error.strerror}. Choose another file with --out.") from error
