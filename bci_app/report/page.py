"""The report as one HTML file that needs nothing else: no script, no network, figures inside.

Our own template rather than mne.Report, which brings a megabyte of scripts, its own order of headings and colours, and
can't say what a figure shows to somebody who doesn't see it. All it would add here is sections.
"""

import re
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version

from jinja2 import Environment, PackageLoader

from bci_app.report.drawing import Written

METADATA = re.compile(rb"<\?xml.*?\?>|<!DOCTYPE.*?>|<metadata>.*?</metadata>", re.DOTALL)
"""Of an SVG, what a page doesn't need: it names pages on the network, though nobody fetches them."""


@dataclass(frozen=True)
class Grid:
    """A table for people: words already. The first cell of a row is its heading.

    Attributes
    ----------
    caption : what it is.
    head : headings of the columns.
    rows : cells; ``quiet`` tells by their place which rows are somebody else's numbers.
    note : how to read it.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    quiet: frozenset[int] = frozenset()
    note: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes
    ----------
    title : its heading.
    text : sentences before everything else.
    shown : figures and tables, in order.
    folded : the same, to be unfolded by the reader: (what it is, figures and tables).
    """

    title: str
    text: Sequence[str] = ()
    shown: Sequence[Written | Grid] = ()
    folded: Sequence[tuple[str, Sequence[Written | Grid]]] = field(default_factory=tuple)

    @property
    def anchor(self) -> str:
        """Its name in links."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def render(title: str, summary: Sequence[str], sections: Sequence[Section]) -> str:
    """The whole page."""
    environment = Environment(
        loader=PackageLoader("bci_app.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["data_uri"] = data_uri
    environment.tests["figure"] = lambda item: isinstance(item, Written)
    template = environment.get_template("report.html.jinja")
    return template.render(title=title, summary=summary, sections=sections, made=made(datetime.now().astimezone()))


def made(moment: datetime) -> str:
    """When the page was made, and by what."""
    return f"Made on {moment:%Y-%m-%d at %H:%M (%Z)} by bci-app {version('errp-bci')}."


def data_uri(svg: bytes) -> str:
    """A figure as the source of an image: what is in one figure can't mix with what is in another."""
    return "data:image/svg+xml;base64," + b64encode(METADATA.sub(b"", svg)).decode("ascii")
