"""A set of moves is a set."""

from hypothesis import given
from hypothesis import strategies as st

from bci_app.move_set import Key, MoveSet

MOVES = st.tuples(st.integers(0, 40), st.integers(0, 70))
SETS = st.sets(MOVES)


@given(mine=SETS, other=SETS, more=MOVES)
def test_it_does_what_a_set_does(mine: set[Key], other: set[Key], more: Key) -> None:
    found = MoveSet(mine)
    assert set(found) == mine
    assert len(found) == len(mine)
    assert (more in found) == (more in mine)
    assert set(found - other) == mine - other
    assert set(found & other) == mine & other
    assert (found <= MoveSet(other)) == (mine <= other)
    assert found == mine
    assert "x" not in found
    found.add(more)
    assert set(found) == mine | {more}
    found.discard(more)
    found.discard(more)
    assert set(found) == mine - {more}
