"""Pictures of everything the participant sees, at any size: the real paradigm is played to each screen and drawn.

python docs/screens.py FOLDER --size 1280x720 --size 3840x2160

Without a folder: docs/screens, at 1280x720, as the pages show them. Give `--texts FOLDER` to look at a translation.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import pygame

from bci_app.config import Config, changed
from bci_app.gridworld import ACTIONS, load_map
from bci_app.protocol import Action, EpisodeStart, MoveOnset, Verdict
from stimulus import lettering
from stimulus.guide import guide
from stimulus.paradigm import Paradigm
from stimulus.scene import Scene
from stimulus.view import draw_backdrop, draw_scene

SHORT = {
    "calibration": {"n_blocks": 5, "moves_per_block": 2, "eye_movements_s": 30},
    "online": {"break_every": 2},
}


class Player:
    """Plays a paradigm in session time, by itself, and hands out what is seen."""

    def __init__(self, paradigm: Paradigm) -> None:
        self.paradigm, self.now = paradigm, 0.0

    def scenes(self) -> Iterator[Scene]:
        """Every scene of the run, tenth of a second by tenth."""
        paradigm = self.paradigm
        while not paradigm.done:
            yield paradigm.scene(self.now)
            if paradigm.waiting_for == "start":
                paradigm.start(self.now)
            elif paradigm.waiting_for == "key":
                paradigm.key_start(self.now)
            self.now += 0.1
            paradigm.update(self.now)
            if paradigm.awaiting_flip:
                paradigm.flipped(self.now)
            self._answer()
        yield paradigm.scene(self.now)

    def _answer(self) -> None:
        """Be decoder and policy."""
        paradigm = self.paradigm
        for out in paradigm.take_messages():
            match out.message:
                case MoveOnset(episode=episode, step=step) if paradigm.needs_verdicts:
                    told = {"session": paradigm.session, "episode": episode, "step": step, "clock_offset": 0.0}
                    paradigm.take_verdict(Verdict(outcome="unjudged", **told), self.now)
                case EpisodeStart() | MoveOnset() as message if paradigm.needs_actions:
                    cell = paradigm.world.cell_at(*message.position)
                    step = getattr(message, "step", 0) + 1
                    name = ACTIONS[int(paradigm.world.legal[cell].argmax())]
                    action = {"episode": message.episode, "step": step, "action": name, "verdict": "missing"}
                    paradigm.offer_action(
                        Action.model_validate({"session": paradigm.session, "probabilities": (1, 0, 0, 0), **action})
                    )


def pictures(config: Config) -> dict[str, Scene]:
    """A scene of each kind, by name."""
    found: dict[str, Scene] = {}
    for task, name in (("calibration", "open"), ("online", "obstacles")):
        make = Paradigm.calibration if task == "calibration" else Paradigm.online
        paradigm = make(config, load_map(name), "s", "P001", 7, guide=guide(config, task))
        player, is_paused = Player(paradigm), False
        for scene in player.scenes():
            found.setdefault(scene.screen or f"{task}_{_moment(scene)}", scene)
            if scene.arrow and not is_paused:
                is_paused = True
                for reason, by_person in (("technical", False), ("person", True)):
                    paradigm.pause(player.now, reason, by_person)
                    paradigm.update(player.now + 2.5)
                    player.now += 2.5
                    found.setdefault("pause" if by_person else "waiting", paradigm.scene(player.now))
                paradigm.resume(player.now)
    paradigm = Paradigm.online(config, load_map("open"), "s", "P001", 7)
    paradigm.stop(0.0, "interrupted")
    found["stopped"] = paradigm.scene(0.0)
    return found


def _moment(scene: Scene) -> str:
    """Which part of a move a scene shows."""
    if scene.countdown is None:
        return "arrow" if scene.arrow else "rest"
    return "countdown" if 0.5 < scene.countdown < 0.95 else "countdown_begins"


def main() -> None:
    """Draw all of them into a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent / "screens")
    parser.add_argument("--size", action="append", help="WIDTHxHEIGHT; may be repeated")
    parser.add_argument("--texts", default="en")
    parser.add_argument("--photodiode", default=None)
    arguments = parser.parse_args()
    stimulus = {"texts": arguments.texts, "photodiode": arguments.photodiode}
    config = changed(Config(), {"stimulus": stimulus, **SHORT})
    corner, font = config.stimulus.photodiode, config.stimulus.font
    pygame.font.init()
    for words in arguments.size or ["1280x720"]:
        width, height = map(int, words.split("x"))
        lettering.check(guide(config, "online").texts, (width, height), font)
        folder = arguments.folder / words if arguments.size else arguments.folder
        folder.mkdir(parents=True, exist_ok=True)
        for name, scene in pictures(config).items():
            surface = pygame.Surface((width, height))
            draw_scene(surface, scene, draw_backdrop((width, height), scene.world, corner), corner, font)
            pygame.image.save(surface, folder / f"{name}.png")
            print(folder / f"{name}.png")


if __name__ == "__main__":
    main()
