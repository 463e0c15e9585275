"""The numbers of the paper's second experiment, of people (section V.B), which ours are put beside."""

PEOPLE = ("S2", "S4", "S5", "S6", "S8", "S10", "S15")

ACCURACY: dict[str, tuple[float, ...]] = {
    "offline": (0.7333, 0.7283, 0.8517, 0.7467, 0.7617, 0.8017, 0.7533),
    "open": (0.7768, 0.6088, 0.9475, 0.6901, 0.7191, 0.7181, 0.6428),
    "obstacles": (0.7773, 0.5802, 0.6502, 0.6654, 0.6611, 0.7025, 0.7011),
}
"""Table I: shares of right verdicts, tenfold cross-validation and on each map."""
MEAN_ACCURACY = {"offline": 0.7665, "open": 0.7322, "obstacles": 0.6920}
"""Table I, last row."""

SUCCESS: dict[str, tuple[float, ...]] = {
    "open": (0.9474, 0.7895, 0.9474, 0.6313, 0.7895, 0.8421, 0.7368),
    "obstacles": (0.8947, 0.8421, 0.8421, 0.6316, 0.8947, 0.9474, 0.8947),
}
"""Table II: success within 60 steps, 19 episodes. S6 on `open` is printed as 63.13 %; 12 of 19 are 63.16 %."""
MEAN_SUCCESS = {"open": 0.8120, "obstacles": 0.8496}
"""Table II, last row."""

STEPS: dict[str, tuple[tuple[float, float], ...]] = {
    "open": (
        (23.11, 13.2),
        (26.07, 16.56),
        (21.06, 11.73),
        (29.0, 18.69),
        (24.8, 14.57),
        (24.94, 15.74),
        (28.86, 17.59),
    ),
    "obstacles": (
        (20.06, 14.38),
        (26.88, 13.97),
        (22.69, 12.93),
        (28.42, 15.78),
        (17.53, 9.91),
        (23.61, 12.81),
        (21.0, 13.35),
    ),
}
"""Table II: mean and standard deviation of the steps of the episodes that reached the goal."""
MEAN_STEPS = {"open": (24.59, 14.66), "obstacles": (21.92, 12.97)}
"""Table II, last row."""

N_EPISODES = 19
"""Episodes on each map, one for each initial distance from 2 to 20 (V.B.3)."""


def failed(map_name: str) -> list[int]:
    """Tables A1 and A2, last column: episodes of each person that didn't reach the goal, by Table II's success."""
    return [round(N_EPISODES * (1 - share)) for share in SUCCESS[map_name]]
