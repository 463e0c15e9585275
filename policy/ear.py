"""What a policy takes a verdict for: as it was trained to, or as it is told of its decoder."""

from bci_app.errors import SetupError
from bci_app.protocol import VerdictUsed
from bci_app.told import Told
from policy.verdicts import LIMIT, Verdicts, binary_evidence, binary_information, score_information


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
                rates = (trained.numbers[0], trained.numbers[0])
                self.information = float(score_information(trained.numbers[0]))
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
