"""The controls and plots beside the picture: they fill in commands, and show the numbers of snapshots."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import numpy as np
import viser
from viser import uplot

from wbmpc.arrays import Array
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.view import bounds
from wbmpc.view.actuator_load import DRIVES, SHARES
from wbmpc.view.capture import add_capture
from wbmpc.view.history import History
from wbmpc.view.rejection import Rejection
from wbmpc.view.scene import add_follow, add_legend, name_tab
from wbmpc.view.snapshot import NUMBERS, plain, status_text
from wbmpc.view.user_commands import Controls, no_requests

#: Pictures between two updates of the numbers, and of the plots, which cost a browser more.
_EVERY, _EVERY_PLOT = 3, 6
#: How long a run may take to follow a click [s].
_ANSWER = 1.0
#: How long a goal is left alone after it was moved last [s].
_HELD = 10.0
#: Where a box is put first (3) [m].
AHEAD = (1.5, 0.0, 0.3)
#: Colors of the groups of drives, in their order.
_COLORS = ("#2a9d6f", "#8a5fbf", "#b7791f", "#1f5fa8", "#c0392b", "#3d8f9e", "#7a7a2e", "#5b6470")
#: A plot: its title, and its lines: number, name, color, factor.
_Line = tuple[str, str, str, float]


class Panel:
    """Widgets of one server; every change writes all commands again, so that none can be lost."""

    def __init__(self, server: viser.ViserServer, requests: Mailbox, controls: Controls) -> None:
        self.server, self._requests, self.controls = server, requests, controls
        self._values, self._lock = no_requests(), threading.Lock()  # the server calls back from several threads
        self._dragged, self._about, self._message, self._shown = False, "", "", ""
        self._rejection, self._moved_at, self._box_asked = Rejection(), -np.inf, -np.inf
        server.gui.main_panel.dock_right()
        name_tab(server.gui, controls.title)
        self._status = server.gui.add_markdown(f"**{controls.title}**")
        self._follow = add_follow(server)
        self._handles = server.gui.add_checkbox("Show handles", True)
        add_legend(server.gui)
        add_capture(server.gui, controls.title)
        self._run()
        self._robot()
        self._weights()
        self._goals()
        if self.controls.obstacle:
            self._obstacle()
        self._plots()
        self._send()

    @property
    def follows(self) -> bool:
        """Whether the camera goes with the robot."""
        return bool(self._follow.value)

    # ------------------------------------------------------------------ commands
    def _send(self, **values: Any) -> None:
        with self._lock:
            for name, value in values.items():
                self._values[name][...] = value
            self._requests.write(**self._values)

    def _click(self, count: str, **values: Any) -> None:
        self._send(**{count: self._values[count] + 1, **values})

    def _button(self, label: str, count: str, values: Callable[[], dict[str, Any]] = dict) -> None:
        button = self.server.gui.add_button(label)
        button.on_click(in_order(lambda: self._click(count, **values())))

    # ------------------------------------------------------------------ widgets
    def _run(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Run"):
            if self.controls.paced:
                pause = gui.add_checkbox("Pause", False)
                pause.on_update(in_order(lambda: self._send(paused=float(pause.value))))
                self._button("Single step", "steps")
                speed = gui.add_slider("Speed", 0.05, 1.0, 0.05, 1.0)
                speed.on_update(in_order(lambda: self._send(speed=speed.value)))
            self._button("Reset", "resets")
            self._button("End the run", "ends")

    def _robot(self) -> None:
        gui = self.server.gui
        if self.controls.brakes:
            with gui.add_folder("Brakes"):
                if names := self.controls.configurations:
                    group = gui.add_button_group("Configuration", names)
                    choose = lambda: self._click("configurations", configuration=names.index(group.value))
                    group.on_click(in_order(choose))
                self._brakes: Any = gui.add_checkbox("Brakes open", False)
                self._brakes_clicked = -np.inf
                self._brakes.on_update(self._click_brakes)
        if not self.controls.pushes:
            return
        with gui.add_folder("Push"):
            force = gui.add_slider("Force [N]", 0.0, 300.0, 5.0, 60.0)
            angle = gui.add_slider("Direction [deg]", -180.0, 180.0, 5.0, 0.0)
            length = gui.add_slider("Time [s]", 0.05, 2.0, 0.05, 0.2)
            direction = lambda: (
                force.value * np.array([np.cos(np.radians(angle.value)), np.sin(np.radians(angle.value)), 0])
            )
            self._button("Push", "pushes", lambda: {"push": direction(), "push_time": length.value})

    def _click_brakes(self, event: Any) -> None:
        if event.client is None:  # the panel itself showed how they are
            return
        self._brakes_clicked = time.monotonic()
        self._click("brake_clicks", brakes_open=float(self._brakes.value))

    def _show_brakes(self, is_open: float) -> None:
        """How the run's brakes are; after a click only once the run has had the time to follow it, or to reject."""
        if self.controls.brakes and np.isfinite(is_open) and time.monotonic() > self._brakes_clicked + _ANSWER:
            self._brakes.value = bool(is_open)

    def _weights(self) -> None:
        with self.server.gui.add_folder("Weights (powers of ten)", expand_by_default=False):
            for i, name in enumerate(self.controls.weights):
                slider = self.server.gui.add_slider(name, -2.0, 2.0, 0.1, 0.0)
                slider.on_update(partial(self._set_weight, i))

    async def _set_weight(self, i: int, event: Any) -> None:
        weights = self._values["weights"].copy()
        weights[i] = 10.0**event.target.value
        self._send(weights=weights)

    def _goals(self) -> None:
        scene = self.server.scene
        # thin, and seen through: the end effector is behind it
        self._goal = scene.add_transform_controls(
            "/goal", scale=0.3, line_width=1.5, opacity=0.7, disable_sliders=True, visible=False
        )
        end_effector = lambda: np.concatenate([self._goal.position, self._goal.wxyz])
        self._on_drag(self._goal, lambda: self._click("goals", goal=end_effector()))
        if self.controls.base:
            self._base = scene.add_transform_controls(
                "/base_goal", scale=0.6, disable_sliders=True, active_axes=(True, True, False), visible=False
            )
            self._on_drag(self._base, lambda: self._click("base_goals", base_goal=self._planar()))

    def _obstacle(self) -> None:
        """A cube that is there or not, and goes where it is dragged."""
        scene, gui = self.server.scene, self.server.gui
        self._box = scene.add_transform_controls("/obstacle", scale=0.4, disable_sliders=True, visible=False)
        self._box.position = AHEAD
        self._cube: Any = scene.add_box("/obstacle/cube", color=(209, 73, 91), dimensions=(1.0, 1.0, 1.0), opacity=0.6)
        with gui.add_folder("Box"):
            self._edge: Any = gui.add_slider("Edge [m]", *bounds.EDGES, 0.05, 0.3)
            gui.add_button("Put there").on_click(in_order(lambda: put()))
            gui.add_button("Take away").on_click(in_order(lambda: take_away()))

        def order() -> None:
            self._box_asked = time.monotonic()
            pose = np.concatenate([self._box.position, self._box.wxyz])
            self._click("obstacles", obstacle=np.append(pose, self._edge.value))

        def put() -> None:
            self._cube.dimensions = (self._edge.value,) * 3
            self._box.visible = True
            order()

        def take_away() -> None:
            self._box_asked, self._box.visible = time.monotonic(), False
            self._click("obstacles", obstacle=np.zeros(8))

        def again(act: Callable[[], None]) -> None:
            if self._box.visible:  # a page that is not ours may move what it does not show
                act()

        async def resized(event: Any) -> None:
            if event.client is not None:  # else the panel itself showed how it is
                again(put)

        self._edge.on_update(resized)  # what is drawn is what is avoided
        self._on_drag(self._box, lambda: again(order))

    def _show_obstacle(self, cube: Array) -> None:
        """The cube (8) as the run keeps clear of it; once it was asked for another one, only once it has had the time to follow, or to
        reject."""
        now = time.monotonic()
        if (
            not self.controls.obstacle
            or now < self._box_asked + _ANSWER
            or (self._dragged and now <= self._moved_at + _HELD)
        ):
            return
        there, edge = bool(cube[7] > 0.0), (float(cube[7]),) * 3
        if self._box.visible != there:
            self._box.visible = there
        if there and not np.allclose(np.concatenate([self._box.position, self._box.wxyz]), cube[:7], atol=1e-5):
            self._box.position, self._box.wxyz = cube[:3], cube[3:7]
        if there and not np.allclose(self._cube.dimensions, edge):
            self._cube.dimensions = edge
            self._edge.value = edge[0]

    def _on_drag(self, handle: Any, order: Callable[[], None]) -> None:
        """Do ``order`` where a handle is moved; not where it is only grasped or let go."""

        async def dragged(event: Any) -> None:  # the server waits for it: what follows cannot pass it
            self._dragged, self._moved_at = event.phase != "end", time.monotonic()
            if event.phase == "update":
                order()

        handle.on_update(dragged)

    def _planar(self) -> Array:
        w, _, _, z = self._base.wxyz
        return np.array([self._base.position[0], self._base.position[1], 2.0 * np.arctan2(z, w)])

    def _plots(self) -> None:
        self._history = History()
        self._count, empty = 0, np.zeros(1)
        line = lambda label, color: uplot.Series(label=label, stroke=color, width=1.5)
        self._figures = []
        with self.server.gui.add_folder("Plots"):
            for title, lines in plotted(self.controls).items():
                series = (uplot.Series(label="t"), *(line(label, color) for _, label, color, _ in lines))
                handle = self.server.gui.add_uplot(
                    (empty, *(empty for _ in lines)), series, title=title, aspect=1.8,
                    scales={"x": uplot.Scale(time=False)},
                )  # fmt: skip
                self._figures.append((handle, [(NUMBERS.index(name), factor) for name, _, _, factor in lines]))

    # ------------------------------------------------------------------ snapshots
    def show(self, s: dict[str, Array]) -> None:
        """Show the numbers of a snapshot; move the goals that no user drags."""
        numbers = s["numbers"]
        self._history.add(numbers)
        self._count += 1
        if not self._dragged or time.monotonic() > self._moved_at + _HELD:  # a browser may vanish while it holds a goal
            self._place(self._goal, s["goal"])
            if self.controls.base and np.isfinite(s["base_goal"]).all():
                x, y, yaw = s["base_goal"]
                self._place(self._base, np.array([x, y, 0.02, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]))
        self._show_obstacle(s["obstacle"])
        if self._count % _EVERY:
            return
        self._show_brakes(float(s["brakes"]))
        value = dict(zip(NUMBERS, numbers, strict=True))
        digits = 4 if self._values["paused"] else 1  # a single step is a few milliseconds
        self._about = f", {value['t']:.{digits}f} s{status_text(value, self.controls.configurations)}"
        self._head()
        if self._count % _EVERY_PLOT:
            return
        rows = self._history.rows
        for handle, lines in self._figures:
            handle.data = (rows[:, 0], *(factor * rows[:, column] for column, factor in lines))

    def show_message(self, message: str) -> None:
        """Show a message under the title, empty: none; and what was rejected since the last call."""
        self._message = message
        self._head()

    def reject(self, reason: str) -> None:
        """Show for a while, from the next message on, why something that was asked for is not done. From any thread, at any rate:
        it costs nothing here."""
        self._rejection.show(reason)

    def _head(self) -> None:
        """Every change goes to all pages."""
        text = f"  \n**{plain(self._message)}**" if self._message else ""
        content = f"**{plain(self.controls.title)}**{self._about}{text}{self._rejection.text}"
        if content != self._shown:
            self._status.content = self._shown = content

    def _place(self, handle: Any, pose: Array) -> None:
        finite = bool(np.isfinite(pose).all())
        handle.visible = finite and bool(self._handles.value)
        if finite and not np.allclose(np.concatenate([handle.position, handle.wxyz]), pose, atol=1e-5):
            handle.position, handle.wxyz = pose[:3], pose[3:]


def in_order(act: Callable[[], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """A callback that the server waits for: others it calls in several threads, where two clicks race, and the later one may come first."""

    async def called(event: Any) -> None:
        act()

    return called


def plotted(controls: Controls) -> dict[str, tuple[_Line, ...]]:
    """Lines by the plots' titles."""
    red = "#d1495b"
    figures: dict[str, tuple[_Line, ...]] = {
        "End effector position error [mm]": (("error", "error", red, 1e3),),
        "End effector orientation error [°]": (("turn", "error", red, np.degrees(1.0)),),
    }
    if controls.base:
        figures["Base position error [mm]"] = (("base", "error", red, 1e3),)
    figures["Solve time and deadline [ms]"] = (
        ("solve", "solve", "#1f5fa8", 1e3),
        ("deadline", "deadline", "#b7791f", 1e3),
    )
    if controls.obstacle:
        figures["Least clearance of the plan [mm]"] = (("clearance", "clearance", red, 1e3),)
    if controls.groups:
        # in percent: the axis has three decimals, and shares of a robot that hardly moves would all be 0
        figures["Speeds / limits, largest of each [%]"] = tuple(
            (place, "torque" if group == DRIVES else group, color, 100.0)
            for place, group, color in zip(SHARES, controls.groups, _COLORS, strict=False)
        )
    if not controls.paced:
        figures["Tick begins late [ms]"] = (("late", "late", "#8a5fbf", 1e3),)
    return figures
