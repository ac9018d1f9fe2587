"""The process of a live view: a server, a scene and a panel that follow a mailbox."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

from wbmpc.errors import described
from wbmpc.runtime.shared_memory import Board, Mailbox
from wbmpc.simulation.scene import Scene
from wbmpc.view.access import Access

#: Pictures per second.
RATE = 30.0
#: What is drawn over the bodies comes with every so many pictures: plans are new at 10 to 50 Hz, and slow browsers fall behind.
OVERLAYS = 3
#: How long a page goes on saying why the run is over [s], if there is a browser.
FAREWELL = 4.0
#: What the process (``ready``, ``port``) and the run (``end``; as text what is over, and why; how many commands were ``rejected``, as
#: note why the last one was) exchange.
BOARD = ("ready", "port", "end", "rejected")
#: Makes, in this process, what turns messages into snapshots.
Drawer = Callable[[], Callable[[dict[str, Any]], dict[str, Any]]]


def serve(
    scene: dict[str, Any], controls: Any, shown: Mailbox, requests: Mailbox, board: Board, access: Access, port: int,
    drawer: Drawer | None,
) -> None:  # fmt: skip
    """Serve until the run says ``end`` or its process is gone. A failure stands on the board as text."""
    parent = os.getppid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run, which then says ``end``
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - the server's banner would mix with the run's own output
    try:
        draw = None if drawer is None else drawer()
        stage, panel = _open(Scene.of_plain(scene), controls, requests, access, port)
    except Exception as error:
        board.text = described(error)
        return
    pictures, rejected = 0, 0.0
    board["port"], board["ready"] = stage.server.get_port(), 1.0
    while not board["end"] and os.getppid() == parent:
        message = shown.read()
        if message is not None:
            snapshot = message.values if draw is None else draw(message.values)
            stage.show(snapshot, overlays=pictures % OVERLAYS == 0)
            pictures += 1
            panel.show(snapshot)
            stage.follow(snapshot["poses"], panel.follows)
        panel.show_message(board.text)
        if board["rejected"] != rejected:
            rejected = board["rejected"]
            panel.reject(board.note)
        time.sleep(1.0 / RATE)
    panel.show_message(board.text)
    if board.text and stage.server.get_clients() and os.getppid() == parent:
        time.sleep(FAREWELL)
    stage.server.stop()


def _open(scene: Scene, controls: Any, requests: Mailbox, access: Access, port: int) -> tuple[Any, Any]:
    from wbmpc.view.panel import Panel
    from wbmpc.view.scene import ViewScene
    from wbmpc.view.server import open_server

    server, guard = open_server(access, port)
    panel = Panel(server, requests, controls)
    guard.rejected = panel.reject
    return ViewScene(server, scene), panel
