"""How well streams of messages are heard, and what is said of it."""

from hypothesis import given
from hypothesis import strategies as st

from bci_app.links import SILENT_S, Links


def test_silence_is_told_within_a_second_and_ends_with_a_word() -> None:
    links = Links("s", "session")
    links.take("bci-verdicts", 10.0)
    assert links.changes(10.0 + SILENT_S) == []
    assert links.changes(10.0 + SILENT_S + 0.05) == ["Nothing was heard on bci-verdicts for 1.1 s."]
    assert links.silent == ("bci-verdicts",)
    assert links.changes(12.0) == []  # once
    links.take("bci-verdicts", 12.5)
    assert links.changes(12.5) == ["bci-verdicts is heard again."]
    (link,) = links.told(12.75, {"bci-verdicts": 0.002})
    assert (link.role, link.stream, link.age_s, link.offset_s, link.reconnects) == (
        "session",
        "bci-verdicts",
        0.25,
        0.002,
        1,
    )


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0.0, 3.0)), max_size=60))
def test_a_stream_is_silent_exactly_while_its_last_word_is_older_than_a_second(words: list[tuple[str, float]]) -> None:
    links, now, heard = Links("s", "session"), 0.0, {}
    for stream, later in words:
        now += later
        links.changes(now)
        assert set(links.silent) == {name for name, when in heard.items() if now - when > SILENT_S}
        links.take(stream, now)
        heard[stream] = now
