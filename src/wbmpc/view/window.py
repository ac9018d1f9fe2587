"""The process that shows a run: how it is started and ended. What it draws comes over a mailbox, orders go back over another."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from wbmpc.errors import InputError, RunAborted
from wbmpc.interrupts import interrupts_blocked
from wbmpc.runtime.shared_memory import Board, Fields, Mailbox
from wbmpc.simulation.scene import Scene
from wbmpc.view.access import Access
from wbmpc.view.process import BOARD, FAREWELL, Drawer, serve
from wbmpc.view.steering import REQUESTS, Controls

_START = 60.0


class Window:
    """A view at ``url``. ``opened(url)`` is called once the server answers; no browser is waited for.

    ``with_token``: whether the address has a random token, without which requests are rejected; only a loopback ``host`` may be
    without, and it must be of this machine, else :class:`InputError` is raised.
    """

    def __init__(
        self, title: str, host: str, port: int, opened: Callable[[str], None], with_token: bool = True
    ) -> None:
        if find_spec("viser") is None:
            raise InputError("view: this needs viser: pip install 'wbmpc[viz]'")
        if not 0 < port < 65536:
            raise InputError(f"--port: must be 1 to 65535, got {port}")
        self.title, self.port, self.opened = title, port, opened
        self.access = Access.of(host, with_token)
        self.process: Any = None

    @property
    def url(self) -> str:
        """Where a browser finds the view."""
        return self.access.url(self.port)

    def start(self, scene: Scene, controls: Controls, shown: Fields, drawer: Drawer | None = None) -> None:
        """Start the server's process; returns when it answers. ``shown``: shapes of the messages that are drawn;
        ``drawer``: called there, makes what turns such messages into snapshots (left out: they are snapshots)."""
        self.shown, self.requests, self.board = Mailbox.shared(shown), Mailbox.shared(REQUESTS), Board.shared(BOARD)
        arguments = (scene.plain(), controls, self.shown, self.requests, self.board, self.access, self.port, drawer)
        process = multiprocessing.get_context("spawn").Process(target=serve, args=arguments, daemon=True)
        with interrupts_blocked():
            process.start()
            self.process = process
        deadline = time.monotonic() + _START
        while not self.board["ready"] and self.process.is_alive() and time.monotonic() < deadline:
            time.sleep(0.01)
        if not self.board["ready"]:
            raise InputError(f"view: the server did not start: {self.board.text or 'no answer'}")
        self.port = int(self.board["port"])
        self.opened(self.url)

    def check_shown(self) -> None:
        """Raise :class:`RunAborted` if the process has gone by itself, as the system ends one for want of memory: nobody sees or steers the
        run any more."""
        if self.process is not None and not self.process.is_alive():
            raise RunAborted("the process that shows the view has ended")

    def show_message(self, message: str) -> None:
        """Let the page say something beside its title until something else is said; empty: nothing."""
        if self.process is not None:
            self.board.text = message

    def reject(self, reason: str) -> None:
        """Let the page show for a while why something that was asked for is not done."""
        if self.process is not None:
            self.board.note = reason
            self.board.count("rejected")

    def close(self) -> None:
        """End the process; a browser is left the time to read what was said last."""
        if self.process is not None:
            self.board["end"] = 1.0
            if not self.board["ready"]:  # the process does not read it yet
                self.process.kill()
            self.process.join(FAREWELL + 3.0)
            if self.process.is_alive():
                self.process.kill()
            self.process = None
