"""The world's tables, against rules written down a second time and independently."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bci_app.errors import SetupError
from bci_app.gridworld import SHIPPED_MAPS, STEP, GridWorld, compile_map, load_map


@st.composite
def connected_maps(draw: st.DrawFn) -> str:
    """Grow a connected patch of free cells; the rest is obstacles."""
    height, width = draw(st.integers(1, 7)), draw(st.integers(2, 7))
    free = {(draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1)))}
    for _ in range(draw(st.integers(1, 30))):
        row, column = draw(st.sampled_from(sorted(free)))
        dr, dc = draw(st.sampled_from(STEP))
        if 0 <= row + dr < height and 0 <= column + dc < width:
            free.add((row + dr, column + dc))
    if len(free) < 2:
        row, column = next(iter(free))
        free.add((row, column + 1 if column + 1 < width else column - 1))
    return "\n".join("".join("." if (r, c) in free else "#" for c in range(width)) for r in range(height))


def breadth_first(world: GridWorld, start: int) -> dict[int, int]:
    cells = {tuple(cell): number for number, cell in enumerate(world.cells.tolist())}
    found, queue = {start: 0}, deque([start])
    while queue:
        here = queue.popleft()
        row, column = world.cells[here].tolist()
        for dr, dc in STEP:
            there = cells.get((row + dr, column + dc))
            if there is not None and there not in found:
                found[there] = found[here] + 1
                queue.append(there)
    return found


@given(connected_maps())
def test_tables_agree_with_a_walk(text: str) -> None:
    world = compile_map(text, "drawn")
    assert "\n".join(world.layout()) == text
    for cell in range(world.n_cells):
        found = breadth_first(world, cell)
        assert [found[other] for other in range(world.n_cells)] == world.distance[cell].tolist()
        for action, (dr, dc) in enumerate(STEP):
            there = world.next_cell[cell, action]
            moved = tuple((world.cells[there] - world.cells[cell]).tolist())
            assert moved == ((dr, dc) if world.legal[cell, action] else (0, 0))


@given(connected_maps(), st.data())
def test_a_legal_move_changes_the_distance_by_one_and_senses_what_is_adjacent(text: str, data: st.DataObject) -> None:
    world = compile_map(text, "drawn")
    cell, goal = (data.draw(st.integers(0, world.n_cells - 1)) for _ in range(2))
    sensed = world.goal_sensed(cell, goal)
    assert sensed[0] == (cell == goal)
    assert any(sensed[1:]) == (world.distance[cell, goal] == 1)
    for action in range(4):
        change = world.distance[world.next_cell[cell, action], goal] - world.distance[cell, goal]
        assert abs(change) == world.legal[cell, action]
        assert world.is_error(cell, action, goal) == (change > 0)


def test_shipped_maps_are_the_published_ones() -> None:
    worlds = {name: load_map(name) for name in SHIPPED_MAPS}
    assert {name: world.n_cells for name, world in worlds.items()} == {"open": 121, "obstacles": 104}
    for world in worlds.values():
        assert (world.height, world.width) == (11, 11)
        assert world.distance[world.cell_at(0, 0), world.cell_at(10, 10)] == world.distance.max() == 20


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("..\n...", "lengths [2, 3]"),
        ("..x", "['x']"),
        (".#.", "row 1, column 3 is cut off"),
        (".", "at least 2 free cells"),
        ("", "rectangle"),
    ],
)
def test_a_bad_map_is_refused_with_what_to_do(text: str, says: str) -> None:
    with pytest.raises(SetupError, match="Map 'bad'") as error:
        compile_map(text, "bad")
    assert says in str(error.value)


def test_an_unknown_map_names_the_known_ones() -> None:
    with pytest.raises(SetupError, match="open, obstacles"):
        load_map("nowhere")


def test_maps_of_one_layout_have_one_digest() -> None:
    assert compile_map("..\n..", "a").digest == compile_map("..\n..\n", "b").digest != load_map("open").digest
    assert isinstance(load_map("open").next_cell, np.ndarray)
