"""What both live views share, that of the lockstep loop and that of a real-time runner: what is shown of an MPC, what the user asks."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError, RunAborted
from wbmpc.interrupts import interrupts_blocked
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.recording.observer import end_effector_goal
from wbmpc.runtime.shared_memory import Board, Fields, Mailbox
from wbmpc.simulation.scene import Scene
from wbmpc.stability import configurations
from wbmpc.view.access import Access
from wbmpc.view.braked_joints import braked_joints
from wbmpc.view.process import BOARD, FAREWELL, Drawer, serve
from wbmpc.view.snapshot import NUMBERS, errors
from wbmpc.view.user_commands import REQUESTS, Controls, UserCommands, no_requests

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


class LiveView(Window):
    """``wants_reset``: whether the run ended in order to restart; ``ended``: whether the user ended it."""

    def __init__(self, title: str, host: str, port: int, opened: Callable[[str], None], with_token: bool) -> None:
        super().__init__(title, host, port, opened, with_token)
        self.wants_reset = self.ended = False
        self._requests, self._previous = no_requests(), ""
        self._expect()

    def _expect(self) -> None:
        """What was asked for until now is not for the run that begins."""
        self._counts = {name: int(self._requests[name]) for name in ("resets", "ends")}

    def _asked(self, name: str) -> bool:
        """Whether the user has asked for ``resets`` or ``ends`` since the run began."""
        return int(self._requests[name]) != self._counts[name]

    def _read_requests(self) -> bool:
        """Take in the panel's newest message, if there is a new one."""
        message = self.requests.read()
        if message is not None:
            self._requests = message.values
        return message is not None

    def _controls(
        self, mpc: MPC | None, robot: RobotModel | None, groups: tuple[str, ...], *, paced: bool = True,
        pushes: bool = True,
    ) -> Controls:  # fmt: skip
        """What there is to control of a run of this robot (None: of none that is described) with this MPC."""
        names = tuple(cost.name for cost in UserCommands.costs_of(mpc))
        around = mpc is not None and mpc.obstacles is not None
        brakes, base = braked_joints(mpc) is not None, UserCommands.base_of(mpc)
        named = () if robot is None else tuple(configurations(robot))  # shown where nothing can be commanded, too
        return Controls(self.title, names, brakes, base, groups, paced, pushes, around, named)


@dataclass(frozen=True)
class ReferencePoses:
    """What an MPC follows at one time, above the floor, in the frame of the estimate: the end effector's ``goal`` (7) and the ``base``'s
    (x, y, yaw), nan where there is none, and the ``way`` (n, 3) of the end effector's reference."""

    goal: Array
    base: Array
    way: Array


def followed(mpc: MPC | None, t: float, lift: Array) -> ReferencePoses:
    """At time t [s]; ``lift`` (3) [m] of the planner's origin above the floor."""
    goal, base, way = end_effector_goal(mpc, t, lift), np.full(3, np.nan), np.zeros((0, 3))
    if mpc is not None and "end_effector" in mpc.reference:
        way = mpc.reference["end_effector"].values[:, :3] + lift
    if mpc is not None and UserCommands.base_of(mpc):
        base = mpc.reference["state"].at(t)[mpc.dynamics.state["base"]]
    return ReferencePoses(np.full(7, np.nan) if goal is None else goal, base, way)


def solved(mpc: MPC | None) -> dict[str, float]:
    """How long the last solve took and may take [s], and the least ``clearance`` [m] of its plan; nan without an MPC, and of a plan with
    nothing near."""
    if mpc is None:
        return dict.fromkeys(("solve", "deadline", "clearance"), np.nan)
    distance = mpc.clearance.distance
    return {
        "solve": mpc.solve_time, "deadline": mpc.period, "clearance": distance if np.isfinite(distance) else np.nan,
    }  # fmt: skip


def numbers(
    end_effector: Array, goal: Array, base: Array, base_goal: Array, others: Mapping[str, float | Array]
) -> Array:
    """A snapshot's numbers: errors of the poses (7) of end effector and base against their goals in one frame, and all ``others``."""
    values = {**errors(end_effector, goal, base, base_goal), **others}
    return np.array([float(values[name]) for name in NUMBERS])
