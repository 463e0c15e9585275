"""Draws a scene; the only code that knows pygame, and no rules of the experiment.

Everything is measured in parts of a cell or of the window, so any size and any map looks the same.
"""

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
# Windows tells a program that doesn't ask for it a smaller screen, and blows up what it draws there.
os.environ.setdefault("SDL_WINDOWS_DPI_AWARENESS", "permonitorv2")
# NVIDIA's driver waits for a flip by offering its turn, which is no waiting in real-time scheduling; this one sleeps.
os.environ.setdefault("__GL_YIELD", "USLEEP")
import pygame

from bci_app.config import StimulusConfig
from bci_app.errors import SetupError
from bci_app.gridworld import STEP, GridWorld
from stimulus import lettering
from stimulus.scene import Scene
from stimulus.texts import Texts

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
HEADING = (240, 240, 240)
FOOT = (120, 120, 120)
DONE, TO_DO = (150, 150, 150), (60, 60, 60)
DARK, LIGHT = (0, 0, 0), (255, 255, 255)
"""The photodiode's patch: as far apart as can be."""

KEYS: dict[int, Key] = {
    pygame.K_SPACE: "start",
    pygame.K_RETURN: "start",
    pygame.K_KP_ENTER: "start",
    pygame.K_ESCAPE: "stop",
    pygame.K_p: "pause",
}

PATCH_PART = 1 / 11
"""Side of the photodiode's patch as a part of the screen's shorter side: 27 mm on a 24-inch screen (decided)."""
Corner = Literal["top-left", "top-right", "bottom-left", "bottom-right"]

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
    def fit(cls, size: tuple[int, int], world: GridWorld, patch: int = 0) -> "Board":
        """The largest centred board of square cells with a margin around it, and with corners left for a patch."""
        cell = max(1, int(0.94 * min(size[0] / world.width, size[1] / world.height)))
        while cell > 1 and max(size[0] - cell * world.width, size[1] - cell * world.height) < 2 * patch:
            cell -= 1
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


def draw_scene(
    surface: pygame.Surface,
    scene: Scene,
    backdrop: pygame.Surface,
    corner: Corner | None = None,
    font: str | None = None,
) -> None:
    """Draw a scene over its backdrop (`draw_backdrop`), or its text on black; and the photodiode's patch."""
    if scene.text is not None:
        surface.fill(BACKGROUND)
        draw_text(surface, scene.text, font)
        if scene.progress is not None:
            draw_progress(surface, *scene.progress)
        if scene.foot:
            lettering.draw_foot(surface, scene.foot, pygame.Color(*FOOT), font)
    else:
        surface.blit(backdrop, (0, 0))
        draw_board(surface, scene, Board.fit(surface.get_size(), scene.world, patch_side(surface) if corner else 0))
    if corner is not None:
        pygame.draw.rect(surface, LIGHT if scene.light else DARK, patch(surface, corner))


def draw_board(surface: pygame.Surface, scene: Scene, board: Board) -> None:
    """Goal, agent, countdown and arrow."""
    if scene.goal is not None:
        pygame.draw.rect(surface, GOAL, board.inner(*_place(scene.world, scene.goal), 0.86))
    if scene.agent is not None:
        draw_agent(surface, scene, board)
    if scene.arrow is not None:
        cell, action = scene.arrow
        draw_arrow(surface, board, _place(scene.world, cell), STEP[action])


def draw_agent(surface: pygame.Surface, scene: Scene, board: Board) -> None:
    """The agent with its countdown: all that changes while that runs."""
    if scene.agent is None:
        return
    square = board.inner(*_place(scene.world, scene.agent), 0.7)
    pygame.draw.rect(surface, AGENT, square)
    if scene.countdown is not None:
        draw_pie(surface, square, scene.countdown)


def draw_progress(surface: pygame.Surface, done: int, total: int) -> None:
    """A row of boxes, filled for what is done, between text and foot."""
    width, height = surface.get_size()
    body = lettering.body_size((width, height))
    pitch = min(2.2 * body, 0.7 * width / max(1, total))
    side = round(0.7 * min(pitch, 1.6 * body))
    left, top = round(width / 2 - pitch * (total - 1) / 2 - side / 2), round(height - 4.2 * body)
    for number in range(total):
        box = pygame.Rect(left + round(number * pitch), top, side, side)
        pygame.draw.rect(surface, DONE if number < done else TO_DO, box, 0 if number < done else max(1, side // 12))


def patch_side(surface: pygame.Surface) -> int:
    """Pixels of the photodiode's patch."""
    return round(min(surface.get_size()) * PATCH_PART)


def patch(surface: pygame.Surface, corner: Corner) -> pygame.Rect:
    """Where the photodiode's patch is."""
    side, (width, height) = patch_side(surface), surface.get_size()
    return pygame.Rect(width - side if "right" in corner else 0, height - side if "bottom" in corner else 0, side, side)


def draw_backdrop(size: tuple[int, int], world: GridWorld, corner: Corner | None = None) -> pygame.Surface:
    """The empty grid with its obstacles."""
    surface = pygame.Surface(size)
    surface.fill(BACKGROUND)
    board = Board.fit(size, world, patch_side(surface) if corner else 0)
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


def draw_text(surface: pygame.Surface, text: str, font: str | None = None) -> None:
    """A heading and paragraphs in the middle, as large as is calm."""
    lettering.draw(surface, text, (pygame.Color(*HEADING), pygame.Color(*TEXT)), font)


class View:
    """The window, or without a screen (`headless`) a picture in memory.

    Whatever is on the screen is drawn whole before it is shown by one flip, so that nothing flickers.

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
        self._corner, self._font = config.photodiode, config.font
        self._backdrop: tuple[str, tuple[int, int], pygame.Surface] | None = None
        self._drawn: Scene | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._surface.get_size()

    @property
    def driver(self) -> str:
        """How the picture gets to the screen, in SDL's word."""
        return pygame.display.get_driver()

    @property
    def refresh_hz(self) -> float | None:
        """Rate of the display as the system tells it; None where it doesn't."""
        return float(pygame.display.get_current_refresh_rate()) or None

    @property
    def may_be_paced(self) -> bool:
        """Whether flips are said to wait for the screen. Only measuring tells whether they do."""
        return self.driver not in BLIND_DRIVERS and pygame.display.is_vsync()

    def check(self, texts: Texts) -> None:
        """Raise SetupError for a text that doesn't fit on this screen or that its font can't write."""
        lettering.check(texts, self.size, self._font)

    def draw(self, scene: Scene) -> None:
        """Draw the scene; `flip` shows it. While the countdown runs nothing but the agent is drawn again."""
        before, self._drawn = self._drawn, scene
        if before is not None and scene.countdown is not None and replace(before, countdown=scene.countdown) == scene:
            side = patch_side(self._surface) if self._corner else 0
            draw_agent(self._surface, scene, Board.fit(self.size, scene.world, side))
            return
        draw_scene(self._surface, scene, self._grid(scene.world), self._corner, self._font)

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

    def press(self, key: Key) -> None:
        """Put a key into the queue, as if it were pressed."""
        code = next(code for code, meaning in KEYS.items() if meaning == key)
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=code))

    def save(self, path: Path | str) -> None:
        """Write what was drawn last as a PNG file."""
        pygame.image.save(self._surface, str(path))

    def close(self) -> None:
        """Close the window; may be called twice."""
        lettering.lettering.cache_clear()  # fonts don't outlive pygame
        pygame.quit()

    def _grid(self, world: GridWorld) -> pygame.Surface:
        """The backdrop, drawn again only for another map or window size."""
        size = self._surface.get_size()
        if self._backdrop is None or self._backdrop[:2] != (world.digest, size):
            self._backdrop = (world.digest, size, draw_backdrop(size, world, self._corner))
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
