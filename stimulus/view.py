"""Draws a scene; the only code that knows pygame, and no rules of the experiment.

Everything is measured in parts of a cell or of the window, so any size and any map looks the same.
"""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
import pygame

from bci_app.config import StimulusConfig
from bci_app.errors import SetupError
from bci_app.gridworld import STEP, GridWorld
from stimulus.scene import Scene

Key = Literal["start", "stop", "pause"]

# Paper V.A.1: black background, grey grid, red agent, green goal. The shades are ours.
BACKGROUND = (0, 0, 0)
GRID = (85, 85, 85)
OBSTACLE = (52, 52, 52)
OBSTACLE_EDGE = (135, 135, 135)
AGENT = (214, 40, 40)
COUNTDOWN = (70, 8, 8)
GOAL = (40, 175, 70)
ARROW = (225, 225, 225)
TEXT = (205, 205, 205)

KEYS: dict[int, Key] = {
    pygame.K_SPACE: "start",
    pygame.K_RETURN: "start",
    pygame.K_KP_ENTER: "start",
    pygame.K_ESCAPE: "stop",
    pygame.K_p: "pause",
}

BLIND_DRIVERS = ("dummy", "offscreen")
"""What SDL falls back to without a screen, and says nothing: the person would sit before a window nobody sees."""
NO_SCREEN = "Expected a screen; connect one, or do without one by --headless (stimulus.headless in the configuration)."


@dataclass(frozen=True)
class Board:
    """Where the cells of a map are on a surface. All in pixels."""

    left: int
    top: int
    cell: int

    @classmethod
    def fit(cls, size: tuple[int, int], world: GridWorld) -> "Board":
        """The largest centred board of square cells with a margin around it."""
        cell = max(1, int(0.94 * min(size[0] / world.width, size[1] / world.height)))
        return cls((size[0] - cell * world.width) // 2, (size[1] - cell * world.height) // 2, cell)

    def square(self, row: int, column: int) -> pygame.Rect:
        """The pixels of a cell."""
        return pygame.Rect(self.left + column * self.cell, self.top + row * self.cell, self.cell, self.cell)

    def inner(self, row: int, column: int, part: float) -> pygame.Rect:
        """A centred square that is a part of a cell."""
        square = self.square(row, column)
        margin = round(self.cell * (1 - part) / 2)
        return square.inflate(-2 * margin, -2 * margin)

    @property
    def line(self) -> int:
        """Width of a line."""
        return max(1, round(self.cell / 40))


def draw_scene(surface: pygame.Surface, scene: Scene, backdrop: pygame.Surface) -> None:
    """Draw a scene over its backdrop (`draw_backdrop`), or its text on black."""
    if scene.text is not None:
        surface.fill(BACKGROUND)
        draw_text(surface, scene.text)
        return
    surface.blit(backdrop, (0, 0))
    board = Board.fit(surface.get_size(), scene.world)
    if scene.goal is not None:
        pygame.draw.rect(surface, GOAL, board.inner(*_place(scene.world, scene.goal), 0.86))
    if scene.agent is not None:
        square = board.inner(*_place(scene.world, scene.agent), 0.7)
        pygame.draw.rect(surface, AGENT, square)
        if scene.countdown is not None:
            draw_pie(surface, square, scene.countdown)
    if scene.arrow is not None:
        cell, action = scene.arrow
        draw_arrow(surface, board, _place(scene.world, cell), STEP[action])


def draw_backdrop(size: tuple[int, int], world: GridWorld) -> pygame.Surface:
    """The empty grid with its obstacles."""
    surface = pygame.Surface(size)
    surface.fill(BACKGROUND)
    board = Board.fit(size, world)
    free = {(row, column) for row, column in world.cells.tolist()}
    places = [(row, column) for row in range(world.height) for column in range(world.width)]
    for place in places:
        # One line further to the right and down, so that neighbours share a line instead of doubling it.
        edge = board.square(*place).inflate(board.line, board.line)
        pygame.draw.rect(surface, GRID, edge, board.line)
    for place in places:
        if place not in free:
            pygame.draw.rect(surface, OBSTACLE, board.inner(*place, 0.94))
            pygame.draw.rect(surface, OBSTACLE_EDGE, board.inner(*place, 0.94), board.line)
    return surface


def draw_pie(surface: pygame.Surface, square: pygame.Rect, part: float) -> None:
    """The countdown: a dark disc inside the agent that fills clockwise from the top.

    It only darkens some of the agent, so that its end changes the light on the retina little beside the jump.
    """
    radius = 0.36 * square.width
    centre = pygame.Vector2(square.center)
    pygame.draw.circle(surface, COUNTDOWN, centre, radius, max(1, round(radius / 10)))
    turns = math.ceil(90 * part)
    if turns:
        rim = [centre + radius * pygame.Vector2(0, -1).rotate(360 * part * turn / turns) for turn in range(turns + 1)]
        pygame.draw.polygon(surface, COUNTDOWN, [centre, *rim])


def draw_arrow(surface: pygame.Surface, board: Board, place: tuple[int, int], step: tuple[int, int]) -> None:
    """An arrow in the cell the agent left, its tip at the border to the cell it went to."""
    along = pygame.Vector2(step[1], step[0]) * board.cell
    across = along.rotate(90)
    centre = pygame.Vector2(board.square(*place).center)
    outline = ((-0.34, 0.07), (0.08, 0.07), (0.08, 0.22), (0.45, 0.0), (0.08, -0.22), (0.08, -0.07), (-0.34, -0.07))
    pygame.draw.polygon(surface, ARROW, [centre + x * along + y * across for x, y in outline])


def draw_text(surface: pygame.Surface, text: str) -> None:
    """Lines of text in the centre, as large as is calm and fits. pygame brings the font."""
    lines = text.split("\n")
    width, height = surface.get_size()
    size = max(8, min(width, height) // 20)
    widest = max(pygame.font.Font(None, size).size(line)[0] for line in lines)
    font = pygame.font.Font(None, max(8, min(size, size * int(0.9 * width) // max(1, widest))))
    pitch = round(1.5 * font.get_linesize())
    top = (height - pitch * len(lines)) // 2
    for number, line in enumerate(lines):
        picture = font.render(line, True, TEXT)
        surface.blit(picture, picture.get_rect(center=(width // 2, top + pitch * number + pitch // 2)))


class View:
    """The window, or without a screen (`headless`) a picture in memory.

    Raises SetupError when there is no such display or no screen at all.
    """

    def __init__(self, config: StimulusConfig, title: str) -> None:
        if config.headless:
            os.environ["SDL_VIDEODRIVER"] = "dummy"
        try:
            pygame.display.init()
            pygame.font.init()
            self._surface = _open(config)
        except pygame.error as error:
            raise SetupError(f"Can't open the stimulus window: {error}. {NO_SCREEN}") from error
        pygame.display.set_caption(title)
        pygame.mouse.set_visible(not config.fullscreen)
        self._backdrop: tuple[str, tuple[int, int], pygame.Surface] | None = None

    def draw(self, scene: Scene) -> None:
        """Draw the scene; `flip` shows it."""
        draw_scene(self._surface, scene, self._grid(scene.world))

    def flip(self) -> None:
        """Show what was drawn. With vsync it returns at the screen's refresh."""
        pygame.display.flip()

    def events(self) -> list[Key]:
        """What was asked for by keys or the window's close button since the last call."""
        asked: list[Key] = []
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                asked.append("stop")
            elif event.type == pygame.KEYDOWN and event.key in KEYS:
                asked.append(KEYS[event.key])
        return asked

    def save(self, path: Path | str) -> None:
        """Write what was drawn last as a PNG file."""
        pygame.image.save(self._surface, str(path))

    def close(self) -> None:
        """Close the window; may be called twice."""
        pygame.quit()

    def _grid(self, world: GridWorld) -> pygame.Surface:
        """The backdrop, drawn again only for another map or window size."""
        size = self._surface.get_size()
        if self._backdrop is None or self._backdrop[:2] != (world.digest, size):
            self._backdrop = (world.digest, size, draw_backdrop(size, world))
        return self._backdrop[2]


def _open(config: StimulusConfig) -> pygame.Surface:
    driver = pygame.display.get_driver()
    if driver in BLIND_DRIVERS and not config.headless:
        raise SetupError(f"Can't open the stimulus window: SDL found only its '{driver}' driver. {NO_SCREEN}")
    desktops = pygame.display.get_desktop_sizes()
    if config.display >= len(desktops):
        raise SetupError(
            f"No display {config.display}: found {len(desktops)}, numbered from 0. Change stimulus.display."
        )
    if config.headless:
        return pygame.display.set_mode((config.window_px, config.window_px))
    size = desktops[config.display] if config.fullscreen else (config.window_px, config.window_px)
    flags = pygame.SCALED | (pygame.FULLSCREEN if config.fullscreen else 0)
    try:
        # SDL2 grants vsync only to a scaled (or OpenGL) surface, and refuses it on some drivers.
        return pygame.display.set_mode(size, flags, display=config.display, vsync=1)
    except pygame.error:
        return pygame.display.set_mode(size, flags & ~pygame.SCALED, display=config.display)


def _place(world: GridWorld, cell: int) -> tuple[int, int]:
    row, column = world.cells[cell].tolist()
    return row, column
