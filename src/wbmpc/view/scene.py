"""The 3D picture in the browser: a scene and what is drawn over it."""

from __future__ import annotations

import html
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import viser

from wbmpc.arrays import Array
from wbmpc.simulation.render import BASE, END_EFFECTOR, REFERENCE, TRAIL
from wbmpc.simulation.scene import Scene, Shape
from wbmpc.view.camera import camera_offset

#: Colors (0 to 255) of what is drawn over the scene, and thickness [m] of lines.
SUPPORT, TRIANGLE, PRESSURE, FORCE = (120, 90, 180), (20, 170, 190), (240, 170, 20), (200, 40, 120)
_THICKNESS = 0.008
#: What the colors mean, for a legend.
LEGEND = {
    "reference of the end effector": REFERENCE, "way of the end effector": TRAIL,
    "predicted end effector": END_EFFECTOR, "predicted base": BASE, "support polygon": SUPPORT,
    "active triangle": TRIANGLE, "ZMP": PRESSURE, "contact forces (2 mm/N)": FORCE,
}  # fmt: skip
#: Spheres larger than this [m] are seen through, with this opacity: a ball that carries a robot hides the force on it.
_BALL, _OPACITY = 0.05, 0.45
#: How far the robot goes before the camera follows [m].
FOLLOW = 0.02
#: How long a new browser's camera is left alone [s]; how long a browser may take to say that it has moved its camera, and how far from
#: where it was to look it may look then [m].
_SETTLING, _PATIENCE, _NEAR = 1.5, 3.0, 0.01


@dataclass
class _Camera:
    """A browser's: where the robot was when it was moved last, from when on it may be moved [s]; and of the last move when that was, where
    it is to look then (None: there was none), and whether the browser has said anything since."""

    followed: Array
    ready: float
    moved: float = 0.0
    target: Array | None = None
    heard: bool = False

    def has_moved(self, client: viser.ClientHandle, now: float) -> bool:
        """Whether what the browser says of its camera is of after the last move: a slow one says for a while where it was before, and a move
        from there would undo the last one."""
        if self.target is None or now - self.moved > _PATIENCE:
            return True
        return self.heard and float(np.linalg.norm(client.camera.look_at - self.target)) < _NEAR

    def hear(self, _: object) -> None:
        """The browser says where its camera is."""
        self.heard = True


class ViewScene:
    """Draws snapshots (see :mod:`wbmpc.view.snapshot`) of one scene on a server."""

    def __init__(self, server: viser.ViserServer, scene: Scene) -> None:
        self.server, self.scene = server, scene
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/floor", 60.0, 60.0, cell_size=0.5, section_size=1.0, position=(0.0, 0.0, 0.001))
        self._bodies = [server.scene.add_frame(f"/bodies/{b.name}", show_axes=False) for b in scene.bodies]
        for i, shape in enumerate(scene.shapes):
            self._shape(i, shape)
        self._followed: Array | None = None
        #: By browser.
        self._cameras: dict[int, _Camera] = {}
        self._light()
        self._lines: dict[str, Any] = {}
        self._shown: dict[str, Array] = {}

    def _shape(self, i: int, shape: Shape) -> None:
        if shape.kind == "plane":
            return  # the grid
        mesh = _mesh(shape)
        if mesh is None:
            return
        parent = "/world" if shape.body == "world" else f"/bodies/{shape.body}"
        pose, opacity = np.array(shape.pose), shape.color[3]
        if shape.kind == "sphere" and shape.size[0] > _BALL:
            opacity = min(opacity, _OPACITY)
        self.server.scene.add_mesh_simple(
            f"{parent}/shape_{i}", np.asarray(mesh.vertices), np.asarray(mesh.faces), color=np.array(shape.color[:3]),
            opacity=None if opacity >= 1.0 else opacity, flat_shading=shape.kind == "box",
            position=pose[:3], wxyz=pose[3:],
        )  # fmt: skip

    def _light(self) -> None:
        scene = self.server.scene
        scene.configure_default_lights(enabled=False)
        # a panorama as one more light takes a browser without a graphics processor longer than all else of its first picture
        scene.configure_environment_map(hdri=None)
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(150, 150, 160), intensity=2.4)
        scene.add_light_directional("/light/sun", intensity=2.2, position=(2.0, -3.0, 5.0))

    def follow(self, poses: Array, on: bool = True) -> None:
        """Move every camera by as much as the robot has moved along the floor since it was moved last; ``poses`` (n, 7).

        A browser that has just come is given its camera, and a moment to take it, before it is moved.
        """
        place = poses[self.scene.index, :3] * [1.0, 1.0, 0.0]
        camera = self.server.initial_camera
        if self._followed is None:
            where = poses[self.scene.index, :3]
            camera.position, camera.look_at = tuple(where + camera_offset(poses, self.scene)), tuple(where)
            self._followed = place
        elif _far(place - self._followed):
            moved, self._followed = place - self._followed, place
            camera.position = tuple(np.array(camera.position) + moved)
            camera.look_at = tuple(np.array(camera.look_at) + moved)
        clients, now = self.server.get_clients(), time.monotonic()
        self._cameras = {i: c for i, c in self._cameras.items() if i in clients}
        for i, client in clients.items():
            if i not in self._cameras:
                _aim(client, np.array(camera.position), np.array(camera.look_at))
                self._cameras[i] = own = _Camera(self._followed, now + _SETTLING)
                client.camera.on_update(own.hear)
            own = self._cameras[i]
            if not on:
                own.followed, own.target = place, None
            elif now > own.ready and _far(place - own.followed) and own.has_moved(client, now):
                moved, own.followed = place - own.followed, place
                own.moved, own.target, own.heard = now, np.array(client.camera.look_at) + moved, False
                _aim(client, client.camera.position + moved, own.target)

    def show(self, s: Mapping[str, Array], overlays: bool = True) -> None:
        """Draw a snapshot; only what has changed is sent. ``overlays``: also what is drawn over the bodies, which costs a
        browser much more than moving them."""
        with self.server.atomic():
            for i, (handle, pose) in enumerate(zip(self._bodies, s["poses"], strict=True)):
                if self._changed(f"body {i}", pose):
                    handle.position, handle.wxyz = pose[:3], pose[3:]
            if not overlays:
                return
            self._path("reference", s["reference"], REFERENCE)
            self._path("trail", s["trail"], TRAIL)
            self._path("end_effector_plan", s["end_effector_plan"], END_EFFECTOR)
            self._path("base_plan", s["base_plan"], BASE)
            for name, color, above in (("support", SUPPORT, 0.0), ("triangle", TRIANGLE, 0.004)):
                corners = s[name][np.isfinite(s[name]).all(axis=1)] + [0.0, 0.0, above]
                self._path(name, np.vstack([corners, corners[:1]]), color)
            cross = s["pressure"] + 0.05 * np.array([[-1, 0, 0], [1, 0, 0], [0, 0, 0], [0, -1, 0], [0, 1, 0]])
            self._path("pressure", cross, PRESSURE)
            self._arrows(s["forces"])

    def _changed(self, name: str, value: Array) -> bool:
        old = self._shown.get(name)
        if old is not None and np.array_equal(old, value, equal_nan=True):
            return False
        self._shown[name] = value.copy()
        return True

    def _path(self, name: str, points: Array, color: tuple[int, int, int]) -> None:
        if not self._changed(name, points):
            return
        points = _drawable(points)
        segments = np.stack([points[:-1], points[1:]], axis=1)
        self._segments(name, segments, color, self.server.scene.add_line_segments, thickness=_THICKNESS)

    def _arrows(self, forces: Array) -> None:
        if self._changed("forces", forces):
            self._segments(
                "forces", _drawable(forces), FORCE, self.server.scene.add_arrows, shaft_radius=0.012, head_radius=0.03
            )

    def _segments(self, name: str, segments: Array, color: tuple[int, int, int], add: Any, **style: float) -> None:
        if name in self._lines:
            self._lines[name].visible = len(segments) > 0
            if len(segments):
                self._lines[name].points = segments
        elif len(segments):
            self._lines[name] = add(f"/over/{name}", segments, color, **style)


def _drawable(points: Array) -> Any:
    """Those (n, …) whose numbers are finite as the browser has them, in single precision."""
    with np.errstate(over="ignore"):
        single = points.astype(np.float32)
    return single[np.isfinite(single).all(axis=tuple(range(1, single.ndim)))]


def _far(moved: Array) -> bool:
    return float(np.linalg.norm(moved)) >= FOLLOW


def _aim(client: viser.ClientHandle, position: Array, target: Array) -> None:
    """Place a browser's camera; one that cannot be turned so is left as it is, for what its browser says of it is the browser's."""
    with suppress(ValueError), client.atomic():
        client.camera.position, client.camera.look_at = position, target


def name_tab(gui: viser.GuiApi, title: str) -> None:
    """Let the browser's tab show a title: the server's page has none but its maker's. An image that does not load sets it."""
    script = f"document.title = {json.dumps(title)}"
    gui.add_html(f'<img src="data:image/png," alt="" style="display:none" onerror="{html.escape(script)}">')


def add_legend(gui: viser.GuiApi) -> None:
    """A folder that says what the colors mean."""
    mark = '<span style="color:rgb{};font-size:1.3em">■</span> {}'
    with gui.add_folder("Colors", expand_by_default=False):
        lines = "<br>".join(mark.format(color, what) for what, color in LEGEND.items())
        gui.add_html(f'<div style="font-size:0.8em;padding:0 0.9em 0.5em">{lines}</div>')


def add_follow(server: viser.ViserServer) -> viser.GuiInputHandle[bool]:
    """Whether the camera follows the robot. Light or dark is in the panel's own settings."""
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server.gui.add_checkbox("Camera follows", True)


def _mesh(shape: Shape) -> trimesh.Trimesh | None:
    size = shape.size
    if shape.kind == "box":
        return trimesh.creation.box(extents=2.0 * np.array(size))
    if shape.kind in ("sphere", "ellipsoid"):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.apply_scale(np.array(size) if shape.kind == "ellipsoid" else size[0])
        return mesh
    if shape.kind == "cylinder":
        return trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=40)
    if shape.kind == "capsule":
        mesh = trimesh.creation.capsule(2.0 * size[1], size[0], count=[24, 24])
        return mesh
    if shape.kind == "mesh":
        return trimesh.Trimesh(np.reshape(shape.vertices, (-1, 3)), np.reshape(shape.faces, (-1, 3)), process=False)
    return None
