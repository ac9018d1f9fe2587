"""docs/gallery.md: of every experiment a clip, a figure and its command, from runs of `wbmpc reproduce`.

Usage: python scripts/gallery.py [NAME ...] [--runs reproduced]
`wbmpc reproduce --seeds 0 --no-clips` makes the runs. Each experiment's part names the commit and the outcome of its run; experiments
without a run keep the part that they have. Needs the extras video and browser and a Chromium.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from figures import publish, table
from PIL import Image, ImageOps
from playwright.sync_api import Page, sync_playwright

from wbmpc import tasks
from wbmpc.recording.reader import read_recording
from wbmpc.registry import load, locations
from wbmpc.report import RECORDING
from wbmpc.view.render import RATES, render
from wbmpc.view.replay import Film

ROOT = Path(__file__).parents[1]
GALLERY = ROOT / "docs" / "gallery.md"
IMAGES = ROOT / "docs" / "images" / "gallery"
#: Pixels of a clip and of a figure, which is drawn so many times finer and then smoothed; how long a clip is [s]; colors of a figure.
CLIP, FIGURE, FINER, SECONDS = (360, 202), (520, 320), 2, 4.0
COLORS = 32
#: Titles of the figures that say most, where it is not the report's first: a part of the title.
TITLES = {"hold": "End effector error", "end-effector-track": "End effector error"}
DRAW = """([title, width, height, scale]) => {
  const all = [...document.querySelectorAll(".js-plotly-plot")];
  const named = all.find(p => title && p.closest(".card").textContent.includes(title)) || all[0];
  return Plotly.relayout(named, {paper_bgcolor: "white", plot_bgcolor: "white"})
    .then(() => Plotly.toImage(named, {format: "png", width, height, scale}))
    .then(picture => [named.closest(".card").querySelector("h3").textContent, picture]);
}"""


@contextmanager
def browser() -> Iterator[Page]:
    """A page of a browser."""
    with sync_playwright() as found:
        window = found.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        yield window.new_page(viewport={"width": 1200, "height": 900})
        window.close()


def figure(page: Page, run: Path, name: str) -> str:
    """Draw a plot of the run's report, or its first drawing; its title, empty without one."""
    page.goto((run / "report.html").resolve().as_uri())
    if page.locator(".js-plotly-plot").count():
        title, found = page.evaluate(DRAW, [TITLES.get(name, ""), *FIGURE, FINER])
        png = base64.b64decode(found.partition(",")[2])
    elif (card := page.locator(".card:has(svg)").first).count():
        title, png = card.locator("h3").inner_text(), card.locator("svg").screenshot()
    else:
        return ""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture = ImageOps.pad(picture, FIGURE, Image.Resampling.LANCZOS, color="white")
    picture.quantize(COLORS, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)
    return str(title)


def clip(run: Path, name: str) -> float:
    """Draw the run's clip; its speed against the run, 0 without one."""
    if not (run / RECORDING).is_file():
        return 0.0
    film = Film(read_recording(run))
    speed = max(1.0, round(float(film.times[-1] - film.times[0]) / SECONDS))
    pictures = render(film, IMAGES / f"{name}.webp", (0.0, float("inf")), CLIP, speed)
    return speed if pictures > RATES[".webp"] else 0.0


def part(page: Page, run: Path, name: str) -> str:
    """An experiment's part of the page."""
    metrics: dict[str, Any] = json.loads((run / "metrics.json").read_text())
    speed, title = clip(run, name), figure(page, run, name)
    pictures = {}
    if speed:
        pace = f"{speed:g} times as fast" if speed > 1.0 else "in real time"
        pictures[pace] = f"![clip of {name}](images/gallery/{name}.webp)"
    if title:
        pictures[title] = f"![{title}](images/gallery/{name}.png)"
    summary = load(name).summary
    commit = metrics["versions"].get("commit", "unknown")
    command = re.sub(r" --out \S+", "", metrics["command"])
    ended = f"{metrics['outcome'].replace('_', ' ')}, commit {commit}"
    text = f"### `{name}`\n{summary[:1].upper()}{summary[1:]}.\n\n`{command}`: {ended}.\n\n"
    return text + (table(pictures, [pictures.values()]) if pictures else "")


def group(name: str) -> str:
    """The heading of the page that an experiment stands under, as the marks name it."""
    if name in tasks.EXPERIMENTS:
        return "any robot"
    return "swerve experiments" if "pankert" in locations()[name] else "ball robot experiments"


def main() -> None:
    """Draw what is asked for and publish it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = list(locations())
    parser.add_argument("names", nargs="*", metavar="NAME", help="experiments (default: all that have a run)")
    parser.add_argument("--runs", type=Path, default=ROOT / "reproduced", help="directory of 'wbmpc reproduce'")
    given = parser.parse_args()
    if unknown := set(given.names) - set(known):
        raise SystemExit(f"gallery: {', '.join(sorted(unknown))}: valid: {', '.join(known)}")
    IMAGES.mkdir(parents=True, exist_ok=True)
    with browser() as page:
        for name in given.names or known:
            runs = sorted(p.parent for p in given.runs.glob(f"{name}/seed*/finished"))
            if runs:
                publish(GALLERY, group(name), part(page, runs[0], name))
            print(f"{name}: {'drawn' if runs else 'no run, its part stays'}", flush=True)


if __name__ == "__main__":
    main()
