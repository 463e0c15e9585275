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
    text : what the participant reads in place of the grid: a heading, then paragraphs, a line each.
    moved : True from a jump until its flip is reported.
    screen : name of what is shown in place of the moves that count; None for those.
    foot : a small line for the experimenter.
    progress : how many of how many parts are done, shown as a bar below the text.
    light : whether the photodiode's patch is lit; it changes with each jump.
    """

    world: GridWorld
    agent: int | None = None
    goal: int | None = None
    countdown: float | None = None
    arrow: tuple[int, int] | None = None
    text: str | None = None
    moved: bool = False
    screen: str | None = None
    foot: str = ""
    progress: tuple[int, int] | None = None
    light: bool = False


def countdown_at(now: float, due: float, length: float) -> float:
    """How much of a countdown is over, 0 to 1, that is full at `due` and takes `length` s."""
    left = (due - now) / length if length else 0.0
    return min(1.0, max(0.0, 1.0 - left))
