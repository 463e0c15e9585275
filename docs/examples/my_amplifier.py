"""An amplifier for bci-app, with noise where a device's samples would be: `python my_amplifier.py`."""

import time

import numpy as np
import pylsl

LABELS = [
    "Fp1",
    "Fp2",
    "F7",
    "F3",
    "Fz",
    "F4",
    "F8",
    "FC5",
    "FC1",
    "FCz",
    "FC2",
    "FC6",
    "T7",
    "C3",
    "Cz",
    "C4",
    "T8",
    "CP5",
    "CP1",
    "CP2",
    "CP6",
    "P7",
    "P3",
    "Pz",
    "P4",
    "P8",
    "POz",
    "O1",
    "Oz",
    "O2",
]
RATE = 250
info = pylsl.StreamInfo("MyAmp", "EEG", len(LABELS), RATE, "float32", "MyAmp-serial-1")
channels = info.desc().append_child("channels")
for label in LABELS:
    channel = channels.append_child("channel")
    channel.append_child_value("label", label)
    channel.append_child_value("type", "EEG")
    channel.append_child_value("unit", "microvolts")

outlet, started, sent = pylsl.StreamOutlet(info), pylsl.local_clock(), 0
rng = np.random.default_rng(1)
mixing = rng.normal(0, 8, (3, len(LABELS)))  # neighbours share what the brain does; yours come from the device
while True:
    due = int((pylsl.local_clock() - started) * RATE)
    if due > sent:
        n = due - sent
        samples = rng.normal(0, 1, (n, 3)) @ mixing + rng.normal(0, 1, (n, len(LABELS)))
        stamps = started + np.arange(sent, due) / RATE  # when each sample was acquired
        outlet.push_chunk(samples.astype(np.float32), stamps.tolist())
        sent = due
    time.sleep(0.01)
