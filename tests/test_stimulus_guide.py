"""What the participant reads, practises and is asked, before the moves that count and between them."""

from pathlib import Path

import pytest
from test_stimulus_paradigm import OPEN, Runner, action, kinds
from test_stimulus_recollection import Second, memory_of

from bci_app.clock import Clock
from bci_app.config import Config, changed
from bci_app.errors import SetupError
from bci_app.gridworld import ACTIONS
from bci_app.protocol import (
    BlockStart,
    EpisodeEnd,
    EpisodeStart,
    MoveOnset,
    Note,
    Pause,
    SessionEnd,
    Truth,
)
from stimulus import texts
from stimulus.guide import guide
from stimulus.keyboard import Keyboard
from stimulus.lettering import check
from stimulus.paradigm import Paradigm

PERSON = changed(Config(), {"calibration": {"n_blocks": 2, "moves_per_block": 4, "break_s": 2}})
EYES = changed(PERSON, {"calibration": {"eye_movements_s": 3}})


def calibration(config: Config = PERSON) -> Paradigm:
    return Paradigm.calibration(config, OPEN, "s", "P001", 7, guide=guide(config, "calibration"))


def online(**keys: object) -> Paradigm:
    config = changed(Config(), {"online": {"distances": (2, 6), **keys}})
    return Paradigm.online(config, OPEN, "s", "P001", 7, guide=guide(config, "online"))


def turned(runner: Runner, screens: list[str] | None = None) -> Runner:
    """Every page and break ended by its key, every online move made; the screens in order go to `screens`."""
    paradigm = runner.paradigm
    while not paradigm.done:
        scene = paradigm.scene(runner.now)
        if screens is not None and scene.screen and scene.screen != (screens or [None])[-1]:
            screens.append(scene.screen)
        if paradigm.waiting_for == "key":
            runner.now += 1
            paradigm.key_start(runner.now)
            runner.take()
        elif paradigm.waiting_for == "action":
            act(runner)
        elif not runner.step():
            break
    return runner


def act(runner: Runner) -> None:
    cell = runner.paradigm.scene(runner.now).agent
    assert cell is not None
    episode, steps = runner.paradigm.place
    legal = int(runner.paradigm.world.legal[cell].argmax())
    assert runner.paradigm.offer_action(action(episode, steps + 1, ACTIONS[legal])) is None
    runner.paradigm.update(runner.now)
    if runner.paradigm.awaiting_flip:
        runner.paradigm.flipped(runner.now)
    runner.take()


# Instructions and practice


def test_a_person_reads_practises_and_reads_before_the_first_block() -> None:
    screens: list[str] = []
    runner = turned(Runner(calibration(EYES)), screens)
    assert screens[:4] == ["calibration", "practice", "practising", "practice_over"]
    assert screens[4:8] == ["eyes", "blink", "look_sideways", "look_up_down"]
    assert screens[8:] == ["break", "break_over"]
    assert len(runner.of(MoveOnset)) == len(runner.of(Truth)) == 8
    names = [name for name in kinds(runner.sent) if name != "Note"]
    assert names[:3] == ["SessionStart", "BlockStart", "EpisodeStart"]  # nothing of the practice is said


def test_practice_shows_right_and_wrong_moves_and_leaves_the_run_as_it_is() -> None:
    plain = Runner(Paradigm.calibration(PERSON, OPEN, "s", "P001", 7))
    guided = Runner(calibration())
    seen, before, errors = [], None, []
    while guided.paradigm.scene(guided.now).screen != "practice_over":
        if guided.paradigm.waiting_for == "key":
            guided.paradigm.key_start(guided.now)
        else:
            guided.step()
        scene = guided.paradigm.scene(guided.now)
        if scene.arrow and scene.arrow != before:
            seen.append(scene)
            errors.append(OPEN.is_error(*scene.arrow, scene.goal))
        before = scene.arrow
    assert errors[:5] == [False, False, True, False, False]
    assert len(errors) == 6  # the last would be an error, but its agent stands in a corner, whence all ways lead nearer
    assert all(scene.screen == "practising" and not scene.light and not scene.moved for scene in seen)
    assert not guided.of(MoveOnset)
    turned(plain)
    turned(guided)
    made = [[out.message for out in runner.of(MoveOnset)] for runner in (plain, guided)]
    assert made[0] == made[1]


@pytest.mark.parametrize(
    ("change", "steps"),
    [
        ({"stimulus": {"headless": True}}, ()),
        ({"stimulus": {"person": False}}, ()),
        ({"calibration": {"wait_for_key": False}}, ("calibration", "practice", "practising", "practice_over")),
        ({"stimulus": {"instructions": False}}, ()),
        ({"calibration": {"practice_moves": 0}}, ("calibration",)),
        ({"stimulus": {"headless": True}, "calibration": {"practice_moves": 2}}, ("practising",)),
    ],
)
def test_pages_need_a_reader_and_practice_can_be_asked_for(change: dict[str, object], steps: tuple[str, ...]) -> None:
    assert guide(changed(Config(), change), "calibration").steps == steps


def test_a_pause_in_a_page_and_in_the_practice_comes_back_there() -> None:
    runner = Runner(calibration())
    for expected in ("calibration", "practice", "practising"):
        assert runner.paradigm.scene(runner.now).screen == expected
        runner.paradigm.pause(runner.now, "a question", by_person=True)
        assert runner.paradigm.scene(runner.now).screen == "pause"
        assert "Escape" in runner.paradigm.scene(runner.now).foot
        runner.now += 3
        runner.paradigm.key_start(runner.now)  # no key of a pause turns a page
        runner.paradigm.resume(runner.now)
        assert runner.paradigm.scene(runner.now).screen == expected
        runner.paradigm.key_start(runner.now)
    assert len(turned(runner).of(MoveOnset)) == 8


@pytest.mark.parametrize("n_keys", [0, 1, 2, 3])
def test_a_stimulus_that_dies_before_the_first_block_begins_with_the_instructions(n_keys: int) -> None:
    first = Runner(calibration())
    for _ in range(n_keys):
        first.paradigm.key_start(first.now)
    before = [out for out in first.sent if not isinstance(out.message, BlockStart)]
    second = Second(calibration(), memory_of(before), first.now + 10)
    assert second.paradigm.scene(second.now).screen == "waiting"
    second.resume()
    assert second.paradigm.scene(second.now).screen == "calibration"
    assert len(turned(second).of(BlockStart)) == 2
    assert second.paradigm.done


# Breaks and progress


def test_breaks_of_an_online_run_come_every_few_episodes_and_end_by_a_key() -> None:
    runner = Runner(online(break_every=2))
    paradigm = runner.paradigm
    assert paradigm.scene(runner.now).screen == "online"
    progress = []
    while not paradigm.done:
        scene = paradigm.scene(runner.now)
        if scene.screen == "break_online":
            progress.append(scene.progress)
            assert f"{len(progress) * 2} of 5" in str(scene.text)
            runner.now += 40
        if paradigm.waiting_for == "key":
            paradigm.key_start(runner.now)
            runner.take()
        elif paradigm.waiting_for == "action":
            act(runner)
        else:
            assert runner.step()
    assert progress == [(2, 5), (4, 5)]
    assert len(runner.of(EpisodeEnd)) == 5


def test_an_online_run_is_finished_after_the_episode_under_way() -> None:
    runner = Runner(online(break_every=0))
    runner.paradigm.key_start(runner.now)
    runner.until(lambda: runner.paradigm.waiting_for == "action")
    runner.paradigm.finish(runner.now)
    turned(runner)
    assert len(runner.of(EpisodeStart)) == len(runner.of(EpisodeEnd)) == 1
    assert runner.of(EpisodeEnd)[0].message.reason in ("goal", "limit")
    assert runner.sent[-1].message == SessionEnd(session="s", reason="complete")


def test_a_stimulus_that_dies_in_an_online_break_comes_back_into_it() -> None:
    runner = Runner(online(break_every=2))
    while runner.paradigm.scene(runner.now).screen != "break_online":
        if runner.paradigm.waiting_for == "key":
            runner.paradigm.key_start(runner.now)
        elif runner.paradigm.waiting_for == "action":
            act(runner)
        else:
            runner.step()
    second = Second(online(break_every=2), memory_of(runner.sent, {}), runner.now + 5)
    second.resume()
    scene = second.paradigm.scene(second.now)
    assert (scene.screen, scene.progress) == ("break_online", (2, 5))
    turned(second)
    assert len(runner.of(EpisodeEnd)) + len(second.of(EpisodeEnd)) == 5


# The photodiode's patch, and what it measures


def test_the_patch_changes_with_each_jump_and_with_nothing_else() -> None:
    paradigm = calibration()
    runner, light, n_changes = Runner(paradigm), False, 0
    while not paradigm.done:
        if paradigm.waiting_for == "key":
            paradigm.key_start(runner.now)
        due = paradigm.next_due()
        runner.now = max(runner.now, due or runner.now)
        paradigm.update(runner.now)
        scene = paradigm.scene(runner.now)
        assert (scene.light != light) == scene.moved
        n_changes += scene.light != light
        light = scene.light
        if paradigm.awaiting_flip:
            paradigm.flipped(runner.now)
        runner.take()
    assert n_changes == len(runner.of(MoveOnset)) == 8


def test_onsets_are_stamped_when_the_light_comes_and_timed_by_their_flips() -> None:
    late = changed(PERSON, {"stimulus": {"photon_delay_ms": 25.0, "headless": True}})
    plain = changed(PERSON, {"stimulus": {"headless": True}})
    runs = [Runner(Paradigm.calibration(config, OPEN, "s", "P001", 7)) for config in (plain, late)]
    for runner in runs:
        runner.all()
    stamps = [[out.stamp for out in runner.sent if isinstance(out.message, MoveOnset | Truth)] for runner in runs]
    assert [b - a for a, b in zip(*stamps, strict=True)] == pytest.approx([0.025] * 16)
    notes = [[out.message.text for out in runner.of(Note) if isinstance(out.message, Note)] for runner in runs]
    assert notes[0] == []
    assert "25 ms after their flips" in notes[1][0]
    assert [out.stamp for out in runs[0].of(SessionEnd)] == [out.stamp for out in runs[1].of(SessionEnd)]


# Keys


def keyboard(paradigm: Paradigm) -> Keyboard:
    return Keyboard(paradigm, Clock(lambda: 0.0))


def test_a_stray_escape_costs_a_pause_and_a_second_one_ends() -> None:
    runner = Runner(Paradigm.calibration(PERSON, OPEN, "s", "P001", 7))
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    keys = keyboard(runner.paradigm)
    keys.pressed("stop", runner.now, commanded=False)
    while runner.step():
        pass
    assert runner.of(Pause)
    keys.pressed("start", runner.now + 1, commanded=False)
    runner.until(lambda: len(runner.of(MoveOnset)) == 2)
    keys.pressed("stop", runner.now, commanded=False)
    keys.pressed("stop", runner.now + 9, commanded=False)
    assert not runner.paradigm.done
    keys.pressed("stop", runner.now + 10, commanded=False)
    runner.take()
    assert runner.paradigm.done
    assert runner.of(SessionEnd)[0].message.reason == "interrupted"


def test_one_escape_in_an_experimenters_pause_ends_nothing() -> None:
    runner = Runner(Paradigm.calibration(PERSON, OPEN, "s", "P001", 7))
    runner.until(lambda: len(runner.of(MoveOnset)) == 1)
    runner.paradigm.pause(runner.now, "asked for at the console", by_person=True)
    while runner.step():
        pass
    keyboard(runner.paradigm).pressed("stop", runner.now, commanded=True)
    assert runner.paradigm.is_paused_by_person
    assert not runner.paradigm.done


def test_escape_before_the_start_must_be_pressed_twice_soon() -> None:
    paradigm = Paradigm.calibration(PERSON, OPEN, "s", "P001", 7)
    keys = keyboard(paradigm)
    keys.pressed("stop", 10.0, commanded=True)
    keys.pressed("stop", 15.0, commanded=True)
    assert paradigm.waiting_for == "start"
    keys.pressed("start", 15.5, commanded=True)  # bci-app begins it, no key
    assert paradigm.waiting_for == "start"
    keys.pressed("stop", 16.0, commanded=True)
    assert paradigm.done


def test_bci_app_goes_on_after_a_persons_pause_when_the_person_is_ready() -> None:
    runner = Runner(calibration())
    keys = keyboard(runner.paradigm)
    keys.pressed("pause", runner.now, commanded=True)
    assert runner.paradigm.is_paused_by_person
    keys.pressed("start", runner.now + 1, commanded=True)
    assert runner.paradigm.waiting_for == "resume"
    assert not runner.paradigm.is_paused_by_person


# Texts


def copied(folder: Path) -> Path:
    for name in texts.NAMES:
        (folder / f"{name}.txt").write_text(texts.english()[name], encoding="utf-8")
    return folder


def test_a_translation_is_shown(tmp_path: Path) -> None:
    copied(tmp_path)
    (tmp_path / "break.txt").write_text("\ufeffPause\n\n{total} Teile, {done} geschafft.\n", encoding="utf-8")
    config = changed(PERSON, {"stimulus": {"texts": str(tmp_path)}})
    runner = Runner(Paradigm.calibration(config, OPEN, "s", "P", 7, guide=guide(config, "calibration")))
    while runner.paradigm.scene(runner.now).screen != "break":
        runner.paradigm.key_start(runner.now)
        runner.step()
    assert runner.paradigm.scene(runner.now).text == "Pause\n2 Teile, 1 geschafft."


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: (folder / "pause.txt").unlink(), r"lacks pause\.txt"),
        (lambda folder: (folder / "end.txt").write_text(" \n"), r"end\.txt is empty"),
        (lambda folder: (folder / "end.txt").write_bytes(b"\xff\xfe\xff"), "Save it as UTF-8"),
        (lambda folder: (folder / "break.txt").write_text("{block} is done"), "may have the places"),
        (lambda folder: (folder / "break.txt").write_text("{done is"), "a brace too many or too few"),
    ],
)
def test_texts_that_cant_be_shown_are_refused(tmp_path: Path, spoil: object, says: str) -> None:
    spoil(copied(tmp_path))  # type: ignore[operator]
    with pytest.raises(SetupError, match=says):
        texts.load(str(tmp_path))


def test_a_language_that_isnt_there_is_refused() -> None:
    with pytest.raises(SetupError, match=r"neither a language \(en\) nor a folder"):
        texts.load("tlh")


def test_a_text_that_is_too_long_or_has_letters_the_font_lacks_is_refused_before_anything_starts() -> None:
    english = texts.english()
    for size in ((200, 200), (880, 880), (1280, 720), (1920, 1080), (3840, 2160), (1080, 1920)):
        check(english, size, None)
    with pytest.raises(SetupError, match=r"online\.txt is too long for the screen of 1280 x 720"):
        check(changed_text("online", "Very much to read. " * 60), (1280, 720), None)
    with pytest.raises(SetupError, match=r"break_online\.txt is too long"):
        check(changed_text("break_online", "Break\n" * 9), (1280, 720), None)
    with pytest.raises(SetupError, match=r"stimulus\.font"):
        check(changed_text("online", "右か左か"), (1280, 720), None)
    with pytest.raises(SetupError, match="There is no font"):
        check(english, (1280, 720), "absent.ttf")


def changed_text(name: str, text: str) -> texts.Texts:
    english = texts.english()
    return texts.Texts(english.where, {**english.by_name, name: text})


def test_every_screen_of_a_run_has_its_text() -> None:
    for task in ("calibration", "online"):
        assert set(guide(EYES, task).steps) <= {*texts.NAMES, "practising"}
