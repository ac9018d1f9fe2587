"""The camera that follows the robot, with browsers that are late. Truth: where such a browser looks, by its own record."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filmed import copy_film
from test_live import free_port

from wbmpc.recording.reader import read_recording
from wbmpc.view import scene as scene_module
from wbmpc.view.replay import Film

viser = pytest.importorskip("viser")


class Camera:
    """A browser's camera as the server has it: what was set or reported last. Messages take ``late`` frames each way."""

    def __init__(self, late: int) -> None:
        self.shown = np.zeros((2, 3))  # position and where it looks, in the browser
        self._known = self.shown.copy()
        self._down: deque[tuple[int, int, np.ndarray]] = deque()
        self._up: deque[tuple[int, np.ndarray]] = deque()
        self._frame, self._late = 0, late
        self._hear: Callable[[Any], None] = lambda _: None

    def on_update(self, callback: Callable[[Any], None]) -> None:
        self._hear = callback

    def _set(self, row: int, value: Any) -> None:
        self._known[row] = value
        self._down.append((self._frame + self._late, row, np.array(value, float)))

    position = property(lambda self: self._known[0].copy(), lambda self, value: self._set(0, value))
    look_at = property(lambda self: self._known[1].copy(), lambda self, value: self._set(1, value))

    def draw(self, dragged: np.ndarray) -> None:
        """A frame of the browser, whose user has ``dragged`` (3) the camera meanwhile: it takes what has come, and reports."""
        self._frame += 1
        while self._down and self._down[0][0] <= self._frame:
            _, row, value = self._down.popleft()
            self.shown[row] = value
        self.shown += dragged
        self._up.append((self._frame + self._late, self.shown.copy()))
        while self._up and self._up[0][0] <= self._frame:
            self._known = self._up.popleft()[1]
            self._hear(self)


@pytest.mark.parametrize("late", [0, 2, 10])
@pytest.mark.parametrize("dragged", [0.0, 0.3])
def test_a_late_browser_does_not_lose_the_robot(
    late: int, dragged: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot goes 4 m in 8 s, at 20 frames per second; the user pans once, at rest."""
    copy_film(tmp_path)
    film = Film(read_recording(tmp_path))
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        shown, camera, clock = scene_module.ViewScene(server, film.scene), Camera(late), SimpleNamespace(now=0.0)
        client = SimpleNamespace(camera=camera, atomic=server.atomic)
        monkeypatch.setattr(server, "get_clients", lambda: {7: client})
        monkeypatch.setattr(scene_module.time, "monotonic", lambda: clock.now)
        poses = np.array(film.snapshot(0.0)["poses"])
        start = poses[film.scene.index, :3].copy()
        for frame in range(400):
            clock.now = 0.05 * frame
            poses[film.scene.index, 0] = start[0] + 0.5 * min(max(clock.now - 4.0, 0.0), 8.0)
            shown.follow(poses)
            camera.draw(np.array([0.0, dragged * (frame == 70), 0.0]))
        off = camera.shown[1] - poses[film.scene.index, :3]
        assert np.abs(off[:2] - [0.0, dragged]).max() < 2.0 * scene_module.FOLLOW
    finally:
        server.stop()
