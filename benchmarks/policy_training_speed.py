"""How fast policies train on this machine, and what fraction of its arithmetic that uses.

    python benchmarks/policy_training_speed.py [--seconds 20]

Each figure is the sum over one process a core, all at once, as the library is trained. The limit is what the same
processes reach on nothing but a large matrix product, in float32 and in bfloat16.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import joblib
import numpy as np
import torch

from bci_app.gridworld import load_map
from policy import teachers
from policy.cards import PRETRAINED
from policy.distillation import DistillationSettings, distil
from policy.network import HEAD, HIDDEN, N_MARKS, WIDTH
from policy.planner import PlannerSettings, train_planner
from policy.processor import has_bfloat16, keep_memory
from policy.simulator import Pairs, Simulator, pair_weights
from policy.verdicts import Verdicts, anybody

MAP = "open"
TAUGHT_EVERY = DistillationSettings().taught_every
_INWARD, _OUTWARD = HIDDEN + 121 + N_MARKS, 4 + 121 / TAUGHT_EVERY
STUDENT_FLOP = 2 * (3 * HIDDEN * HIDDEN + _INWARD * WIDTH + WIDTH * HEAD + HEAD * _OUTWARD)
"""Of one step forward: the matrix products of `policy.network.Network`; backward costs twice as much."""
PLANNER_WIDTH = 128
REPLANNING_FLOP = 2 * 155 * 121
"""Of weighing the paths that come by a cell, 155 on average, by the belief."""
PLANNER_FLOP = 2 * PLANNER_WIDTH * (261 + PLANNER_WIDTH + 4)
CRITIC_FLOP = 2 * PLANNER_WIDTH * (261 + 121 + PLANNER_WIDTH + 1)


def timed(rounds: Callable[[], int], seconds: float) -> float:
    """Units a second of something that says how many units it did."""
    rounds()
    started, done = time.perf_counter(), 0
    while time.perf_counter() - started < seconds:
        done += rounds()
    return done / (time.perf_counter() - started)


def products(seconds: float, dtype: torch.dtype) -> float:
    """Floating-point operations a second in a product of 1024 x 1024 matrices."""
    torch.set_num_threads(1)
    a = torch.randn(1024, 1024).to(dtype)

    def multiply() -> int:
        torch.mm(a, a)
        return 2 * 1024**3

    return timed(multiply, seconds)


def environment(seconds: float, words: str) -> float:
    """Moves a second of the simulator alone, restarts included."""
    world, rng, n = load_map(MAP), np.random.default_rng(0), 4096
    pairs, verdicts = Pairs(pair_weights(world, "mixture")), Verdicts.parse(words)
    simulator = Simulator(world, *pairs.draw(n, rng), verdicts(n, rng), rng)
    actions = [rng.integers(0, 4, n) for _ in range(64)]

    def play() -> int:
        for action in actions:
            done = simulator.step(action).done
            n_new = int(done.sum())
            if n_new:
                simulator.begin(done, *pairs.draw(n_new, rng), verdicts(n_new, rng))
        return n * len(actions)

    return timed(play, seconds)


def training(seconds: float, which: str) -> float:
    """Moves a second of a whole training, all its phases in proportion, of about so many seconds."""
    torch.set_num_threads(1)
    keep_memory()
    world = load_map(MAP)
    lesson = teachers.load(PRETRAINED, world)
    full: PlannerSettings | DistillationSettings = PlannerSettings() if which == "planner" else DistillationSettings()
    moves = full.n_steps * full.n_episodes
    first_guess = 60_000  # moves a second
    settings = replace(full, updates=max(round(seconds * first_guess / moves), 10))
    if isinstance(settings, PlannerSettings):
        settings = replace(settings, critic_updates=0)
    started = time.perf_counter()
    if isinstance(settings, PlannerSettings):
        train_planner(world, lesson.paths, settings)
    else:
        distil(world, lesson.planner, anybody, settings)
    return settings.updates * moves / (time.perf_counter() - started)


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each figure")
    seconds = parser.parse_args().seconds
    n = joblib.cpu_count(only_physical_cores=False)

    def together(function: Callable[..., float], *arguments: object) -> float:
        return sum(joblib.Parallel(n_jobs=n)(joblib.delayed(function)(seconds, *arguments) for _ in range(n)))

    limit = together(products, torch.float32)
    limit16 = together(products, torch.bfloat16) if has_bfloat16() else limit
    print(f"{n} cores: {limit / 1e9:.0f} GFLOP/s in float32, {limit16 / 1e9:.0f} in bfloat16\n")
    print("| what | million moves/s | MFLOP a move | of the float32 limit | of the bfloat16 limit |")
    print("|---|---|---|---|---|")
    for words in ("none", "binary:0.7", "score:0.7"):
        print(f"| environment alone, {words} | {together(environment, words) / 1e6:.2f} | | | |")
    # Acting and learning share one pass of the student; the planner acts once and learns once from each move.
    work = {
        "distillation": 3 * STUDENT_FLOP + (PLANNER_FLOP + REPLANNING_FLOP) / TAUGHT_EVERY,
        "planner": 4 * (PLANNER_FLOP + CRITIC_FLOP) + REPLANNING_FLOP,
    }
    for which, flop in work.items():
        speed = together(training, which)
        used = speed * flop
        shares = f"{used / limit:.0%} | {used / limit16:.0%}"
        print(f"| {which}, end to end | {speed / 1e6:.3f} | {flop / 1e6:.2f} | {shares} |", flush=True)


if __name__ == "__main__":
    main()
