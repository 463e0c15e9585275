"""What the columns of ``events.tsv`` mean: the text of ``events.json``, with levels, units and HED tags."""

from typing import Any

HED_VERSION = "8.3.0"
"""Of the standard schema whose tags are used; the validator carries it, so nothing is fetched."""

TRIAL_TYPES: dict[str, tuple[str, str]] = {
    "move/correct": (
        "The agent jumped to the next cell, and the shortest path to the goal is no longer than before",
        "Sensory-event, Visual-presentation, Experimental-stimulus, Correct-action",
    ),
    "move/error": (
        "The agent jumped to the next cell, and the shortest path to the goal became longer",
        "Sensory-event, Visual-presentation, Experimental-stimulus, Incorrect-action",
    ),
    "move/unknown": (
        "The agent jumped to the next cell; the record doesn't hold whether it was an error",
        "Sensory-event, Visual-presentation, Experimental-stimulus",
    ),
    "move/unseen": (
        "The agent jumped while no EEG was recorded: the sample is the nearest there is, and no epoch can be cut",
        "Sensory-event, Visual-presentation, Experimental-stimulus",
    ),
    "session/start": ("First message of the run; text: task and map", "Experiment-structure"),
    "session/end": ("Last message of the run; text: how it ended", "Experiment-structure"),
    "block/start": ("A block of calibration moves begins", "Experiment-structure"),
    "block/end": ("A block of calibration moves is over", "Experiment-structure"),
    "episode/start": (
        "Agent and goal appear at new cells: row and column are the agent's, goal_row and goal_column the goal's",
        "Sensory-event, Visual-presentation, Experiment-structure",
    ),
    "episode/end": ("The episode is over; text: goal, limit, block or aborted", "Experiment-structure"),
    "pause": ("The stimulus waits; text: for what", "Experiment-structure"),
    "resume": ("The stimulus goes on", "Experiment-structure"),
    "continued": ("The stimulus was started again after a failure and goes on after this step", "Experiment-structure"),
    "electrodes": (
        "The decoder looked at the electrodes, up to this sample; bad_channels: which are repaired from the others from"
        " now on",
        "Data-feature, Computed-feature",
    ),
    "screen": ("The participant sees a screen between the moves; text: which", "Sensory-event, Visual-presentation"),
    "late_frame": ("A picture that isn't a move's jump was late by `late`", "Data-feature, Data-artifact"),
    "note": ("Something a reader of the record must know; text: from whom and what", "Data-feature, Computed-feature"),
    "BAD_gap": (
        "Samples are missing between this sample and the next; text: how many. MNE leaves out epochs over it",
        "Data-feature, Data-artifact",
    ),
    "boundary": (
        "The first sample after missing ones, under the name by which EEGLAB knows it",
        "Data-feature, Data-artifact",
    ),
}
"""Levels of ``trial_type``: what each is, and its HED tags."""

_ACTIONS = {name: f"One cell {name}wards; row 0 is in the north" for name in ("north", "south", "west", "east")}
_VERDICTS = {
    "error": "The decoder takes the move for an error",
    "correct": "The decoder takes the move for correct",
    "rejected": "The epoch can't be judged; `rejected` says why",
    "unjudged": "The epoch is good, and there is no decoder yet",
}
_TAKEN = {name: _VERDICTS[name] for name in ("error", "correct")} | {"missing": "No verdict in time, or a rejected one"}


def _column(description: str, units: str = "", levels: dict[str, str] | None = None) -> dict[str, Any]:
    return {"Description": description} | ({"Units": units} if units else {}) | ({"Levels": levels} if levels else {})


COLUMNS: dict[str, dict[str, Any]] = {
    "onset": _column("Time of the sample in column sample: its number over the sampling frequency", "s"),
    "duration": _column("0 for what has no length", "s"),
    "sample": _column(
        "Number of the sample, from 0, that is nearest to the event, as the decoder placed it. What came before the "
        "first sample is put at it"
    ),
    "trial_type": _column(
        "What happened", levels={name: description for name, (description, _) in TRIAL_TYPES.items()}
    ),
    "marker": _column(
        "Code of the event on the int32 marker stream: 1 to 4 the agent moved north, south, west, east; 20 episode "
        "starts; 21 to 24 it ends by goal, limit, block, aborted; 30 to 32 pause, resume, continued; 100, 101 session "
        "starts, ends; 110, 111 block starts, ends"
    ),
    "block": _column("Block of a calibration, from 0"),
    "episode": _column("Episode, from start to goal, from 0"),
    "step": _column("Move within the episode, from 1"),
    "action": _column("Where the agent moved", levels=_ACTIONS),
    "row": _column("Row of the agent after the move, from 0 in the north"),
    "column": _column("Column of the agent after the move, from 0 in the west"),
    "goal_row": _column("Row of the goal"),
    "goal_column": _column("Column of the goal"),
    "distance": _column("Length of the shortest path that is left to the goal", "moves"),
    "truth": _column(
        "Whether the move made the shortest path to the goal longer",
        levels={"error": "It did", "correct": "It did not"},
    ),
    "verdict": _column("What the decoder said of the move at the time", levels=_VERDICTS),
    "log_odds": _column("ln P(error)/P(correct) as the classifier claims it"),
    "evidence": _column(
        "ln P(log_odds | error)/P(log_odds | correct) as the calibration's held-out epochs bear it out, within 10 of 0"
    ),
    "rejected": _column("Why the epoch couldn't be judged"),
    "bad_channels": _column("Channels that were repaired from the others, with their faults"),
    "epoch_start": _column("Time of the first sample of the epoch the verdict came from, on the scale of onset", "s"),
    "epoch_samples": _column("Samples of that epoch"),
    "verdict_after": _column(
        "From the move's stamp to the verdict's being sent, in session time; n/a where stimulus and decoder ran on two "
        "computers, for their clocks aren't one",
        "s",
    ),
    "verdict_latency": _column("Real time from the arrival of the epoch's last sample to the verdict's sending", "ms"),
    "policy_took": _column("The verdict on this move as the policy took it for its next action", levels=_TAKEN),
    **{
        f"p_{name}": _column(f"Probability the policy gave to moving {name} when it chose this move")
        for name in ("north", "south", "west", "east")
    },
    "action_latency": _column("Real time from the verdict before, or the episode's start, to this move's action", "ms"),
    "late": _column("How much later than due the picture was shown", "ms"),
    "stamp": _column(
        "Stamp of the event as recorded, on the LSL clock of who said it. For a move the time of the screen's flip, "
        "plus the delay of the light where a photodiode has shown one: stamp and onset hold it already. How long it is "
        "tell a note at the run's start, and ErrpBci.PhotonDelayMs in its _eeg.json (0: none was measured)",
        "s",
    ),
    "clock_offset": _column(
        "Added to stamp to put it on the EEG's clock: for what the stimulus stamped, and all on its computer, as the "
        "decoder measured it, else as LabRecorder did",
        "s",
    ),
    "text": _column("In words"),
}
"""The content of ``events.json``: the columns in order. (BIDS knows the column HED.)"""


def hed(trial_type: str, stamp: float) -> str:
    """The HED tags of an event: one group, with its name and stamp, for two alike at one sample would be an error."""
    tags, name = TRIAL_TYPES[trial_type][1], trial_type.replace("/", "-")
    return f"({tags}, Label/{name}, Time-value/{stamp:.6f} s)"
