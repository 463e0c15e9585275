"""What is shown in which phase: the name of the screen, its text, or the map."""

from bci_app.gridworld import GridWorld
from stimulus.course import Course
from stimulus.lead_in import LeadIn
from stimulus.phases import Phase
from stimulus.scene import Scene
from stimulus.texts import BREAKS, Texts


def screen_of(phase: Phase, lead_in: LeadIn, course: Course, paused_by_person: bool, closing: str) -> str | None:
    """Name of what is shown in place of the moves that count; None for those, and for practice."""
    match phase:
        case Phase.READY:
            return "welcome"
        case Phase.PAGE | Phase.EYES:
            return lead_in.screen
        case Phase.BREAK:
            return "break"
        case Phase.KEY:
            return "break_over" if course.has_blocks else "break_online"
        case Phase.PAUSED:
            return "pause" if paused_by_person else "waiting"
        case Phase.DONE:
            return closing
    return None


def text_scene(name: str, texts: Texts, world: GridWorld, course: Course) -> Scene:
    """A screen with text, and in breaks how much is done."""
    text, foot = texts[name], texts["foot_pause"] if name == "pause" else ""
    progress = course.done_of if name in BREAKS else None
    if progress is not None:
        text = texts.filled(name, *progress)
    return Scene(world, text=text, screen=name, foot=foot, progress=progress, light=course.light)


def move_scene(phase: Phase, world: GridWorld, course: Course, countdown: float | None) -> Scene:
    """The map with goal and agent, and what there is of countdown or arrow."""
    walk, is_jump = course.walk, phase is Phase.JUMP
    arrow = walk.last_move if is_jump or phase is Phase.ARROW else None
    return Scene(world, walk.cell, walk.goal, countdown, arrow, moved=is_jump, light=course.light)
