"""Which electrodes are bad before an episode: the same live and from the recording, whatever came before."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.protocol import Electrodes, decode, encode
from bci_app.session import LEAD_S
from decoder.background import SyntheticBackground
from decoder.electrodes import RECORDED_S, Examiner, changes
from decoder.epochs import EpochBuffer, Shape
from decoder.montage import MONTAGE_64

SFREQ = 250.0
CHANNELS = MONTAGE_64[::4]
START = (3, 0)


@pytest.fixture(scope="module")
def eeg() -> tuple[np.ndarray, np.ndarray]:
    """30 s of people's EEG with one channel torn off and one dead, float32, and its stamps."""
    samples = SyntheticBackground(seed=0, sfreq=SFREQ).samples(0, round(30 * SFREQ))[:, ::4].astype(np.float32)
    samples[:, 5] = np.nan
    samples[:, 9] = 0.0
    return samples, 4000.0 + np.arange(len(samples)) / SFREQ


def test_what_is_bad_is_told_with_its_faults(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    samples, times = eeg
    found = Examiner("s", CHANNELS, SFREQ).examine(START, samples[-2500:], times[-2500:], since=times[0])
    assert found.bad == {CHANNELS[5]: ["not finite"], CHANNELS[9]: ["flat"]}
    assert (found.episode, found.last_time, found.n_samples) == (3, times[-1], 2500)
    assert decode(encode(found)) == found
    assert changes(None, found) == [
        f"Channel {CHANNELS[5]} is bad: not finite.",
        f"Channel {CHANNELS[9]} is bad: flat.",
    ]
    assert changes(found, found) == []
    assert changes(found, Electrodes(session="s", episode=4)) == [
        f"Channel {CHANNELS[5]} is good again.",
        f"Channel {CHANNELS[9]} is good again.",
    ]


def test_nothing_is_decided_on_too_little(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    samples, times = eeg
    examiner = Examiner("s", CHANNELS, SFREQ)
    nothing = Electrodes(session="s", episode=3)
    assert examiner.examine(START, samples[:0], times[:0], since=-np.inf) == nothing
    assert examiner.examine(START, samples[:900], times[:900], since=-np.inf) == nothing
    assert examiner.examine(START, samples[:2500], times[:2500], since=times[2000]) == nothing
    assert examiner.again(nothing, samples, times) == nothing
    # What held before holds on.
    before = Electrodes(session="s", episode=2, bad={"Fz": ["flat"]}, last_time=times[9], n_samples=10)
    held = examiner.examine(START, samples[:2500], times[:2500], since=times[2000], before=before)
    assert held == Electrodes(session="s", episode=3, bad={"Fz": ["flat"]})
    assert examiner.again(held, samples, times) == held


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_a_recording_gives_the_live_decision_again(eeg: tuple[np.ndarray, np.ndarray], data: st.DataObject) -> None:
    """However its samples came, and although it begins later than the decoder's EEG."""
    samples, times = eeg
    place = data.draw(st.integers(1, len(times)), "samples so far")
    first = data.draw(st.integers(0, 3000), "first recorded")
    chunk = data.draw(st.integers(1, 700), "chunk")
    examiner = Examiner("s", CHANNELS, SFREQ)
    buffer: EpochBuffer[int] = EpochBuffer(Shape(SFREQ, 800, 150), len(CHANNELS), capacity_s=15)
    for start in range(0, place, chunk):
        buffer.push(samples[start : min(start + chunk, place)], times[start : min(start + chunk, place)])
    live = examiner.examine(START, *buffer.trailing(examiner.n_window), since=times[first])
    assert live.n_samples == 0 or live.bad
    assert examiner.again(live, samples[first:], times[first:]) == live


def test_a_decision_whose_samples_are_lost_is_taken_over(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    samples, times = eeg
    examiner = Examiner("s", CHANNELS, SFREQ)
    live = examiner.examine(START, samples[:2500], times[:2500], since=-np.inf)
    assert examiner.again(live, samples[1000:], times[1000:]) == live
    assert examiner.again(live, samples[3000:], times[3000:]) == live
    healed = np.nan_to_num(samples, nan=1.0)
    assert examiner.again(live, healed, times) != live


def test_an_eog_channel_may_be_large_and_unlike_the_others_but_not_dead(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    samples, times = eeg
    blinks = 4000 * np.sin(2 * np.pi * 3 * times)[:, None] * (times % 1 < 0.5)[:, None]
    both = np.hstack((samples, blinks, np.zeros_like(blinks))).astype(np.float32)
    found = Examiner("s", (*CHANNELS, "VEOG", "EOG dead"), SFREQ).examine(START, both, times, since=-np.inf)
    assert set(found.bad) == {CHANNELS[5], CHANNELS[9], "EOG dead"}


def test_what_lies_before_a_gap_is_not_looked_at(eeg: tuple[np.ndarray, np.ndarray]) -> None:
    """After a restart of the amplifier levels differ, and that is no drift."""
    samples, times = eeg
    shifted, later = samples.copy(), times.copy()
    shifted[1250:] += np.random.default_rng(1).normal(0, 2000, samples.shape[1]).astype(np.float32)
    later[1250:] += 20
    examiner = Examiner("s", CHANNELS, SFREQ)
    found = examiner.examine((3, 5), shifted[:2500], later[:2500], since=-np.inf)
    assert set(found.bad) == {CHANNELS[5], CHANNELS[9]}
    assert (found.step, found.n_samples) == (5, 1250)
    assert examiner.again(found, shifted, later) == found


def test_what_is_looked_at_before_the_first_episode_is_recorded_by_then() -> None:
    assert LEAD_S > RECORDED_S + 1
