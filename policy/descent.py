"""Gradient descent as all our trainings do it: Adam, a rate that falls linearly, gradients clipped by their norm."""

from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn

Progress = Callable[[int, dict[str, float]], None]
"""Called after each update with its number, from 1, and its figures."""


def unheard(update: int, figures: dict[str, float]) -> None:
    """Progress that nobody watches."""


class Descent:
    """Takes the steps of one training.

    Parameters
    ----------
    parameters : what is trained.
    learning_rate : Adam's at the beginning.
    least : share of it that is left in the end.
    max_gradient : norm at which a gradient is clipped.
    """

    def __init__(
        self, parameters: Iterable[nn.Parameter], learning_rate: float, least: float, max_gradient: float
    ) -> None:
        self._parameters = list(parameters)
        self._optimizer = torch.optim.Adam(self._parameters, eps=1e-5, fused=True)
        self._learning_rate, self._least, self._max_gradient = learning_rate, least, max_gradient

    def slow_down(self, left: float) -> None:
        """Set the rate for when this share of the updates, 1 to 0, is still to come."""
        self._optimizer.param_groups[0]["lr"] = self._learning_rate * max(left, self._least)

    def step(self, loss: Tensor) -> None:
        """One step down."""
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self._parameters, self._max_gradient)
        self._optimizer.step()
