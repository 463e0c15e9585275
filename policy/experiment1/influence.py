"""How much verdict and position weigh in a policy's choices, and where on the map: means of attributions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bci_app.gridworld import GridWorld
from policy.experiment1 import Row
from policy.experiment1.attribution import METHODS, Method, attributions, effect_of, record
from policy.network import Actor
from policy.simulator import Ints
from policy.verdicts import Verdicts, binary_evidence

Numbers = NDArray[np.floating[Any]]
BORDERS = (1, 2, 3)
"""Cells from the wall that count as edge. The paper gives no number, its Fig. 10 is a drawing."""
RESAMPLES = 1000  # of the bootstrap
GRADIENT_EPISODES = 5000  # at most; the intervals are then 1 to 2 % wide
ATTRIBUTED_EPISODES = 200  # for the methods that take dozens of gradients a step


def tables(network: Actor, world: GridWorld, accuracy: float, episodes: int, seed: int) -> dict[str, list[Row]]:
    """Rows of `gradients`, `gradient_map` and `centre_edge` under binary verdicts of an accuracy, as they are told."""
    scale = float(binary_evidence(accuracy, accuracy)[0])
    steps = record(network, world, Verdicts("binary", (accuracy,)), min(episodes, GRADIENT_EPISODES), seed)
    some = steps.take(steps.episode < ATTRIBUTED_EPISODES)
    by_verdict, by_position = attributions(effect_of(network, steps, scale), "gradient")
    rows = _means("gradient", by_verdict, by_position, steps.episode)
    for method in METHODS[1:]:
        rows += _means(method, *attributions(effect_of(network, some, scale), method), some.episode)
    cells = CellMeans(world, np.abs(by_verdict), steps.view.cell, steps.episode)
    compared = {border: cells.centre_and_edge(border, np.random.default_rng(seed)) for border in BORDERS}
    return {
        "gradients": rows,
        "gradient_map": cells.rows(),
        "centre_edge": [{"border": border} | found for border, found in compared.items() if found],
    }


def _means(method: Method, by_verdict: Numbers, by_position: Numbers, episode: Ints) -> list[Row]:
    # Integrated gradients sum to what the position does; gradients are as many ways in which it could have differed.
    placed = by_position.sum(axis=1) if method == "integrated gradients" else np.abs(by_position).mean(axis=1)
    rows = []
    for name, values in (("verdict", by_verdict), ("position", placed)):
        mean, low, high = mean_by_episode(np.abs(values), episode)
        rows.append(
            {"method": method, "input": name, "mean": mean, "ci_low": low, "ci_high": high, "steps": len(values)}
        )
    return rows


def mean_by_episode(values: Numbers, episode: Ints) -> tuple[float, float, float]:
    """Mean of the steps' values, (n,), with a 95 % interval; only the ``episode``s, (n,), are independent."""
    total, count = np.bincount(episode, values), np.bincount(episode)
    mean = float(total.sum() / count.sum())
    # Of a ratio of means (Cochran, Sampling Techniques, 1977, 6.13).
    half = 1.96 * float(np.sqrt(((total - mean * count) ** 2).sum()) / count.sum())
    return mean, mean - half, mean + half


class CellMeans:
    """Mean of the steps' values in each cell of a map.

    Parameters
    ----------
    values, cell, episode : of each step, (n,).

    Attributes
    ----------
    mean : (n_cells,), NaN where nobody came.
    visits : (n_cells,), steps.
    """

    def __init__(self, world: GridWorld, values: Numbers, cell: Ints, episode: Ints) -> None:
        self._world = world
        shape = int(episode.max()) + 1, world.n_cells
        self._total, self._count = np.zeros(shape), np.zeros(shape)
        np.add.at(self._total, (episode, cell), values)
        np.add.at(self._count, (episode, cell), 1)
        self.visits = self._count.sum(axis=0)
        self.mean = _ratio(self._total.sum(axis=0), self.visits)

    def rows(self) -> list[Row]:
        """One for each cell that was visited."""
        places = zip(self._world.cells.tolist(), self.mean.tolist(), self.visits.tolist(), strict=True)
        return [
            {"row": row, "column": column, "gradient": mean, "steps": int(visits)}
            for (row, column), mean, visits in places
            if visits
        ]

    def centre_and_edge(self, border: int, rng: np.random.Generator) -> dict[str, float] | None:
        """Means over the cells of centre and edge, their difference and ratio with 95 % intervals; None without both.

        Whole episodes are resampled (percentile bootstrap).
        """
        edge = _from_wall(self._world) < border
        if edge.all() or not np.isfinite(self.mean[edge]).any() or not np.isfinite(self.mean[~edge]).any():
            return None
        n = len(self._total)
        weights = rng.multinomial(n, np.full(n, 1 / n), RESAMPLES).astype(float)
        drawn = _ratio(weights @ self._total, weights @ self._count)
        complete = np.isfinite(drawn[:, ~edge]).any(axis=1) & np.isfinite(drawn[:, edge]).any(axis=1)
        centres, edges = np.nanmean(drawn[complete][:, ~edge], axis=1), np.nanmean(drawn[complete][:, edge], axis=1)
        centre, rim = float(np.nanmean(self.mean[~edge])), float(np.nanmean(self.mean[edge]))
        low, high = np.nanpercentile(centres - edges, (2.5, 97.5))
        ratio_low, ratio_high = np.nanpercentile(centres / edges, (2.5, 97.5))
        return {
            "centre": centre,
            "edge": rim,
            "difference": centre - rim,
            "ci_low": float(low),
            "ci_high": float(high),
            "ratio": centre / rim,
            "ratio_low": float(ratio_low),
            "ratio_high": float(ratio_high),
        }


def _ratio(total: Numbers, count: Numbers) -> Numbers:
    ratio: Numbers = np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)
    return ratio


def _from_wall(world: GridWorld) -> Ints:
    """Cells between each cell and the nearest border of the grid, (n_cells,)."""
    row, column = world.cells.T
    nearest: Ints = np.minimum.reduce([row, column, world.height - 1 - row, world.width - 1 - column])
    return nearest
