"""A real browser for tests: Debian's Chromium, driven by playwright; rendering in software."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_GRAPHICS = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
_QUIET = ("quic", "background-networking", "component-update", "sync")
FLAGS = [*_GRAPHICS, "--no-sandbox", "--no-first-run", *(f"--disable-{name}" for name in _QUIET)]
WIDTH, HEIGHT = 1000, 700
#: Pixels drawn for each of the page's: in software a quarter of them takes a quarter of the time, and nothing moves on the page.
SCALE = 0.5
#: A picture of several samples in every pixel takes four times as long in software, and canvases are read back. Pages draw as
#: often as they can, which in software takes all of a processor: so many pictures a second are enough.
PICTURES = 5
PLAIN = (
    f"""
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), {1000 // PICTURES});
window.cancelAnimationFrame = clearTimeout;
"""
    + """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return getContext.call(this, kind, options && {...options, antialias: false, preserveDrawingBuffer: true});
};
"""
)
#: Its size on the page and what it shows.
CANVAS = """() => {
  const canvas = document.querySelector('canvas[data-engine]');
  return [canvas.clientWidth, canvas.clientHeight, canvas.toDataURL()];
}"""


class Page:
    """An open page, the errors that it has said, and the requests that left this machine."""

    def __init__(self, page: Any) -> None:
        self.page = page
        page.add_init_script(PLAIN)
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        local = ("http://127.0.0.1", "ws://127.0.0.1", "http://localhost", "file:", "data:", "blob:")
        page.on("request", lambda r: None if r.url.startswith(local) else self.outside.append(r.url))

    def open(self, url: str) -> None:
        """Open it and wait until a scene is drawn, and drawn on."""
        self.page.goto(url, timeout=120_000)
        self.page.wait_for_selector("canvas[data-engine]", timeout=120_000)
        assert self.until(lambda: self.colors() > 50, 180.0), "no scene was drawn"
        self.drawn(5)

    def colors(self) -> int:
        """How many colors the canvas shows: many, once there is a robot."""
        return len(np.unique(self.picture().reshape(-1, 3), axis=0))

    def drawn(self, pictures: int) -> None:
        """Wait until the page has drawn so many pictures more."""
        for _ in range(pictures):
            self.page.evaluate("() => new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")

    def wait(self, seconds: float) -> None:
        self.page.wait_for_timeout(1000 * seconds)

    def picture(self, box: tuple[float, float, float, float] = (0, 160, 640, HEIGHT - 160)) -> np.ndarray:
        """The scene as numbers (rows, columns, 3) in a ``box`` of the page (x, y, width, height): what the canvas holds, which
        costs no picture more, while one of the whole page waits for several."""
        import base64
        import io

        from PIL import Image

        width, height, url = self.page.evaluate(CANVAS)
        scene = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA")
        scene = scene.resize((width, height))  # the page draws fewer pixels where it is slow, and stretches them
        x, y, w, h = (round(v) for v in box)
        paper = Image.new("RGBA", scene.size, "white")
        return np.asarray(Image.alpha_composite(paper, scene).convert("RGB")).astype(int)[y : y + h, x : x + w]

    def differs(self, previous: np.ndarray) -> int:
        """How many pixels of the canvas are others than in an earlier picture."""
        return int((np.abs(self.picture() - previous).max(axis=2) > 20).sum())

    def until(self, true: Callable[[], bool], seconds: float) -> bool:
        """Whether something becomes true within some seconds; the page goes on meanwhile."""
        deadline = time.monotonic() + seconds
        while not true():
            if time.monotonic() > deadline:
                return False
            self.wait(0.3)  # looking takes time too: a picture is read, or a whole recording
        return True

    def click(self, label: str) -> None:
        self.page.get_by_role("button", name=label, exact=True).first.click(timeout=120_000)

    def uncheck(self, label: str) -> None:
        self.page.get_by_label(label).first.uncheck(timeout=120_000)

    def _lit(self, at: np.ndarray) -> int:
        """Pixels near a point in the color of a gizmo's part under the pointer (yellow)."""
        near = self.picture((at[0] - 60, at[1] - 60, 120, 120))
        return int(((near[..., :2] > 170).all(axis=2) & (near[..., :2].min(axis=2) - near[..., 2] > 40)).sum())

    def grasp(self, at: np.ndarray, seconds: float = 20.0) -> bool:
        """Put the pointer on a part of a gizmo and press; False, and nothing is pressed, if the gizmo does not light up."""
        self.page.mouse.move(5.0, HEIGHT - 5.0)
        self.drawn(2)
        previous = self._lit(at)
        self.page.mouse.move(*at)
        if not self.until(lambda: self._lit(at) > previous + 15, seconds):
            return False
        self.page.mouse.down()
        return True

    def pull(self, start: np.ndarray, end: np.ndarray) -> None:
        """Drag what is grasped, in steps that the page has drawn, and let go."""
        for share in np.linspace(0.1, 1.0, 10):
            self.page.mouse.move(*(start + share * (end - start)))
            self.drawn(1)
        self.page.mouse.up()


@contextmanager
def browser() -> Iterator[Page]:
    """A page, or the test is skipped where there is no browser."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    with playwright.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        try:
            yield Page(chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT}, device_scale_factor=SCALE))
        finally:
            chromium.close()


def project(
    point: np.ndarray, eye: np.ndarray, target: np.ndarray, box: tuple[float, float], field: float
) -> np.ndarray:
    """Pixel of a point for a pinhole camera at ``eye`` that looks at ``target``, z up; vertical ``field`` of view [rad]."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    d = point - eye
    scale = 0.5 * box[1] / np.tan(0.5 * field)
    return np.array(
        [0.5 * box[0] + scale * (d @ right) / (d @ forward), 0.5 * box[1] - scale * (d @ up) / (d @ forward)]
    )
