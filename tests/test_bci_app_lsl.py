"""What comes over a stream is taken in portions."""

from lsl_peers import ForeignStimulus, until

from bci_app.lsl import MOST_AT_ONCE, MessageInlet
from bci_app.protocol import STIMULUS, MoveOnset


def test_whoever_is_flooded_gets_on_and_loses_nothing() -> None:
    stimulus = ForeignStimulus("flood")
    inlet = until(lambda: MessageInlet.find(STIMULUS, "flood", timeout=1.0), 60, "the stream")
    until(stimulus.has_listeners, 60, "the connection")
    for number in range(2 * MOST_AT_ONCE):
        stimulus.raw("nonsense")
        stimulus.move(1 + number % 60, onset=1.0 + number)
    portions = []

    def takes() -> bool:
        portions.append(inlet.pull(0.1))
        return sum(map(len, portions)) + len(inlet.refused) >= 4 * MOST_AT_ONCE

    until(takes, 60, "all of it")
    assert max(map(len, portions)) <= MOST_AT_ONCE
    assert len(portions) >= 4
    assert [item.stamp for portion in portions for item in portion] == [
        1.0 + number for number in range(2 * MOST_AT_ONCE)
    ]
    assert all(isinstance(item.message, MoveOnset) for portion in portions for item in portion)
    assert len(inlet.refused) == 2 * MOST_AT_ONCE
