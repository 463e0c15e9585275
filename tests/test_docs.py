"""The pages say what the program does: every message that docs/errors.md lists is said, and is tested."""

import re
from pathlib import Path

import pytest

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


def test_the_table_is_read() -> None:
    assert len(ROWS) > 15


@pytest.mark.parametrize(("code", "says", "file", "name"), ROWS)
def test_a_message_in_the_table_is_said_and_tested(code: str, says: str, file: str, name: str) -> None:
    assert code in ("2", "3")
    assert says in SAID, says
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
