"""A real browser for tests: Debian's Chromium, driven by playwright; rendering in software."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_GRAPHICS = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
_QUIET = ("quic", "background-networking", "component-update", "sync")
FLAGS = [*_GRAPHICS, "--no-sandbox", "--no-first-run", *(f"--disable-{name}" for name in _QUIET)]
WIDTH, HEIGHT = 1000, 700


class Page:
    """An open page, the errors that it has said, and the requests that left this machine."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        local = ("http://127.0.0.1", "ws://127.0.0.1", "http://localhost", "file:", "data:", "blob:")
        page.on("request", lambda r: None if r.url.startswith(local) else self.outside.append(r.url))

    def open(self, url: str, seconds: float = 8.0) -> None:
        """Open and let it draw."""
        self.page.goto(url, timeout=60_000)
        self.page.wait_for_selector("canvas", timeout=60_000)
        self.wait(seconds)

    def wait(self, seconds: float) -> None:
        self.page.wait_for_timeout(1000 * seconds)

    def picture(self) -> np.ndarray:
        """The canvas as numbers (rows, columns, 3)."""
        import io

        from PIL import Image

        data = self.page.screenshot(clip={"x": 0, "y": 160, "width": 640, "height": HEIGHT - 160}, timeout=120_000)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def changed(self, seconds: float) -> int:
        """How many pixels change within some seconds."""
        before = self.picture()
        self.wait(seconds)
        return int((np.abs(self.picture() - before).max(axis=2) > 20).sum())

    def click(self, label: str) -> None:
        self.page.get_by_role("button", name=label, exact=True).first.click(timeout=20_000)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        mouse = self.page.mouse
        mouse.move(*start)
        self.wait(1.0)
        mouse.down()
        self.wait(0.5)
        for share in np.linspace(0.1, 1.0, 10):
            mouse.move(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
            self.wait(0.15)
        mouse.up()


@contextmanager
def browser() -> Iterator[Page]:
    """A page, or the test is skipped where there is no browser."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    with playwright.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        try:
            yield Page(chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT}))
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
