"""What the participant reads: one text file for each screen, so that a lab can translate them.

A folder of texts holds ``NAME.txt`` for each of `NAMES`: UTF-8, the first line a heading, every other line a paragraph.
"""

import string
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bci_app.errors import SetupError

SHIPPED = Path(__file__).parent / "texts"
BREAKS = ("break", "break_over", "break_online")
"""Those that say ``{done}`` and ``{total}``."""
EYE_MOVEMENTS = {"blink": "Blink", "look_sideways": "Look left and right", "look_up_down": "Look up and down"}
"""Screens of the eye movements, in order, and what a recording calls them."""
PAGES = ("calibration", "practice", "practice_over", "eyes", "online")
NAMES = (*PAGES, *BREAKS, *EYE_MOVEMENTS, "welcome", "pause", "waiting", "end", "stopped", "foot_pause")


@dataclass(frozen=True)
class Texts:
    """The texts by name, as they are in their files."""

    where: Path
    by_name: dict[str, str]

    def __getitem__(self, name: str) -> str:
        return self.by_name[name]

    def filled(self, name: str, done: int, total: int) -> str:
        """A break's text."""
        return self.by_name[name].format(done=done, total=total)


@cache
def english() -> Texts:
    """The texts we ship, which are the default."""
    return load("en")


def load(where: str) -> Texts:
    """The texts of a language that is shipped, or of a folder.

    Raises SetupError for a folder or a text that isn't there, is empty or no UTF-8, or has a {place} nothing fills.
    """
    folder = SHIPPED / where if (SHIPPED / where).is_dir() and where not in ("", ".", "..") else Path(where)
    if not folder.is_dir():
        languages = ", ".join(sorted(path.name for path in SHIPPED.iterdir() if path.is_dir()))
        raise SetupError(
            f"stimulus.texts = '{where}' is neither a language ({languages}) nor a folder of texts. Copy "
            f"{SHIPPED / 'en'} to a folder of yours, translate it, and name that."
        )
    missing = [f"{name}.txt" for name in NAMES if not (folder / f"{name}.txt").is_file()]
    if missing:
        raise SetupError(
            f"The folder of texts {folder} lacks {', '.join(missing)}. Every screen needs its text; copy what is "
            f"missing from {SHIPPED / 'en'} and translate them."
        )
    return Texts(folder, {name: _read(folder / f"{name}.txt", name in BREAKS) for name in NAMES})


def _read(path: Path, is_break: bool) -> str:
    try:
        text = path.read_text(encoding="utf-8-sig").strip()  # Windows editors put a byte-order mark in front
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"Can't read the text {path}: {error}. Save it as UTF-8.") from error
    if not text:
        raise SetupError(f"The text {path} is empty. Write what the participant should read there.")
    if is_break:
        try:
            places = {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}
        except ValueError as error:
            raise SetupError(f"The text {path} has a brace too many or too few: {error}. Mend it.") from error
        if not places <= {"done", "total"}:
            raise SetupError(
                f"The text {path} may have the places {{done}} and {{total}}; found "
                f"{', '.join(sorted(places - {'done', 'total'}))}."
            )
    return "\n".join(line.strip() for line in text.splitlines() if line.strip())
