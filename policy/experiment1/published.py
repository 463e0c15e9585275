"""The numbers of the paper's first experiment (section IV.B), which ours are put beside."""

STEPS: dict[str, dict[float | None, float]] = {
    "open": {None: 51.2, 0.7: 34.8, 0.8: 24.0, 1.0: 10.0},
    "obstacles": {None: 50.7, 0.7: 40.8, 0.8: 25.7, 1.0: 10.0},
}
"""Mean steps by map and accuracy (IV.B.5); the last is "approximately ten steps" (IV.B.2), it isn't said on which."""

ROBUSTNESS = {0.75: {0.7: 27.0, 1.0: 12.0}, 1.0: {0.7: 40.0, 1.0: 10.0}}
"""Trained at, evaluated at: about so many steps (IV.B.2); it isn't said on which map."""

SUCCESS: dict[str, dict[float | None, float]] = {
    "open": {None: 0.7974, 0.7: 0.8319, 0.8: 0.9586},
    "obstacles": {None: 0.6943, 0.7: 0.7670, 0.8: 0.9421},
}
"""Success within 60 steps by map and accuracy, mean over the initial distances 2..20 (IV.B.5)."""
