"""How a simulated participant's ErrP changes within a run: smaller at the edge, after errors in a row, and online."""

from collections.abc import Sequence
from typing import Literal

from bci_app.config import SimulationConfig
from bci_app.gridworld import area_of
from bci_app.protocol import Position, Truth

LAST_TO_SHRINK = 4
"""Errors in a row over which the ErrP shrinks (paper V.C.4: "the peak decreased in the first four sequences")."""


class Attention:
    """The size of the ErrP from move to move, relative to the person's own; 1 throughout unless configured.

    Parameters
    ----------
    config : with `errp_at_edge`, `errp_habituation` and `errp_online`.
    as_online : whether the ErrP is as large as online in a calibration, too.
    """

    def __init__(self, config: SimulationConfig, as_online: bool = False) -> None:
        self._config, self._as_online = config, as_online
        self._shape: tuple[int, int] | None = None
        self._online = 1.0
        self._in_a_row, self._episode = 0, -1

    @property
    def is_even(self) -> bool:
        """Whether the size is 1 whatever happens, so that nobody needs to know where a move led."""
        config = self._config
        return (config.errp_at_edge, config.errp_habituation, config.errp_online) == (1.0, 0.0, 1.0)

    def open(self, task: Literal["calibration", "online"], layout: Sequence[str]) -> None:
        """A run begins: whether online, and on which map (`SessionStart.layout`)."""
        self._shape = len(layout), len(layout[0])
        self._online = self._config.errp_online if self._as_online or task == "online" else 1.0

    def size(self, truth: Truth, position: Position) -> float:
        """The size at a move that led to a position, in order of the moves."""
        before = self._in_a_row if truth.episode == self._episode else 0
        self._in_a_row, self._episode = before + 1 if truth.error else 0, truth.episode
        level = min(max(self._in_a_row, 1), LAST_TO_SHRINK)
        at_edge = self._shape is not None and area_of(position, *self._shape) == "edge"
        where = self._config.errp_at_edge if at_edge else 1.0
        return self._online * where * (1 - self._config.errp_habituation * (level - 1))
