"""A decoder's statistics, as its model file holds them and a policy is told them: on a command line, in a sidecar."""

from dataclasses import dataclass
from typing import Self

from bci_app.errors import SetupError


@dataclass(frozen=True)
class Told:
    """A decoder's statistics, as its calibration measured them.

    Attributes
    ----------
    hit, correct_rejection : probability that an error, and that a correct move, is called so.
    information : bits a verdict tells about a move that is an error with probability one half, 0 to 1.
    """

    hit: float
    correct_rejection: float
    information: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``HIT:CORRECT_REJECTION:BITS``. Raises SetupError for anything else."""
        try:
            hit, correct_rejection, information = (float(word) for word in text.split(":"))
        except ValueError:
            hit = correct_rejection = information = -1.0
        if not all(0 <= number <= 1 for number in (hit, correct_rejection, information)):
            raise SetupError(
                "What the policy is told must be HIT:CORRECT_REJECTION:BITS, three numbers from 0 to 1 as in "
                f"0.66:0.79:0.21; found '{text}'."
            )
        return cls(hit, correct_rejection, information)

    def __str__(self) -> str:
        # repr, so that a replay is told the same to the bit.
        return f"{self.hit!r}:{self.correct_rejection!r}:{self.information!r}"
