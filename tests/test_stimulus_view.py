"""The picture, without a screen: what is where, at any size and on any map."""

from collections.abc import Iterator
from pathlib import Path

import pygame
import pytest

from bci_app.config import Config, StimulusConfig
from bci_app.errors import SetupError
from bci_app.gridworld import STEP, GridWorld, compile_map, load_map
from bci_app.protocol import MoveOnset, Verdict
from stimulus import view as module
from stimulus.paradigm import Paradigm
from stimulus.scene import Scene
from stimulus.view import Board, View, draw_backdrop, draw_scene

WORLDS = [load_map("open"), load_map("obstacles"), compile_map("..", "pair"), compile_map("...\n.#.\n...\n...", "tall")]
SIZES = [(200, 200), (333, 333), (880, 880), (1920, 1080), (600, 2000)]


@pytest.fixture
def screen() -> Iterator[View]:
    view = View(StimulusConfig(headless=True, window_px=440), "test")
    yield view
    view.close()


def picture(scene: Scene, size: tuple[int, int]) -> pygame.Surface:
    pygame.font.init()
    surface = pygame.Surface(size)
    draw_scene(surface, scene, draw_backdrop(size, scene.world))
    return surface


def colour(surface: pygame.Surface, world: GridWorld, cell: int, down: float = 0.5, right: float = 0.5) -> object:
    """The colour at a place in a cell, given in parts of it from its north-west corner."""
    square = Board.fit(surface.get_size(), world).square(*world.cells[cell].tolist())
    return tuple(surface.get_at((int(square.x + right * square.width), int(square.y + down * square.height))))[:3]


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: world.name)
@pytest.mark.parametrize("size", SIZES)
def test_agent_goal_and_free_cells_are_where_they_belong(world: GridWorld, size: tuple[int, int]) -> None:
    last = world.n_cells - 1
    surface = picture(Scene(world, 0, last), size)
    assert colour(surface, world, 0) == module.AGENT
    assert colour(surface, world, last) == module.GOAL
    assert all(colour(surface, world, cell) == module.BACKGROUND for cell in range(1, last))
    assert surface.get_at((0, 0))[:3] == module.BACKGROUND


@pytest.mark.parametrize("size", SIZES)
def test_grid_lines_and_obstacles(size: tuple[int, int]) -> None:
    world = load_map("obstacles")
    surface, board = draw_backdrop(size, world), Board.fit(size, world)
    layout = world.layout()
    for row in range(world.height):
        for column in range(world.width):
            square = board.square(row, column)
            inside = module.OBSTACLE if layout[row][column] == "#" else module.BACKGROUND
            assert surface.get_at(square.center)[:3] == inside
    corner = board.square(0, 0)
    assert surface.get_at((corner.centerx, corner.top))[:3] == module.GRID
    assert surface.get_at((corner.left, corner.centery))[:3] == module.GRID
    edge = board.inner(1, 2, 0.94)
    assert surface.get_at((edge.centerx, edge.top))[:3] == module.OBSTACLE_EDGE


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: world.name)
@pytest.mark.parametrize("size", SIZES)
def test_the_board_is_centred_and_inside_the_window(world: GridWorld, size: tuple[int, int]) -> None:
    board = Board.fit(size, world)
    whole = board.square(0, 0).union(board.square(world.height - 1, world.width - 1))
    assert pygame.Rect((0, 0), size).contains(whole)
    assert abs(whole.centerx - size[0] / 2) <= 1
    assert abs(whole.centery - size[1] / 2) <= 1
    assert max(whole.width / size[0], whole.height / size[1]) > 0.85


def test_the_countdown_fills_the_agent_clockwise() -> None:
    world = load_map("open")
    # A little from the centre: north-east, south-east, south-west, north-west.
    places = [(0.42, 0.58), (0.58, 0.58), (0.58, 0.42), (0.42, 0.42)]
    for quarters in range(5):
        surface = picture(Scene(world, 60, 0, countdown=quarters / 4), (880, 880))
        filled = [colour(surface, world, 60, *place) == module.COUNTDOWN for place in places]
        assert filled == [number < quarters for number in range(4)]
        assert colour(surface, world, 60, 0.2, 0.2) == module.AGENT


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("action", range(4))
def test_the_arrow_is_in_the_cell_left_and_points_to_the_new_one(action: int, size: tuple[int, int]) -> None:
    world = load_map("open")
    there = int(world.next_cell[60, action])
    surface = picture(Scene(world, there, 0, arrow=(60, action), moved=True), size)
    assert colour(surface, world, there) == module.AGENT
    assert colour(surface, world, 60) == module.ARROW
    down, right = STEP[action]

    def at(along: float, across: float) -> bool:
        """Whether the arrow covers a place; parts of a cell from its centre."""
        place = 0.5 + along * down + across * right, 0.5 + along * right + across * down
        return colour(surface, world, 60, *place) == module.ARROW

    assert at(0.36, 0.0)
    assert all(at(0.14, side) for side in (-0.13, 0.13))  # the head is wide
    assert not any(at(-0.25, side) for side in (-0.2, 0.2))  # the tail isn't


def test_the_agent_on_the_goal_leaves_the_goal_visible() -> None:
    world = load_map("open")
    surface = picture(Scene(world, 60, 60), (880, 880))
    assert colour(surface, world, 60) == module.AGENT
    assert colour(surface, world, 60, 0.1, 0.1) == module.GOAL


@pytest.mark.parametrize("size", SIZES)
def test_text_is_visible_centred_and_inside(size: tuple[int, int]) -> None:
    text = "Break\n2 of 5 blocks are done.\nPress space when you are ready, and not before that."
    surface = picture(Scene(WORLDS[0], text=text), size)
    box = pygame.mask.from_threshold(surface, module.TEXT, (60, 60, 60)).get_bounding_rects()
    whole = box[0].unionall(box[1:])
    assert whole.height > size[1] / 60
    assert abs(whole.centerx - size[0] / 2) < 0.02 * size[0] + 4
    assert abs(whole.centery - size[1] / 2) < 0.05 * size[1] + 8
    assert whole.left > 0
    assert whole.right < size[0]


def test_every_scene_of_a_run_draws(screen: View) -> None:
    config = Config.model_validate({"calibration": {"n_blocks": 2, "moves_per_block": 6, "eye_movements_s": 3}})
    paradigm = Paradigm.calibration(config, load_map("obstacles"), "s", "P", 1)
    now = 0.0
    while not paradigm.done:
        now += 0.1
        screen.draw(paradigm.scene(now))
        screen.flip()
        if paradigm.awaiting_flip:
            paradigm.flipped(now)
        for out in paradigm.take_messages():
            if isinstance(move := out.message, MoveOnset):
                told = {"session": "s", "episode": move.episode, "step": move.step, "clock_offset": 0.0}
                paradigm.take_verdict(Verdict(outcome="unjudged", **told), now)
        paradigm.start(now)
        paradigm.key_start(now)
        paradigm.update(now)
    screen.draw(paradigm.scene(now))


def test_save_writes_what_was_drawn(screen: View, tmp_path: Path) -> None:
    world = load_map("open")
    screen.draw(Scene(world, 60, 0))
    screen.flip()
    screen.save(tmp_path / "scene.png")
    assert colour(pygame.image.load(tmp_path / "scene.png"), world, 60) == module.AGENT


def test_another_map_gets_another_grid(screen: View, tmp_path: Path) -> None:
    for world in (load_map("open"), load_map("obstacles"), load_map("open")):
        screen.draw(Scene(world, 0, 5))
        screen.save(tmp_path / "scene.png")
        shown = pygame.image.load(tmp_path / "scene.png")
        obstacle = Board.fit(shown.get_size(), world).square(1, 2).center
        assert (shown.get_at(obstacle)[:3] == module.OBSTACLE) == (world.name == "obstacles")


def test_keys_and_the_close_button(screen: View) -> None:
    screen.events()
    for key in (pygame.K_SPACE, pygame.K_RETURN, pygame.K_p, pygame.K_q, pygame.K_ESCAPE):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert screen.events() == ["start", "start", "pause", "stop", "stop"]
    assert screen.events() == []


def test_a_window_nobody_can_see_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.raises(SetupError, match=r"stimulus\.headless"):
        View(StimulusConfig(), "test")
    pygame.quit()


def test_a_display_that_is_not_there_is_refused() -> None:
    with pytest.raises(SetupError, match="No display 9"):
        View(StimulusConfig(headless=True, display=9), "test")
    pygame.quit()


@pytest.mark.filterwarnings("ignore:no fast renderer")
@pytest.mark.parametrize("fullscreen", [False, True])
def test_a_window_opens_with_or_without_vsync(monkeypatch: pytest.MonkeyPatch, fullscreen: bool) -> None:
    # No screen here: SDL's own drivers for that take the same path as a real one.
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(module, "BLIND_DRIVERS", ())
    view = View(StimulusConfig(fullscreen=fullscreen), "test")
    view.draw(Scene(WORLDS[0], 0, 5))
    view.flip()
    view.close()
    view.close()
