"""Recordings as snapshots: what a live view would have shown."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.output_file import write_text
from wbmpc.plots.motion import Motion, picture_points
from wbmpc.recording.plots import end_effector_error, overview, positions
from wbmpc.recording.reader import Recording, Table
from wbmpc.report import plots_page
from wbmpc.report.replay import replay
from wbmpc.simulation.scene import Body, Contact, Scene
from wbmpc.view.access import Access
from wbmpc.view.rejection import Rejection
from wbmpc.view.snapshot import NUMBERS, PLAN, REFERENCE, TRAIL, filled, ground, plain, status_text

#: Pictures per second of a replay.
RATE = 30.0
#: Of a film that is one file [s]: its pictures are all in the memory of a browser.
LONGEST = 7200.0
#: Frames farther away than this [m] are of no robot, and nothing draws them.
FARTHEST = 1e6
#: The shortest time bar [s]: browsers count in doubles, and times may be a calendar's.
_STEP = 0.1
#: How often it is looked whether a browser has come [s].
WAIT = 0.2
_NOWHERE, _UNKNOWN = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.full((1, 3), np.nan)
#: Of an odometry without a localization in a map.
_STAYS = "map", _NOWHERE
#: Where what is not there at the moment is put: far away, under the floor.
_HIDDEN = np.array([1e3, 1e3, -100.0, 1, 0, 0, 0])


class Stages:
    """Worlds that follow each other in one recording as one scene: what not all of them have hides while it is not there."""

    def __init__(self, times: tuple[float, ...], scenes: tuple[Scene, ...]) -> None:
        self._times = np.array(times)
        common = set(scenes[0].shapes).intersection(*(s.shapes for s in scenes))
        bodies = {b.name: b for scene in scenes for b in scene.bodies}
        #: By name in the united scene: the body that it goes with, and the worlds in which it is there.
        self._with = {n: (n, {k for k, s in enumerate(scenes) if bodies[n] in s.bodies}) for n in bodies}
        shapes = [s for s in scenes[0].shapes if s in common]
        for k, scene in enumerate(scenes):
            for shape in scene.shapes:
                if shape not in common:
                    name = f"{shape.body} of world {k + 1}"
                    bodies[name] = Body(name, shape.body, True)
                    self._with[name] = (shape.body, {k})
                    shapes.append(replace(shape, body=name))
        self.united = replace(scenes[0], bodies=tuple(bodies.values()), shapes=tuple(shapes))

    def bodies(self, t: float) -> list[str | None]:
        """For each body of the united scene the recorded one that it goes with at time t [s]; None: it is not there."""
        k = latest(self._times, t)
        return [body if k in there else None for body, there in self._with.values()]


class Film:
    """A recording by time. ``times`` (n,) [s] of the recorded pictures, ``numbers`` over the run.

    Raises :class:`InputError` for recordings that hold no pictures.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        try:
            scenes = [(t, Scene.of_plain(plain)) for t, plain in recording.scenes]
        except (KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{recording.path}: its scene was not written by wbmpc ({error})") from error
        missing = [] if scenes else ["no scene (shapes of the robot, which recordings of wbmpc have)"]
        missing += [] if recording.topics.get("/tf") else ["no frames (/tf)"]
        if missing:
            raise InputError(
                f"{recording.path}: cannot be drawn: it has {' and '.join(missing)}; 'wbmpc log plot' and 'wbmpc log export' show its topics"
            )
        self._scenes = scenes
        self._stages = Stages(tuple(t for t, _ in scenes), tuple(scene for _, scene in scenes))
        self.scene = self._stages.united
        self.times = np.array(recording["/tf"].times)
        if np.any(np.diff(self.times) < 0.0):
            raise InputError(f"{recording.path}: the times of its frames (/tf) go back")
        self._frames = [self._transforms(m) for _, m in recording["/tf"].messages()]
        static = recording.topics.get("/tf_static")
        self._static = self._transforms(static.last()) if static else {}
        poses = [pose for frames in (*self._frames, self._static) for _, pose in frames.values()]
        first = [pose for frames in (self._frames[0], self._static) for _, pose in frames.values()]
        if any(np.abs(p).max() > FARTHEST for p in poses) or not np.isfinite(first).all():
            raise InputError(
                f"{recording.path}: its frames (/tf) are not finite at first, or farther away than {FARTHEST:g} m"
            )
        self._plans = {
            name: self._paths(topic)
            for name, topic in (("end_effector_plan", "/end_effector_plan"), ("base_plan", "/plan"))
        }
        self._goals = (
            recording.table("/end_effector_reference") if "/end_effector_reference" in recording.topics else None
        )
        way = positions(recording, "/end_effector_reference")
        self._way = np.zeros((0, 3)) if way is None else way[1]
        self._trail = positions(recording, "/ground_truth/end_effector") or self._estimated_trail()
        period = recording.topics.get("/mpc/period")
        #: Of a solve [s]; nan without an MPC.
        self.deadline = float(period.last()) if period else float("nan")

    def _estimated_trail(self) -> tuple[Array, Array] | None:
        """Times (n) [s] and places (n, 3) of the end effector in ``map`` where the robot itself says it is: nobody knows better on a real one."""
        found = positions(self.recording, "/end_effector_pose")
        if found is None:
            return None
        drifts = [{**self._static, **frames}.get("odom", _STAYS)[1] for frames in self._frames]
        places = [
            lie.quaternion_to_rotation(drifts[k][3:]) @ p + drifts[k][:3]
            for k, p in zip(map(partial(latest, self.times), found[0]), found[1], strict=True)
        ]
        return found[0], np.array(places).reshape(-1, 3)

    @staticmethod
    def _transforms(message: Any) -> dict[str, tuple[str, Array]]:
        """Parent and pose (7) by frame."""
        frames = message["transforms"]
        return {f["child_frame_id"]: (f["header"]["frame_id"], own_pose(f["transform"])) for f in frames}

    def _paths(self, topic: str) -> tuple[Array, list[Array]]:
        found = self.recording.topics.get(topic)
        if found is None:
            return np.zeros(0), []
        return np.array(found.times), [np.array([p["pose"][:3] for p in m["poses"]]) for _, m in found.messages()]

    @cached_property
    def _forces(self) -> dict[str, Table]:
        """Contact forces by body; not read for a clip, which does not show them."""
        topics = self.recording.topics
        return {name[9:]: self.recording.table(name) for name in topics if name.startswith("/contact/")}

    @cached_property
    def numbers(self) -> dict[str, tuple[Array, Array]]:
        """Times [s] and values of the plotted numbers, by their names in a snapshot or in :mod:`wbmpc.view.replay_plots`."""
        found = {}
        error = end_effector_error(self.recording)
        if error is not None:
            found["error"] = error
        if "/mpc/solve_time" in self.recording.topics:
            table = self.recording.table("/mpc/solve_time")
            found["solve"] = (table.times, table.columns["data"])
            found |= self._clearance(table.times)
        if "/joint_states" in self.recording.topics:
            table = self.recording.table("/joint_states")
            speeds = [np.abs(column) for name, column in table.columns.items() if name.startswith("velocity.")]
            if speeds:
                found["speed"] = (table.times, np.max(speeds, axis=0))
        return found

    def _clearance(self, times: Array) -> dict[str, tuple[Array, Array]]:
        """Of the plans of solves at ``times`` (n) [s]: only those with something near have one."""
        if "/mpc/clearance" not in self.recording.topics:
            return {}
        table, values = self.recording.table("/mpc/clearance"), np.full(len(times), np.nan)
        _, there, which = np.intersect1d(times, table.times, return_indices=True)
        values[there] = table.columns["data"][which]
        return {"clearance": (times, values)}

    # ------------------------------------------------------------------ pictures
    def picture(self, t: float) -> dict[str, Array]:
        """Of a snapshot what can be seen: poses and lines."""
        frames = self._at(t)
        placed: dict[str, Array] = {}
        shown = self._stages.bodies(t)
        poses = [_HIDDEN if body is None else self._placed(frames, body, placed) for body in shown]
        drift = frames.get("odom", _STAYS)[1]
        in_map = lambda p: p @ lie.quaternion_to_rotation(drift[3:]).T + drift[:3]
        paths = {
            n: in_map(filled(p[latest(times, t)] if p else [], (PLAN, 3))) for n, (times, p) in self._plans.items()
        }
        reference = in_map(filled(self._way, (REFERENCE, 3)))
        return {"poses": np.array(poses), "reference": reference, "trail": filled(self._taken(t), (TRAIL, 3)), **paths}

    def _at(self, t: float) -> dict[str, tuple[str, Array]]:
        return {**self._static, **self._frames[latest(self.times, t)]}

    def snapshot(self, t: float) -> dict[str, Array]:
        """What there was at time t [s]."""
        frames = self._at(t)
        drift = frames.get("odom", _STAYS)[1]
        contacts = [
            Contact(
                body, np.array([table.columns[f"wrench.force.{a}"][latest(table.times, t)] for a in "xyz"]), place[:3]
            )
            for body, table in self._forces.items()
            if (place := frames.get(f"contact_{body}", ("", None))[1]) is not None
        ]
        on_floor = ground(contacts)
        values = {name: v[latest(times, t)] for name, (times, v) in self.numbers.items()}
        values |= {"t": t, "deadline": self.deadline}
        values |= {name: on_floor.pop(name) for name in ("margin", "triangle_margin")}
        return {
            "numbers": np.array([float(values.get(name, np.nan)) for name in NUMBERS]),
            "goal": self._goal(t, drift), "base_goal": np.full(3, np.nan), **self.picture(t), **on_floor,
        }  # fmt: skip

    def motion(self) -> Motion:
        """What a page plays: a part for each world."""
        found, starts = Motion(), np.array([t for t, _ in self._scenes])
        worlds = np.array([latest(starts, t) for t in self.times])
        for k, (_, scene) in enumerate(self._scenes):
            found.begin(f"world {k + 1}" if len(self._scenes) > 1 else "", scene.plain())
            for t in filter(found.due, self.times[worlds == k].tolist()):
                frames, placed, seen = self._at(t), dict[str, Array](), self.picture(t)
                poses = [self._placed(frames, body.name, placed) for body in scene.bodies]
                goal = self._goal(t, frames.get("odom", _STAYS)[1])[:3]
                paths = [p[np.isfinite(p).all(axis=1)] for p in (seen["end_effector_plan"], seen["base_plan"])]
                found.add(t, np.array(poses), picture_points([*_UNKNOWN, *self._taken(t)][-1], goal, paths))
        return found

    def _taken(self, t: float) -> Array:
        """Where the end effector was until t [s], (n, 3) in ``map``."""
        if self._trail is None:
            return np.zeros((0, 3))
        times, points = self._trail
        return points[: latest(times, t) + 1]

    def _placed(self, frames: dict[str, tuple[str, Array]], name: str, placed: dict[str, Array]) -> Array:
        """A frame in ``map``, noted in ``placed`` as all on the way to it."""
        way: list[str] = []
        while name not in ("map", "world") and name not in placed and not (name == "odom" and name not in frames):
            if name not in frames or len(way) > len(frames):
                raise InputError(f"{self.recording.path}: frame '{name}' is not connected to 'map'")
            way.append(name)
            name = frames[name][0]
        pose = placed.get(name, _NOWHERE)
        for child in reversed(way):
            pose = placed[child] = lie.pose_compose(pose, frames[child][1])
        return pose

    def _goal(self, t: float, drift: Array) -> Array:
        if self._goals is None:
            return np.full(7, np.nan)
        k, names = latest(self._goals.times, t), ("position.x", "position.y", "position.z")
        quaternion = ("orientation.x", "orientation.y", "orientation.z", "orientation.w")
        pose = np.array([self._goals.columns[f"pose.{n}"][k] for n in (*names, *quaternion)])
        return lie.pose_compose(drift, own_pose(pose))


def own_pose(pose: Array) -> Array:
    """This library's pose (quaternion w, x, y, z) of one of ROS (x, y, z, w)."""
    return np.asarray(pose)[[0, 1, 2, 6, 3, 4, 5]]


def latest(times: Array, t: float) -> int:
    """The place of the last sample at or before t; the first if there is none."""
    return max(int(np.searchsorted(times, t + 1e-9, side="right")) - 1, 0)


# ---------------------------------------------------------------------- in the browser
class Player:
    """A time bar over a film."""

    def __init__(self, film: Film, access: Access, port: int) -> None:
        from wbmpc.view.capture import add_capture
        from wbmpc.view.replay_plots import ReplayPlots
        from wbmpc.view.scene import ViewScene, add_follow, add_legend, name_tab
        from wbmpc.view.server import open_server

        self.film, self.access = film, access
        self.server, guard = open_server(access, port)
        self._rejection, self._about = Rejection(), ""
        guard.rejected = self._rejection.show
        self.stage = ViewScene(self.server, film.scene)
        gui, self._start, self._end = self.server.gui, float(film.times[0]), float(film.times[-1])
        gui.main_panel.dock_right()
        name_tab(gui, film.recording.title)
        self._title = f"**{plain(film.recording.title)}**"
        self._text = gui.add_markdown(self._title)
        self._playing = gui.add_checkbox("Play", True)
        self._time: Any = gui.add_slider(
            "Time [s]", self._start, max(self._end, self._start + _STEP), 0.01, self._start
        )
        self._speed = gui.add_slider("Speed", 0.1, 4.0, 0.1, 1.0)
        self._follow = add_follow(self.server)
        add_legend(gui)
        add_capture(gui, film.recording.title)
        self._plots = ReplayPlots(self.server, film.numbers, film.deadline)
        self.show(self._start)  # a browser begins with the camera that there is when it comes

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return self.access.url(self.server.get_port())

    def show(self, t: float) -> None:
        """One moment."""
        s = self.film.snapshot(t)
        self.stage.show(s)
        self.stage.follow(s["poses"], bool(self._follow.value))
        numbers = dict(zip(NUMBERS, s["numbers"], strict=True))
        self._about = f", {t:.2f} s{status_text(numbers)}"
        self._head()

    def _head(self) -> None:
        content = f"{self._title}{self._about}{self._rejection.text}"
        if content != self._text.content:
            self._text.content = content

    def run(self) -> None:
        """Play, again and again, until Ctrl-C. Without a browser nothing moves: a replay that was forgotten takes no time."""
        shown = -np.inf
        while True:
            if not self.server.get_clients():
                time.sleep(WAIT)
                continue
            if self._playing.value:
                later = float(self._time.value) + float(self._speed.value) / RATE
                self._time.value = self._start if later > self._end else later
            if self._time.value != shown:
                shown = float(self._time.value)
                self.show(shown)
            self._head()
            self._plots.show(shown)
            time.sleep(1.0 / RATE)


def check_length(film: Film, length: float, what: str) -> None:
    """Raise :class:`InputError` for ``what`` of ``length`` [s] if that is too long: any program may have written the stamps."""
    if length > LONGEST:
        raise InputError(f"{film.recording.path}: has {length:.6g} s; {what} is of at most {LONGEST:g} s")


def write_page(film: Film, path: Path) -> None:
    """The film as one page that needs no server and no network: the robot, and plots that go with its time."""
    check_length(film, float(film.times[-1] - film.times[0]), "a page")
    recording = film.recording
    about = f"Made of {recording.path.name}, {film.times[0]:.6g} to {film.times[-1]:.6g} s."
    write_text(path, plots_page(recording.title, about, overview(recording), replay(film.motion())))
