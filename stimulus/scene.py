"""What is on the screen: made by the paradigm, drawn by the view, known to nobody else."""

from dataclasses import dataclass

from bci_app.gridworld import GridWorld


@dataclass(frozen=True)
class Scene:
    """What is on the screen.

    Attributes
    ----------
    agent, goal : cells, None where there is none to see.
    countdown : part of the countdown that is over, 0 to 1; None outside it.
    arrow : the cell the agent came from and its action, while the arrow stays.
    text : lines of a message, shown in place of the grid.
    moved : True from a jump until its flip is reported.
    """

    world: GridWorld
    agent: int | None = None
    goal: int | None = None
    countdown: float | None = None
    arrow: tuple[int, int] | None = None
    text: str | None = None
    moved: bool = False
