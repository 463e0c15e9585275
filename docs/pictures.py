"""All pictures of the pages: the participant's screens, the console and the report, of one demo session.

python docs/pictures.py

It plays `bci-app demo` with a console beside it (about 5 minutes), and takes the console's pictures while the run on
the map with obstacles lasts. `--report FOLDER` makes only the report's pictures, of recordings that are there. Needs
what `pip install -e .[test]` installs, and Chromium.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

HERE = Path(__file__).parent
FOLDER = HERE / "pictures"
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
PATIENCE_MS = 1_200_000
LATE = {"what": r"obstacles", "n_episodes": r"^([89]|1\d)$", "where": r"move ([7-9]|1\d)\b"}
"""A moment of the run with something to show: what the page's elements say then."""
FIGURES = ("erp_calibration",)


def bci_app(*words: object) -> list[str]:
    """A command line."""
    return [sys.executable, "-m", "bci_app", *map(str, words)]


@contextmanager
def demo(recordings: Path, speed: float) -> Iterator[str]:
    """A demo with its console, to its end; the console's address."""
    settings = recordings / "demo.toml"
    settings.write_text(f'recordings = "{recordings.as_posix()}"\n', encoding="utf-8")
    words = bci_app("demo", "--console", "--speed", speed, "--config", settings, "--json")
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        address = next(found[0] for line in process.stderr if (found := re.findall(r"^Console: (\S+)", line)))
        threading.Thread(target=process.stderr.read, daemon=True).start()  # so that it can go on talking
        yield address
        if process.wait() != 0:
            raise SystemExit(f"The demo ended with code {process.returncode}.")
    finally:
        process.terminate()
        process.wait()


def console(browser: Browser, address: str) -> None:
    """Light, dark, and in a window of a phone's size."""
    views = {"light": ("light", DESKTOP), "dark": ("dark", DESKTOP), "phone": ("light", PHONE)}
    pages = {}
    for name, (scheme, size) in views.items():
        pages[name] = browser.new_page(viewport=size, color_scheme=scheme)
        pages[name].goto(address)
    for name, page in pages.items():
        for element, says in LATE.items():
            expect(page.locator(f"#{element}")).to_contain_text(re.compile(says), timeout=PATIENCE_MS)
        shoot(page, f"console_{name}")


def report(browser: Browser, recordings: Path) -> None:
    """Its beginning, light and dark, and some figures."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "report"
        subprocess.run(bci_app("report", recordings, "--out", out, "--json"), check=True, stdout=subprocess.DEVNULL)
        for scheme in ("light", "dark"):
            page = browser.new_page(viewport={"width": 1000, "height": 900}, color_scheme=scheme)
            page.goto((out / "report.html").as_uri())
            shoot(page, f"report_{scheme}")
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        page.goto((out / "report.html").as_uri())
        for name in FIGURES:
            shoot(page.locator(f"#figure-{name} img"), name)


def shoot(what: Page | Locator, name: str) -> None:
    """A picture as PNG of 256 colours, which is as good for a page and a third of the size."""
    path = FOLDER / f"{name}.png"
    what.screenshot(path=path)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    print(path, f"{path.stat().st_size / 1000:.0f} kB")


def main() -> None:
    """Make them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--report", type=Path, metavar="FOLDER", help="only the report's, of these recordings")
    parser.add_argument("--speed", type=float, default=24, help="the demo's")
    parser.add_argument("--chromium", default=shutil.which("chromium") or shutil.which("google-chrome"))
    arguments = parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=arguments.chromium, args=["--no-sandbox"])
        if arguments.report is not None:
            report(browser, arguments.report)
            return
        subprocess.run([sys.executable, HERE / "screens.py"], check=True)
        with tempfile.TemporaryDirectory() as folder:
            with demo(Path(folder), arguments.speed) as address:
                console(browser, address)
            report(browser, Path(folder))


if __name__ == "__main__":
    main()
