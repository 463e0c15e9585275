"""Text on the screen: as large as the screen asks for, in short lines; what doesn't fit is said beforehand."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pygame
import pygame.freetype

from bci_app.errors import SetupError
from stimulus.texts import BREAKS, Texts

BODY_PART = 1 / 20
"""Height of the letters' line as a part of the screen's: 1.4 degrees at 60 cm from a 24-inch screen (decided)."""
WIDEST = 26.0
"""Width of a line in letters' heights, at most: some 60 letters, which the eye follows without help (decided)."""
COLUMN_PART = 0.84
"""Width of a line as a part of the screen's, at most."""
HEADING, FOOT = 1.4, 0.55
"""Sizes of heading and foot, in letters' heights."""
PITCH, GAP = 1.25, 0.75
"""From line to line, and extra after a paragraph, in letters' heights."""
FILLED, FILLED_IN_BREAKS = 0.86, 0.56
"""Part of the screen's height that a text may fill: above the foot, and above the progress."""
SMALLEST = 8
"""Pixels of a letter's height below which nothing can be read."""


@dataclass(frozen=True)
class Line:
    """A line of text, and where its upper edge is, in pixels from the upper edge of the text."""

    text: str
    size: int
    top: int


def body_size(size: tuple[int, int]) -> int:
    """Height of the letters in pixels on a screen of (width, height)."""
    width, height = size
    return max(SMALLEST, round(min(height * BODY_PART, COLUMN_PART * width / WIDEST)))


def column(size: tuple[int, int]) -> int:
    """Width of the text in pixels."""
    return round(min(COLUMN_PART * size[0], WIDEST * body_size(size)))


def layout(text: str, size: tuple[int, int], font: str | None = None) -> tuple[list[Line], int]:
    """The lines of a heading and its paragraphs, and the height of all of them, in pixels."""
    body, widest = body_size(size), column(size)
    lines, top = [], 0.0
    for number, paragraph in enumerate(text.split("\n")):
        letters = round(body * HEADING) if number == 0 else body
        for line in _even(paragraph, letters, widest, font):
            lines.append(Line(line, letters, round(top)))
            top += PITCH * letters
        top += GAP * body
    return lines, round(top - GAP * body)


def draw(surface: pygame.Surface, text: str, colours: tuple[pygame.Color, pygame.Color], font: str | None) -> int:
    """Draw a text in the middle: its heading in the first colour; returns the pixel below it."""
    width, height = surface.get_size()
    lines, total = layout(text, (width, height), font)
    top = (height - total) // 2
    body = body_size((width, height))
    for line in lines:
        picture = lettering(font, line.size).render(line.text, True, colours[0 if line.size > body else 1])
        surface.blit(picture, picture.get_rect(midtop=(width // 2, top + line.top)))
    return top + total


def draw_foot(surface: pygame.Surface, text: str, colour: pygame.Color, font: str | None) -> None:
    """Draw a small line at the lower edge."""
    width, height = surface.get_size()
    size = max(SMALLEST, round(body_size((width, height)) * FOOT))
    picture = lettering(font, size).render(text, True, colour)
    surface.blit(picture, picture.get_rect(midbottom=(width // 2, height - size)))


@lru_cache(maxsize=16)
def lettering(font: str | None, size: int) -> pygame.font.Font:
    """A font so large that its letters' line is `size` pixels high. Raises SetupError for a file that is no font."""
    pygame.font.init()
    if font is not None and not Path(font).is_file():
        raise SetupError(f"There is no font {font}. Name a .ttf or .otf file in stimulus.font, or leave it out.")
    try:
        return pygame.font.Font(font, size)
    except pygame.error as error:
        raise SetupError(
            f"{font} can't be used as a font: {error}. Name a .ttf or .otf file in stimulus.font."
        ) from error


def check(texts: Texts, size: tuple[int, int], font: str | None) -> None:
    """Raise SetupError for a text that is too long for the screen, or has letters the font lacks."""
    pygame.freetype.init()
    lettering(font, SMALLEST)
    letters = pygame.freetype.Font(font, SMALLEST)  # pygame.font measures the box that stands for what is lacking
    for name, text in texts.by_name.items():
        shown = texts.filled(name, 88, 88) if name in BREAKS else text
        path = texts.where / f"{name}.txt"
        lacking = sorted({letter for letter in shown if not letter.isspace() and letters.get_metrics(letter) == [None]})
        if lacking:
            raise SetupError(
                f"The font lacks {' '.join(lacking[:10])} of the text {path}. Name a font file that has all its "
                "letters in stimulus.font."
            )
        _check_room(shown, path, name.startswith("foot"), size, font)


def _check_room(text: str, path: Path, is_foot: bool, size: tuple[int, int], font: str | None) -> None:
    width, height = size
    if is_foot:
        small = lettering(font, max(SMALLEST, round(body_size(size) * FOOT)))
        has_room = "\n" not in text and small.size(text)[0] <= COLUMN_PART * width
    else:
        part = FILLED_IN_BREAKS if path.stem in BREAKS else FILLED
        has_room = layout(text, size, font)[1] <= part * height
    if not has_room:
        raise SetupError(
            f"The text {path} is too long for the screen of {width} x {height} pixels: the letters would be too small, "
            "and are not made smaller. Shorten it."
        )


def _even(paragraph: str, size: int, widest: int, font: str | None) -> list[str]:
    """A paragraph in as few lines as need be, and those about equally long: no word stands alone."""
    lines = list(_wrapped(paragraph, size, widest, font))
    while len(lines) > 1:
        widest = round(widest * 0.97)
        narrower = list(_wrapped(paragraph, size, widest, font))
        if len(narrower) > len(lines):
            break
        lines = narrower
    return lines


def _wrapped(paragraph: str, size: int, widest: int, font: str | None) -> Iterator[str]:
    """A paragraph in lines; words too long for a line, and scripts without spaces, are broken where the line ends."""
    letters = lettering(font, size)
    line = ""
    for word in paragraph.split():
        longer = f"{line} {word}" if line else word
        if letters.size(longer)[0] <= widest:
            line = longer
            continue
        if line:
            yield line
        line = word
        while letters.size(line)[0] > widest:
            fits = max(1, next(n for n in range(len(line), 0, -1) if n == 1 or letters.size(line[:n])[0] <= widest))
            yield line[:fits]
            line = line[fits:]
    if line:
        yield line
