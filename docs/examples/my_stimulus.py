"""A stimulus of one's own: one episode on an empty map, in the terminal. `python my_stimulus.py SESSION`."""

import json
import sys
import time

import pylsl

SESSION, MOVES = sys.argv[1], {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}


def outlet(name, kind, form="string"):
    """A stream of this program's."""
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, kind, 1, 0.0, form, f"bci-app/{SESSION}/{name}"))


def inlet(name):
    """A stream of another process of the session, open."""
    found = pylsl.StreamInlet(pylsl.resolve_bypred(f"source_id='bci-app/{SESSION}/{name}'", 1, 60.0)[0])
    found.open_stream()  # what is said before is not heard
    return found


OUT, TRUTH = outlet("bci-stimulus", "Events"), outlet("bci-truth", "Truth")
MARKERS = outlet("bci-markers", "Markers", "int32")


def say(kind, stamp=None, to=OUT, **fields):
    """Send a message, stamped now unless told."""
    message = {"protocol": 5, "session": SESSION, "type": kind, **fields}
    to.push_sample([json.dumps(message)], stamp or pylsl.local_clock())


def wait_for(kind, state="running", **wanted):
    """The next such message; meanwhile say that this program lives, and what it hears."""
    while True:
        for name, stream in inlets.items():
            sample, stamp = stream.pull_sample(timeout=0.05)
            if sample:
                heard[name], message = stamp, json.loads(sample[0])
                if message["type"] == kind and wanted.items() <= message.items():
                    return message
        say("Status", role="stimulus", state=state, hears=heard)


def sensed(cell, goal):
    """Whether the goal is here, and in each neighbouring cell."""
    return [(cell[0] + dr, cell[1] + dc) == goal for dr, dc in [(0, 0), *MOVES.values()]]


def far(cell, goal):
    """Steps from a cell to the goal on an empty map."""
    return abs(cell[0] - goal[0]) + abs(cell[1] - goal[1])


inlets, heard = {name: inlet(name) for name in ("bci-session", "bci-actions")}, {}
wait_for("Command", "ready", command="start")
layout = ["." * 11] * 11
say("SessionStart", task="online", participant="P001", map="open", layout=layout, n_episodes=1)
say("RunSeed", to=TRUTH, seed=0)
cell, goal = (5, 5), (2, 7)
say("EpisodeGoal", to=TRUTH, episode=0, goal=goal, distance=far(cell, goal))
say("EpisodeStart", episode=0, position=cell, sensed=sensed(cell, goal), max_steps=60)
for step in range(1, 61):
    action = wait_for("Action", episode=0, step=step)["action"]
    time.sleep(2)  # your countdown
    before, cell = cell, (cell[0] + MOVES[action][0], cell[1] + MOVES[action][1])
    print(f"move {step}: {action} to {cell}", flush=True)  # show the move, and only then:
    onset = pylsl.local_clock()
    error = far(cell, goal) > far(before, goal)
    say("MoveOnset", onset, episode=0, step=step, action=action, position=cell, sensed=sensed(cell, goal))
    say("Truth", onset, to=TRUTH, episode=0, step=step, error=error, distance=far(cell, goal))
    MARKERS.push_sample([1 + list(MOVES).index(action)], onset)
    if cell == goal:
        break
time.sleep(1)  # the last epoch
say("EpisodeEnd", episode=0, steps=step, reason="goal" if cell == goal else "limit")
say("SessionEnd", reason="complete")
time.sleep(2)  # what is still on its way would be lost with the streams
