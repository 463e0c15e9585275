"""What a policy is told of its decoder, and what it therefore takes a verdict for."""

from dataclasses import dataclass
from typing import Self

from bci_app.errors import SetupError
from bci_app.protocol import VerdictUsed
from policy.verdicts import LIMIT, Verdicts, binary_evidence, binary_information, score_information


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


class Ear:
    """How one policy hears verdicts: as it was trained to, or as it is told.

    Parameters
    ----------
    trained : the verdicts it was trained with.
    told : its decoder's statistics; only a policy that is told any needs them.

    Attributes
    ----------
    information : bits a verdict, for the policy's input.

    Raises SetupError when the policy must be told and isn't.
    """

    def __init__(self, trained: Verdicts, told: Told | None) -> None:
        match trained.kind:
            case "none":
                rates, self.information = (0.5, 0.5), 0.0
            case "binary" | "rates":
                rates = (trained.numbers[0], trained.numbers[-1])
                self.information = float(binary_information(*rates))
            case "score":
                rates, self.information = (
                    (trained.numbers[0], trained.numbers[0]),
                    float(score_information(trained.numbers[0])),
                )
            case "told":
                if told is None:
                    raise SetupError(
                        "This policy must be told its decoder's statistics, and wasn't. Start it with --told "
                        "HIT:CORRECT_REJECTION:BITS; `bci-app fit` prints them as `evidence`."
                    )
                rates, self.information = (told.hit, told.correct_rejection), told.information
        self._if_error, self._if_correct = map(float, binary_evidence(*rates))
        self._scores = trained.kind in ("score", "told")

    def evidence(self, verdict: VerdictUsed, said: float | None) -> float:
        """What a verdict is taken for: log P(verdict | error) / P(verdict | correct), 0 for one that is missing.

        Parameters
        ----------
        verdict : the decoder's word.
        said : the decoder's own evidence, if it gives any. A policy trained on words alone doesn't listen to it.
        """
        if verdict == "missing":
            return 0.0
        if self._scores and said is not None:
            return max(-LIMIT, min(LIMIT, said))
        return self._if_error if verdict == "error" else self._if_correct
