"""Look at a screen before anybody else does: how it paces flips, and how soon a key shows."""

from dataclasses import dataclass
from statistics import median

from bci_app.config import Config
from bci_app.gridworld import load_map
from bci_app.lsl import local_clock
from stimulus.pace import Flips, flips
from stimulus.scene import Scene
from stimulus.texts import load
from stimulus.view import View

N_FLIPS = 120
"""Flips a run's screen is measured by: two seconds at 60 Hz (decided)."""
SETTLE = 5
"""Flips before those: the first wait for the window (decided)."""
N_KEYS = 30
"""Keys pressed by the program to measure how soon they show (decided)."""


@dataclass(frozen=True)
class Look:
    """What a screen is like.

    Attributes
    ----------
    flips : how it paces.
    size, driver, refresh_hz : pixels, SDL's way to the screen, and its rate as the system tells it.
    key_ms : median time from a key in SDL's queue to the return of the flip that answers it.
    """

    flips: Flips
    size: tuple[int, int]
    driver: str
    refresh_hz: float | None
    key_ms: float


def measure(view: View, scene: Scene, n: int = N_FLIPS) -> Flips:
    """Flip one scene again and again; nothing is seen to change. A window is asked for its events meanwhile."""
    view.draw(scene)
    times = []
    for _ in range(SETTLE + n + 1):
        view.events()
        view.flip()
        times.append(local_clock())
    return flips(times[SETTLE:], view.may_be_paced, view.refresh_hz)


def look(config: Config, n: int = N_FLIPS) -> Look:
    """Open the stimulus's window for some seconds. Raises SetupError where there is no screen, or a text
    doesn't fit on it."""
    texts = load(config.stimulus.texts)
    view = View(config.stimulus, "bci-app looks at the screen")
    try:
        view.check(texts)
        scene = Scene(load_map(config.calibration.map), agent=0, countdown=0.0)
        found = measure(view, scene, n)
        keys = [_key_s(view, Scene(scene.world, agent=number % 2)) for number in range(N_KEYS)]
        return Look(found, view.size, view.driver, view.refresh_hz, median(keys) * 1e3)
    finally:
        view.close()


def _key_s(view: View, answer: Scene) -> float:
    """Seconds from a key to the flip that answers it."""
    view.press("pause")
    pressed = local_clock()
    while not view.events():
        pass
    view.draw(answer)
    view.flip()
    return local_clock() - pressed
