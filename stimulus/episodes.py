"""What a run is made of: its episodes, their order, one episode under way, and the calibrating agent's moves.

Only `random.Random.random` is used: its sequence for a seed is the same on every Python version and machine
(https://docs.python.org/3/library/random.html, "Notes on Reproducibility"); `choice` and `shuffle` promise nothing.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from bci_app.config import CalibrationConfig, OnlineConfig
from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS, GridWorld
from bci_app.protocol import (
    ActionName,
    EpisodeEnd,
    EpisodeGoal,
    EpisodeStart,
    MoveOnset,
    Position,
    SessionStart,
    Truth,
)

MIN_DISTANCE = 2
"""Fewest moves from start to goal: nearer goals are sensed at once (paper V.A.1)."""


@dataclass(frozen=True)
class Episode:
    """Start and goal of an episode, as cells of the map."""

    start: int
    goal: int


def online_episodes(world: GridWorld, distances: tuple[int, int], seed: int) -> tuple[Episode, ...]:
    """One episode for each initial distance from the lower to the upper bound, nearest first (paper V.B.3).

    Distances in moves, both bounds included; those beyond the longest shortest path of the map are left out.
    Raises SetupError when none is left.
    """
    lowest, highest = distances[0], min(distances[1], int(world.distance.max()))
    if not MIN_DISTANCE <= lowest <= highest:
        raise SetupError(
            f"No online episode: expected distances from {MIN_DISTANCE} up to at most {world.distance.max()}, the "
            f"longest on map '{world.name}', found {list(distances)}. Change online.distances or the map."
        )
    rng = Random(seed)
    return tuple(_draw(np.argwhere(world.distance == moves), rng) for moves in range(lowest, highest + 1))


def episode_order(n: int, seed: int) -> tuple[int, ...]:
    """The numbers 0..n-1 in random order (Fisher and Yates)."""
    rng, order = Random(seed), list(range(n))
    for last in range(n - 1, 0, -1):
        other = _index(last + 1, rng)
        order[last], order[other] = order[other], order[last]
    return tuple(order)


def random_episode(world: GridWorld, rng: Random) -> Episode:
    """A random start and goal more than one move apart, each pair equally likely (paper V.A.1).

    Raises SetupError when the map is so small that there is none.
    """
    pairs = np.argwhere(world.distance >= MIN_DISTANCE)
    if not len(pairs):
        raise SetupError(f"Map '{world.name}' is too small: no two of its cells are {MIN_DISTANCE} moves apart.")
    return _draw(pairs, rng)


def random_episodes(world: GridWorld, rng: Random) -> Iterator[Episode]:
    """Random episodes without end. The first is drawn at once, so that a map too small is refused at once."""
    first = random_episode(world, rng)

    def episodes() -> Iterator[Episode]:
        yield first
        while True:
            yield random_episode(world, rng)

    return episodes()


def calibration_action(world: GridWorld, cell: int, goal: int, rng: Random, error_probability: float) -> int:
    """A legal action that lengthens the path with the given probability, and shortens it otherwise.

    Where no legal action is of the kind that was drawn, the other kind is taken: an agent in a dead end can only go
    right, an agent in the farthest corner too.
    """
    legal = np.flatnonzero(world.legal[cell]).tolist()
    errors = [action for action in legal if world.is_error(cell, action, goal)]
    correct = [action for action in legal if action not in errors]
    wanted, other = (errors, correct) if rng.random() < error_probability else (correct, errors)
    kind = wanted or other
    return int(kind[_index(len(kind), rng)])


@dataclass
class Walk:
    """An episode under way, and its messages. The only ones that tell the goal are those of the truth stream.

    Attributes
    ----------
    number : of the episode in the run, from 0.
    cell, goal : where the agent is and shall be.
    steps : moves whose onset is known.
    last_move : the cell the agent came from and the action it took.
    """

    world: GridWorld
    session: str
    number: int
    cell: int
    goal: int
    max_steps: int
    steps: int = 0
    last_move: tuple[int, int] = (0, 0)

    def go(self, action: int) -> None:
        """Jump to the next cell. The step counts only once its onset is known."""
        self.last_move = (self.cell, action)
        self.cell = int(self.world.next_cell[self.last_move])

    def over(self) -> Literal["goal", "limit"] | None:
        """Why the episode is over; None while it isn't."""
        if self.cell == self.goal:
            return "goal"
        return "limit" if self.steps == self.max_steps else None

    def position(self, cell: int) -> Position:
        """Row and column of a cell."""
        row, column = self.world.cells[cell].tolist()
        return row, column

    def start_messages(self) -> tuple[EpisodeStart, EpisodeGoal]:
        """For the stimulus and the truth stream, when the agent stands at the start."""
        start = EpisodeStart(
            session=self.session,
            episode=self.number,
            position=self.position(self.cell),
            sensed=self.world.goal_sensed(self.cell, self.goal),
            max_steps=self.max_steps,
        )
        goal, distance = self.position(self.goal), self._distance()
        return start, EpisodeGoal(session=self.session, episode=self.number, goal=goal, distance=distance)

    def move_messages(self) -> tuple[MoveOnset, Truth]:
        """For the stimulus and the truth stream, about the last move."""
        action = self.last_move[1]
        onset = MoveOnset(
            session=self.session,
            episode=self.number,
            step=self.steps,
            action=cast(ActionName, ACTIONS[action]),
            position=self.position(self.cell),
            sensed=self.world.goal_sensed(self.cell, self.goal),
        )
        error, distance = self.was_error(), self._distance()
        truth = Truth(session=self.session, episode=self.number, step=self.steps, error=error, distance=distance)
        return onset, truth

    def was_error(self) -> bool:
        """Whether the last move made the way to the goal longer."""
        return self.world.is_error(*self.last_move, self.goal)

    def end_message(self, reason: Literal["goal", "limit", "block", "aborted"]) -> EpisodeEnd:
        """For the stimulus stream, when the last move has rested."""
        return EpisodeEnd(session=self.session, episode=self.number, steps=self.steps, reason=reason)

    def _distance(self) -> int:
        return int(self.world.distance[self.cell, self.goal])


@dataclass(frozen=True)
class Begin:
    """Where a run begins: a calibration in a block that has some moves already, an online run at an episode."""

    block: int = 0
    moves_done: int = 0
    episode: int = 0


FROM_THE_START = Begin()


@dataclass(frozen=True)
class Plan:
    """What is going to happen in a run; all that tells a calibration from an online run.

    Attributes
    ----------
    opening : the first message.
    seed : what the run's chances follow from.
    episodes : the episodes in their order; a calibration's never end.
    choose : the calibrating agent's action for (cell, goal, whether it must be an error; None leaves that to chance);
        None when actions come from outside.
    moves_per_block : None for a run without blocks.
    break_s : session seconds a break between blocks lasts at least.
    wait_for_key : whether a key ends a break; else time does.
    eye_movements_s : session seconds of eye movements before the first block.
    begin : where it begins: not at the beginning where it goes on from a run that was broken off.
    break_every : online episodes between two breaks; 0 for none.
    """

    opening: SessionStart
    seed: int
    episodes: Iterator[Episode]
    choose: Callable[[int, int, bool | None], int] | None
    max_steps: int
    n_blocks: int = 0
    moves_per_block: int | None = None
    break_s: float = 0.0
    wait_for_key: bool = False
    eye_movements_s: float = 0.0
    begin: Begin = FROM_THE_START
    break_every: int = 0


def calibration_plan(
    run: CalibrationConfig,
    world: GridWorld,
    session: str,
    participant: str,
    seed: int,
    wait_for_key: bool,
    begin: Begin = FROM_THE_START,
) -> Plan:
    """Blocks of moves by an agent that errs on purpose (paper V.A.1); `SessionStart.n_moves` is how many are to come.

    Raises SetupError for a map too small.
    """
    rng = Random(seed)
    opening = SessionStart(
        session=session,
        task="calibration",
        participant=participant,
        map=world.name,
        layout=world.layout(),
        n_blocks=run.n_blocks,
        n_moves=(run.n_blocks - begin.block) * run.moves_per_block - begin.moves_done,
    )

    def choose(cell: int, goal: int, error: bool | None) -> int:
        return calibration_action(world, cell, goal, rng, run.error_probability if error is None else float(error))

    episodes = random_episodes(world, rng)
    return Plan(
        opening,
        seed,
        episodes,
        choose,
        run.max_steps,
        run.n_blocks,
        run.moves_per_block,
        run.break_s,
        wait_for_key,
        run.eye_movements_s,
        begin,
    )


def online_plan(
    run: OnlineConfig,
    world: GridWorld,
    session: str,
    participant: str,
    seed: int,
    begin: Begin = FROM_THE_START,
    wait_for_key: bool = False,
) -> Plan:
    """The pre-generated episodes, the same for everyone, in the random order of `seed` (paper V.B.3).

    There are breaks only where a key can end them.

    Raises SetupError when the map has none of the wanted distances.
    """
    seeds = range(run.episodes_seed, run.episodes_seed + run.rounds)
    episodes = [episode for number in seeds for episode in online_episodes(world, run.distances, number)]
    opening = SessionStart(
        session=session,
        task="online",
        participant=participant,
        map=world.name,
        layout=world.layout(),
        n_episodes=len(episodes),
    )
    order = episode_order(len(episodes), seed)[begin.episode :]
    break_every = run.break_every if wait_for_key else 0
    chosen = iter([episodes[number] for number in order])
    return Plan(opening, seed, chosen, None, run.max_steps, begin=begin, break_every=break_every)


def _draw(pairs: NDArray[np.int64], rng: Random) -> Episode:
    start, goal = pairs[_index(len(pairs), rng)].tolist()
    return Episode(start, goal)


def _index(n: int, rng: Random) -> int:
    return int(rng.random() * n)
