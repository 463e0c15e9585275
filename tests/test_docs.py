"""The pages say what the program does: every message that docs/errors.md lists is said, and is tested."""

import re
from pathlib import Path

import pytest

from bci_app.cli import app

ROOT = Path(__file__).parents[1]
ROWS = re.findall(
    r"^\| (\d+) \| `(.+?)` \| .+? \| `(tests/\w+\.py)::(\w+)` \|$",
    (ROOT / "docs" / "errors.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)
SOURCES = " ".join(
    " ".join(path.read_text(encoding="utf-8").replace('"\n', "").split())
    for folder in ("bci_app", "stimulus", "decoder", "policy")
    for path in sorted((ROOT / folder).rglob("*.py"))
)
SAID = re.sub(r'f?" ?f?"', "", SOURCES)


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PICTURES = re.compile(r"!\[[^]]+\]\((.+?)\)|(?:src|srcset)=\"(.+?)\"")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_are_there_and_small(page: Path) -> None:
    for found in PICTURES.finditer(page.read_text(encoding="utf-8")):
        picture = page.parent / (found[1] or found[2])
        assert picture.stat().st_size < 150_000, picture


def test_every_verb_is_in_the_readme() -> None:
    verbs = {info.name or info.callback.__name__ for info in app.registered_commands if info.callback}
    told = re.findall(r"`([a-z0-9-]+)`", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert verbs - set(told) == set()


def test_the_table_is_read() -> None:
    assert len(ROWS) > 15


@pytest.mark.parametrize(("code", "says", "file", "name"), ROWS)
def test_a_message_in_the_table_is_said_and_tested(code: str, says: str, file: str, name: str) -> None:
    assert code in ("2", "3")
    assert says in SAID, says
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
