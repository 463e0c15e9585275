"""Before the first part: pages, practice, eye movements; one after the other, each until a key or its time."""

from bci_app.config import StimulusConfig
from bci_app.gridworld import GridWorld
from stimulus.guide import PRACTISING, Guide
from stimulus.phases import Phase
from stimulus.practice import Practice
from stimulus.scene import Scene
from stimulus.texts import EYE_MOVEMENTS

EYE_TASKS = tuple(EYE_MOVEMENTS)


class LeadIn:
    """The way to the first part. It says which phase comes next; `Phase.LOOK` is that part.

    Parameters
    ----------
    seed : of the run; practice has a chance of its own, which follows from it.
    eye_movements_s : session seconds of all eye movements.
    """

    def __init__(
        self, times: StimulusConfig, world: GridWorld, guide: Guide, seed: int, eye_movements_s: float
    ) -> None:
        self._times, self._world, self._guide, self._seed = times, world, guide, seed
        self._eye_movements_s = eye_movements_s
        self._step, self._eye_task = -1, -1
        self._practice: Practice | None = None
        self.due = 0.0
        """Session time at which the practice or the eye movement goes on."""

    def next(self, now: float) -> Phase:
        """The next page, the practice, or an eye movement; PAGE, PRACTICE, EYES, or LOOK when all is over."""
        self._practice = None
        self._step += 1
        if self._step >= len(self._guide.steps):
            return self._next_eye_movement(now)
        if self._guide.steps[self._step] != PRACTISING:
            return Phase.PAGE
        self._practice = Practice(self._times, self._world, self._guide.n_practice, self._seed)
        return self._start_practice(now)

    def go_on(self, now: float) -> Phase:
        """What is due at `due`."""
        if self._practice is None:
            return self._next_eye_movement(now)
        self._practice.advance(now)
        self.due = self._practice.due
        return self.next(now) if self._practice.is_over else Phase.PRACTICE

    def again(self, now: float) -> Phase:
        """After a pause: the same page, the practice from a new start, or the next eye movement.

        Of a stimulus that was started again: from the beginning.
        """
        if self._step < 0:
            return self.next(now)
        if self._step >= len(self._guide.steps):
            return self._next_eye_movement(now)
        return Phase.PAGE if self._practice is None else self._start_practice(now)

    @property
    def screen(self) -> str:
        """Name of the page or the eye movement."""
        if self._step < len(self._guide.steps):
            return self._guide.steps[self._step]
        return EYE_TASKS[self._eye_task]

    @property
    def eye_movement(self) -> str:
        """What a recording calls the eye movement."""
        return EYE_MOVEMENTS[EYE_TASKS[self._eye_task]]

    def practice_scene(self, now: float, light: bool) -> Scene | None:
        """What belongs on the screen while moves are practised."""
        return None if self._practice is None else self._practice.scene(now, light)

    def _start_practice(self, now: float) -> Phase:
        if self._practice is None:
            return self.next(now)
        self._practice.begin(now)
        self.due = self._practice.due
        return Phase.PRACTICE

    def _next_eye_movement(self, now: float) -> Phase:
        self._eye_task += 1
        if self._eye_task >= len(EYE_TASKS) or not self._eye_movements_s:
            return Phase.LOOK
        self.due = now + self._eye_movements_s / len(EYE_TASKS)
        return Phase.EYES
