"""What comes before the first part of a run: instructions, practice, eye movements."""

from dataclasses import dataclass

from bci_app.config import PRACTICE_MOVES, Config
from bci_app.protocol import SessionStart
from stimulus.episodes import FROM_THE_START, Begin
from stimulus.texts import Texts, english, load

PRACTISING = "practising"
"""The step at which moves are practised; all others are pages to be read."""


@dataclass(frozen=True)
class Guide:
    """The texts, and the way to the first part.

    Attributes
    ----------
    steps : names of pages, each until a key, and `PRACTISING`.
    n_practice : moves that are practised.
    """

    texts: Texts
    steps: tuple[str, ...] = ()
    n_practice: int = 0


def unguided() -> Guide:
    """No way, and the texts we ship."""
    return Guide(english())


def guide(config: Config, task: str, begin: Begin = FROM_THE_START) -> Guide:
    """A run's guide. Pages need somebody to turn them; a run that goes on from another isn't practised for again.

    Raises SetupError for texts that aren't there.
    """
    texts = load(config.stimulus.texts)
    has_reader = has_person(config) and config.stimulus.instructions
    wanted = config.calibration.practice_moves if task == "calibration" else config.online.practice_moves
    n_practice = wanted if wanted is not None else PRACTICE_MOVES if has_reader else 0
    steps = [task]
    if n_practice and begin == FROM_THE_START:
        steps += ["practice", PRACTISING, "practice_over"]
    if task == "calibration" and config.calibration.eye_movements_s:
        steps.append("eyes")
    if not has_reader:
        steps = [step for step in steps if step == PRACTISING]
    return Guide(texts, tuple(steps), n_practice)


def has_person(config: Config) -> bool:
    """Whether somebody sits before a window and can press a key."""
    return config.stimulus.person and not config.stimulus.headless


def opening_note(opening: SessionStart, delay_ms: float) -> str:
    """What a reader of the recording must know of the onsets' stamps."""
    return (
        f"Onsets of session {opening.session} are stamped {delay_ms:g} ms after their flips: when the light came, as "
        "measured (stimulus.photon_delay_ms)."
    )
