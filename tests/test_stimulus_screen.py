"""What is calm about the screen, and what is measured of it."""

from collections.abc import Iterator

import numpy as np
import pygame
import pytest
from numpy.typing import NDArray

from bci_app.config import Config, StimulusConfig, changed
from bci_app.gridworld import compile_map, load_map
from stimulus import screen as module
from stimulus import view as views
from stimulus.guide import guide
from stimulus.paradigm import Paradigm
from stimulus.scene import Scene
from stimulus.view import Board, View, draw_backdrop, draw_scene, patch

OPEN = load_map("open")
CORNERS = ("top-left", "top-right", "bottom-left", "bottom-right")


@pytest.fixture
def window() -> Iterator[View]:
    view = View(StimulusConfig(headless=True, window_px=330), "test")
    yield view
    view.close()


def pixels(view: View) -> NDArray[np.uint8]:
    return pygame.surfarray.array3d(view._surface)


def test_while_the_countdown_runs_nothing_but_the_agent_changes(window: View) -> None:
    window.draw(Scene(OPEN, 60, 0, countdown=0.0))
    first = pixels(window)
    square = Board.fit(window.size, OPEN).inner(*OPEN.cells[60].tolist(), 0.7)
    for part in np.linspace(0, 1, 61):
        window.draw(Scene(OPEN, 60, 0, countdown=float(part)))
        shown = pixels(window)
        whole = pygame.Surface(window.size)
        draw_scene(whole, Scene(OPEN, 60, 0, countdown=float(part)), draw_backdrop(window.size, OPEN))
        assert (shown == pygame.surfarray.array3d(whole)).all()  # drawn in part, and just as if drawn whole
        outside = (shown != first).any(axis=2)
        outside[square.left : square.right, square.top : square.bottom] = False
        assert not outside.any()


def test_a_picture_is_the_same_whatever_was_shown_before(window: View) -> None:
    """Nothing is left of a page, a break or another map."""
    config = changed(Config(), {"calibration": {"n_blocks": 2, "moves_per_block": 2, "eye_movements_s": 3}})
    paradigm = Paradigm.calibration(config, OPEN, "s", "P", 1, guide=guide(config, "calibration"))
    scenes = [Scene(OPEN, 60, 0, countdown=0.4), Scene(load_map("obstacles"), 0, 9), paradigm.scene(0.0)]
    paradigm.start(0.0)
    scenes.append(paradigm.scene(0.0))
    fresh = []
    for scene in scenes:
        whole = pygame.Surface(window.size)
        draw_scene(whole, scene, draw_backdrop(window.size, scene.world))
        fresh.append(pygame.surfarray.array3d(whole))
    for first in range(len(scenes)):
        for second in range(len(scenes)):
            window.draw(scenes[first])
            window.draw(scenes[second])
            assert (pixels(window) == fresh[second]).all()


@pytest.mark.parametrize("corner", CORNERS)
@pytest.mark.parametrize("size", [(330, 330), (640, 360), (360, 640), (1920, 1080)])
def test_the_patch_is_black_or_white_in_its_corner_and_touches_nothing(
    corner: views.Corner, size: tuple[int, int]
) -> None:
    for world in (OPEN, compile_map("..", "pair"), compile_map("...\n.#.\n...\n...", "tall")):
        backdrop = draw_backdrop(size, world, corner)
        for light in (False, True):
            surface = pygame.Surface(size)
            draw_scene(surface, Scene(world, 0, 1, light=light), backdrop, corner)
            place = patch(surface, corner)
            colours = {
                tuple(surface.get_at(at))[:3]
                for at in (place.topleft, place.center, (place.right - 1, place.bottom - 1))
            }
            assert colours == {(255, 255, 255) if light else (0, 0, 0)}
        board = Board.fit(size, world, place.width)
        whole = board.square(0, 0).union(board.square(world.height - 1, world.width - 1))
        assert not whole.colliderect(place)
        assert whole.width > 0.6 * min(size)
    text = pygame.Surface(size)
    draw_scene(text, Scene(OPEN, text="Break\nRelax.", light=True), backdrop, corner)
    assert tuple(text.get_at(place.center))[:3] == (255, 255, 255)  # it holds its level between moves


def test_what_is_done_of_how_much_is_shown() -> None:
    for done, total in ((1, 5), (4, 5), (10, 19)):
        surface = pygame.Surface((640, 360))
        draw_scene(surface, Scene(OPEN, text="Break", progress=(done, total)), surface)
        boxes = pygame.mask.from_threshold(surface, views.DONE, (1, 1, 1)).connected_components()
        assert len([box for box in boxes if box.count() > 20]) == done
        empty = pygame.mask.from_threshold(surface, views.TO_DO, (1, 1, 1)).connected_components(4)
        assert len(empty) == total - done


@pytest.mark.filterwarnings("ignore:no fast renderer")
def test_a_screen_that_doesnt_pace_is_seen_by_its_flips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(views, "BLIND_DRIVERS", ())
    found = module.look(changed(Config(), {"stimulus": {"window_px": 300}}), n=40)
    assert found.flips.n == 40
    assert found.size == (300, 300)
    assert found.driver == "dummy"
    assert found.key_ms > 0
