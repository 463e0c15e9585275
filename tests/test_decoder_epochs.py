"""Epochs: the same to the bit however samples and markers come, and a reason whenever there is none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bci_app.errors import SetupError
from decoder.epochs import Epoch, EpochBuffer, Rejection, Shape, cut_recording
from decoder.timeline import check_rate, find_gap

SFREQ = 250.0
SHAPE = Shape(SFREQ, n_before=800, n_after=150)


def recording(seconds: float, n_channels: int = 3, start: float = 5000.0) -> tuple[np.ndarray, np.ndarray]:
    """A sample counter in channel 0, and even stamps."""
    n_times = round(seconds * SFREQ)
    samples = np.random.default_rng(0).normal(0, 10, (n_times, n_channels)).astype(np.float32)
    samples[:, 0] = np.arange(n_times)
    return samples, start + np.arange(n_times) / SFREQ


def arrival_stamps(times: np.ndarray, chunk: int, phase: int = 0) -> np.ndarray:
    """Stamps 10 us apart from the arrival of a chunk, that is of its last sample."""
    index = np.arange(len(times)) + phase
    arrival = times[0] + ((index // chunk + 1) * chunk - 1 - phase) / SFREQ
    return arrival + index % chunk * 1e-5


def same(a: Epoch | Rejection, b: Epoch | Rejection) -> bool:
    if isinstance(a, Epoch) and isinstance(b, Epoch):
        return a.data.tobytes() == b.data.tobytes() and (a.first_time, a.last_time) == (b.first_time, b.last_time)
    return a == b


def only(result: list[Epoch | Rejection]) -> Epoch | Rejection:
    assert len(result) == 1
    return result[0]


def reason(result: Epoch | Rejection) -> str:
    assert isinstance(result, Rejection)
    return result.reason


@pytest.mark.parametrize(("shift", "sample"), [(0.0, 1500), (0.0019, 1500), (0.0021, 1501), (-0.0019, 1500)])
def test_the_onset_is_the_nearest_sample(shift: float, sample: int) -> None:
    samples, times = recording(10)
    epoch = only(cut_recording(samples, times, [times[1500] + shift], SHAPE))
    assert isinstance(epoch, Epoch)
    assert epoch.data[SHAPE.n_before, 0] == sample
    assert (epoch.first_time, epoch.last_time) == (times[sample - 800], times[sample + 149])
    assert epoch.n_samples == 950
    assert epoch.data.dtype == np.float64
    assert epoch.data.flags.c_contiguous


@pytest.mark.trouble("mne-realtime #10, mne-python #11078: what is computed offline differs from online")
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_live_is_the_recording_to_the_bit(data: st.DataObject) -> None:
    """Any chunks; markers early, in time or late, out of order and doubled; lost samples, steps back, odd stamps."""
    samples, times = recording(24)
    if data.draw(st.booleans(), "arrival"):
        times = arrival_stamps(times, data.draw(st.integers(2, 9)))
    lost = data.draw(st.lists(st.integers(0, len(times) - 1), max_size=3), "lost")
    kept = np.delete(np.arange(len(times)), lost)
    samples, times = samples[kept], times[kept].copy()
    if data.draw(st.booleans(), "back"):
        times[data.draw(st.integers(1, len(times) - 1)) :] -= data.draw(st.sampled_from([0.02, 0.5, 3.0]))
    if data.draw(st.booleans(), "nan"):
        samples[data.draw(st.integers(0, len(times) - 1)), 1] = np.nan
    onsets = data.draw(st.lists(st.floats(4998, 5026), min_size=1, max_size=6), "onsets")
    buffer: EpochBuffer[int] = EpochBuffer(SHAPE, 3, capacity_s=30)
    told = sorted((data.draw(st.integers(0, len(times) - 1)), key) for key in range(len(onsets)))
    live: dict[int, Epoch | Rejection] = {}
    chunks = data.draw(st.lists(st.integers(1, 2000), min_size=1, max_size=4), "chunks")
    place = turn = 0
    while place < len(times):
        while told and told[0][0] <= place:
            key = told.pop(0)[1]
            assert buffer.expect(key, onsets[key])
            assert not buffer.expect(key, onsets[key] + 1)
        n_new, turn = max(chunks[turn % len(chunks)], 20), turn + 1
        buffer.push(samples[place : place + n_new], times[place : place + n_new])
        place += n_new
        for key, result in buffer.poll():
            assert key not in live
            live[key] = result
    for _, key in told:
        buffer.expect(key, onsets[key])
    live |= dict(buffer.poll())
    buffer.abandon("over")
    live |= dict(buffer.poll())
    for key, expected in enumerate(cut_recording(samples, times, onsets, SHAPE)):
        if isinstance(expected, Epoch) or isinstance(live[key], Epoch):
            # A step back may bring an onset's time a second time; live, the first one counts if it was told by then.
            assert same(live[key], expected)


@pytest.mark.trouble("mne-lsl #369, #565: epochs are lost or doubled when the marker comes before its samples")
@settings(max_examples=40, deadline=None)
@given(chunks=st.lists(st.integers(1, 400), min_size=1, max_size=20), early=st.booleans())
def test_chunks_dont_matter(chunks: list[int], early: bool) -> None:
    samples, times = recording(40)
    onsets = [5002.0, 5004.1, 5010.0, 5020.05, 5039.9]
    times[3000:] += 0.2
    results = []
    for sizes in (chunks, [len(times)]):
        buffer: EpochBuffer[int] = EpochBuffer(SHAPE, 3, capacity_s=7)
        place, turn = 0, 0
        for key, onset in enumerate(onsets):
            buffer.expect(key, onset)
        while place < len(times):
            n_new = sizes[turn % len(sizes)]
            buffer.push(samples[place : place + n_new], times[place : place + n_new])
            place, turn = place + n_new, turn + 1
        results.append(dict(buffer.poll()))
    assert results[0].keys() == results[1].keys() == {0, 1, 2, 3}
    assert all(same(results[0][key], results[1][key]) for key in results[0])


def test_the_verdict_is_ready_with_the_last_sample() -> None:
    samples, times = recording(10)
    buffer: EpochBuffer[str] = EpochBuffer(SHAPE, 3, capacity_s=10)
    buffer.expect("move", times[1500])
    buffer.push(samples[:1649], times[:1649])
    assert not buffer.poll()
    assert buffer.n_waiting == 1
    buffer.push(samples[1649:1650], times[1649:1650])
    assert [key for key, _ in buffer.poll()] == ["move"]


@pytest.mark.trouble("App-WearableSensing #4: samples 10 us apart, then 35 ms")
@pytest.mark.parametrize("phase", range(0, 9, 2))
def test_stamps_of_arrival_give_epochs_at_the_right_place(phase: int) -> None:
    """35 ms chunks stamped on arrival: every epoch is cut, at the very sample of even stamps."""
    samples, times = recording(20)
    onsets = (5004 + np.arange(0, 14, 0.7)).tolist()
    on_arrival = cut_recording(samples, arrival_stamps(times, 9, phase), onsets, SHAPE)
    even = cut_recording(samples, times, onsets, SHAPE)
    shifts = [a.data[0, 0] - b.data[0, 0] for a, b in zip(on_arrival, even, strict=True)]
    # The stamp a chunk's last sample has on arrival is 80 us late: that can be a sample on a boundary.
    assert np.abs(shifts).max() <= 1
    assert np.mean(np.array(shifts) == 0) > 0.9


def test_chunks_that_come_a_little_late_and_come_back_are_no_gap() -> None:
    samples, times = recording(20)
    late = times + np.repeat(np.random.default_rng(1).exponential(0.002, 1000), 5)
    results = cut_recording(samples, late, np.arange(5004.0, 5019.0).tolist(), SHAPE)
    assert sum(isinstance(result, Epoch) for result in results) >= 14


@pytest.mark.trouble("BciPy #308: samples vanish and nothing says so")
@pytest.mark.parametrize("chunk", [1, 9])
def test_one_lost_sample_rejects_the_epochs_that_hold_it_and_no_other(chunk: int) -> None:
    samples, times = recording(30)
    kept = np.delete(np.arange(len(times)), 3000)
    onsets = (5005 + np.arange(0, 20, 0.5)).tolist()
    stamps = arrival_stamps(times, chunk)[kept]
    for onset, result in zip(onsets, cut_recording(samples[kept], stamps, onsets, SHAPE), strict=True):
        first, last = onset - 800 / SFREQ, onset + 150 / SFREQ
        margin = 0.1 if chunk > 1 else 0.005
        if first + margin < 5012 < last - margin:
            assert "gap" in reason(result)
        elif not first - margin < 5012 < last + margin:
            assert isinstance(result, Epoch)


def test_an_onset_in_a_drop_out_is_a_gap() -> None:
    samples, times = recording(30)
    kept = np.r_[0:3000, 3500:7500]
    assert "gap" in reason(only(cut_recording(samples[kept], times[kept], [5013.0], SHAPE)))


@pytest.mark.trouble("labstreaminglayer #102, #131: times jump by 200,000 s, or backwards")
@pytest.mark.parametrize("jump", [-200_000, -30, 30, 200_000])
def test_a_clock_that_jumps_and_comes_back_costs_only_what_lies_between(jump: float) -> None:
    samples, times = recording(60)
    onsets = [float(times[row]) for row in (2700, 5500, 9500, 12000)]  # before, while it is off, just after, later
    times[5000:9000] += jump
    found = cut_recording(samples, times, onsets, SHAPE)
    assert [isinstance(item, Epoch) for item in found] == [True, False, False, True]
    buffer: EpochBuffer[int] = EpochBuffer(SHAPE, samples.shape[1], 60)
    live: dict[int, Epoch | Rejection] = {}
    for start in range(0, len(times), 50):
        for number, row in enumerate((2700, 5500, 9500, 12000)):
            if start == row + 50:
                buffer.expect(number, onsets[number])
        if 5000 <= start < 9000:
            buffer.abandon("its time stamps have moved")
        buffer.push(samples[start : start + 50], times[start : start + 50])
        live |= dict(buffer.poll())
    for number, item in enumerate(found):
        if isinstance(item, Epoch):
            here = live[number]
            assert isinstance(here, Epoch)
            assert np.array_equal(here.data, item.data)
        else:
            assert isinstance(live[number], Rejection)


@pytest.mark.trouble("labstreaminglayer #102, #131: times jump by 200,000 s, or backwards")
@pytest.mark.parametrize("jump", [-200_000, -0.5, 0.5, 200_000])
def test_nothing_is_cut_across_a_jump_in_time(jump: float) -> None:
    samples, times = recording(30)
    times[3000:] += jump
    across, before, after = cut_recording(samples, times, [times[2900], times[2700], times[4000]], SHAPE)
    assert "gap" in reason(across)
    assert isinstance(before, Epoch)
    assert isinstance(after, Epoch)


def test_reasons() -> None:
    samples, times = recording(10)
    assert "begins only" in reason(only(cut_recording(samples, times, [5001.0], SHAPE)))
    assert "begins" in reason(only(cut_recording(samples, times, [4999.0], SHAPE)))
    assert "ends" in reason(only(cut_recording(samples, times, [5009.8], SHAPE)))
    assert "before the onset" in reason(only(cut_recording(samples, times, [5019.8], SHAPE)))


def test_a_late_onset_says_so_and_silence_can_be_called() -> None:
    samples, times = recording(30)
    buffer: EpochBuffer[str] = EpochBuffer(SHAPE, 3, capacity_s=7)
    buffer.push(samples, times)
    buffer.expect("late", 5010.0)
    buffer.expect("waiting", 5031.0)
    late = buffer.poll()[0][1]
    assert "too late" in reason(late)
    assert isinstance(late, Rejection)
    assert late.by_time  # the samples don't tell: a replay takes it over
    buffer.abandon("the EEG is silent")
    assert buffer.poll() == [("waiting", Rejection("the EEG is silent", by_time=True))]
    assert buffer.poll() == []


def test_a_buffer_must_hold_an_epoch() -> None:
    with pytest.raises(SetupError, match=r"eeg\.buffer_s"):
        EpochBuffer(SHAPE, 3, capacity_s=4)


def test_the_rate_is_measured_through_jitter_and_gaps() -> None:
    times = 5000 + np.arange(5000) / 250.4
    assert check_rate(np.delete(times, np.r_[2000:2100]), 250.0, "X", 0.01) == pytest.approx(250.4, abs=0.01)
    assert check_rate(arrival_stamps(5000 + np.arange(2500) / SFREQ, 9), SFREQ, "X", 0.01) == pytest.approx(250, abs=1)
    for phase in range(9):  # three seconds of them
        check_rate(arrival_stamps(5000 + np.arange(750) / SFREQ, 9, phase), SFREQ, "X", 0.01)
    rng = np.random.default_rng(0)
    for share in (0.01, 0.05):  # packets of 10 ms lost in bursts of five, as by radio
        lost = np.repeat(np.convolve(rng.random(500) < share / 5, np.ones(5), "same") > 0, 5)
        assert 0 < lost.mean() < 3 * share + 0.05
        check_rate((5000 + np.arange(2500) / 500)[~lost], 500.0, "X", 0.01)
    with pytest.raises(SetupError, match="delivers 24"):
        check_rate(5000 + np.arange(750) / 245, SFREQ, "X", 0.01)
    with pytest.raises(SetupError, match=r"'X' says 500 Hz but delivers 480\.2 Hz"):
        check_rate(np.arange(5000) / 480.2, 500.0, "X", 0.01)
    with pytest.raises(SetupError, match="stands still"):
        check_rate(np.zeros(100), 500.0, "X", 0.01)


@settings(max_examples=60, deadline=None)
@given(
    sfreq=st.sampled_from([128.0, 250.0, 500.0, 1000.0]),
    lost=st.integers(1, 50),
    place=st.floats(0.1, 0.9),
    drift=st.floats(-0.003, 0.003),
)
def test_gaps_in_even_stamps_are_found_and_counted(sfreq: float, lost: int, place: float, drift: float) -> None:
    times = 7e5 + np.arange(round(4 * sfreq)) / (sfreq * (1 + drift))
    assert find_gap(times, sfreq) is None
    first = round(place * len(times))
    found = find_gap(np.delete(times, np.arange(first, first + lost)), sfreq)
    assert found is not None
    assert found[0] == first
    assert found[1] == pytest.approx(lost, abs=1)


def test_void_moves_may_come_again_and_judged_ones_are_known() -> None:
    samples, times = recording(30)
    buffer: EpochBuffer[tuple[int, int]] = EpochBuffer(SHAPE, 3, capacity_s=30)
    buffer.know((0, 1))
    assert not buffer.expect((0, 1), 5010.0)
    assert buffer.expect((0, 2), 5031.0)
    assert buffer.expect((0, 3), 5033.0)
    buffer.push(samples, times)
    buffer.forget(lambda key: key > (0, 2))
    assert buffer.n_waiting == 1
    assert buffer.expect((0, 3), 5012.0)
    assert [key for key, _ in buffer.poll()] == [(0, 3)]
    assert not buffer.expect((0, 1), 5010.0)


def test_what_is_long_over_is_not_kept_but_what_waits_is() -> None:
    buffer: EpochBuffer[tuple[int, int]] = EpochBuffer(SHAPE, 3, capacity_s=30)
    buffer.know((0, 1))
    assert buffer.expect((0, 2), 5031.0)
    buffer.done_with(lambda key: key[0] < 1)
    assert not buffer.expect((0, 2), 5031.0)
    assert buffer.expect((0, 1), 5031.0)
