"""What messages about obstacles contain, checked: whatever cannot be meant is an :class:`InputError`, and nothing of such a message counts.

Coordinates are those of a message's own frame, lengths in m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.checks import unit_quaternions
from wbmpc.errors import InputError
from wbmpc.mapping.distances import ERROR, DistanceTransform
from wbmpc.obstacles.shapes import Box, DistanceGrid
from wbmpc.ros2.convert import LARGEST_NUMBER, check_numbers, read_pose, read_vector

#: Of one message: objects, cells, points at most.
MAX_OBJECTS, MAX_CELLS, MAX_POINTS = 200, 4_000_000, 500_000
#: Characters of an object's identity.
MAX_NAME = 100
#: Occupancy grids reach so far [m] below the floor, and know distances up to this [m].
BELOW, FARTHEST = 0.5, 2.0
#: How far the axis of a grid may lean [rad].
LEVEL = 0.01
#: NumPy's types of fields of a point cloud, by sensor_msgs/PointField's numbers.
_NUMBERS = {7: "f4", 8: "f8"}


@dataclass(frozen=True)
class Detection:
    """A box of ``half`` lengths (3) at ``position`` (3) with ``orientation`` (4). ``name``: its identity; empty: none."""

    name: str
    half: Array
    position: Array
    orientation: Array

    @property
    def shape(self) -> Box:
        """Of the obstacle."""
        return Box(self.half)


def read_detections(message: Any) -> list[Detection]:
    """Of a vision_msgs/Detection3DArray. Raises :class:`InputError`."""
    if len(message.detections) > MAX_OBJECTS:
        raise InputError(f"{len(message.detections)} detections; valid: at most {MAX_OBJECTS}")
    found = [_detection(i, d, message.header.frame_id) for i, d in enumerate(message.detections)]
    names = [d.name for d in found if d.name]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"two detections have the id '{twice[0]}'")
    return found


def _detection(i: int, message: Any, frame: str) -> Detection:
    who = f"detection {i}"
    if message.header.frame_id not in ("", frame):
        raise InputError(f"{who} is in the frame '{message.header.frame_id}', the message in '{frame}'")
    if len(message.id) > MAX_NAME or not message.id.isprintable():
        raise InputError(f"{who}: its id needs at most {MAX_NAME} characters that can be printed")
    size = read_vector(message.bbox.size, f"{who}, size")
    if not (size > 0.0).all():
        raise InputError(f"{who}: three positive lengths are needed as its size, got {size.tolist()}")
    return Detection(str(message.id), 0.5 * size, *read_pose(message.bbox.center, who))


def read_occupancy(message: Any, occupied: int, unknown: bool, height: float) -> tuple[DistanceGrid, Array, Array]:
    """Of a nav_msgs/OccupancyGrid: distances to what is at least ``occupied`` from the floor up to ``height``, cells of ``unknown``
    occupancy among them or not; position (3) and orientation (4) of the grid's axes. Raises :class:`InputError`."""
    info = message.info
    width, rows, cell = int(info.width), int(info.height), float(info.resolution)
    if not (width >= 2 and rows >= 2 and width * rows <= MAX_CELLS):
        raise InputError(f"a grid of {width} x {rows} cells; valid: 2 or more each, {MAX_CELLS} at most together")
    if not 1e-3 <= cell <= 10.0:
        raise InputError(f"the grid's resolution is {cell:.4g} m; valid: 0.001 to 10 m")
    if len(message.data) != width * rows:
        raise InputError(f"the grid of {width} x {rows} cells has {len(message.data)} values")
    values = np.frombuffer(message.data, np.int8) if isinstance(message.data, bytes) else np.asarray(message.data)
    if values.min() < -1 or values.max() > 100:
        raise InputError("a value of the grid is out of range; valid: -1 to 100")
    position, orientation = read_pose(info.origin, "the grid's origin")
    if lie.quaternion_to_rotation(orientation)[2, 2] < np.cos(LEVEL):
        raise InputError("the grid's origin leans; valid: a turn about the vertical")
    solid = ((values >= occupied) | ((values < 0) & unknown)).reshape(rows, width).T
    evidence = np.ascontiguousarray(np.repeat(solid[:, :, None], 2, axis=2), np.int64)
    distances = DistanceTransform(evidence.shape, cell, FARTHEST)(evidence, 1)
    origin = (0.5 * cell, 0.5 * cell, -BELOW)
    return DistanceGrid(origin, cell, distances, ERROR * cell, height + BELOW), position, orientation


def read_points(message: Any) -> Array:
    """Points (n, 3) of a sensor_msgs/PointCloud2; those that are not finite are no measurements: of a cloud of such ones alone, as
    of a camera whose lens is covered, it is not known what is free. Raises :class:`InputError`."""
    count, step, row = int(message.width) * int(message.height), int(message.point_step), int(message.row_step)
    if count > MAX_POINTS:
        raise InputError(f"a cloud of {count} points; valid: at most {MAX_POINTS}")
    if row < int(message.width) * step or len(message.data) != row * int(message.height):
        raise InputError(
            f"a cloud of {message.width} x {message.height} points of {step} bytes has rows of {row} and {len(message.data)} bytes"
        )
    order = ">" if message.is_bigendian else "<"
    fields = {f.name: f for f in message.fields}
    for axis in "xyz":
        if axis not in fields or fields[axis].datatype not in _NUMBERS:
            raise InputError(f"the cloud's field '{axis}' is missing, or of another type than FLOAT32 or FLOAT64")
        kind = np.dtype(order + _NUMBERS[fields[axis].datatype])
        if not 0 <= fields[axis].offset <= step - kind.itemsize:
            raise InputError(f"the cloud's field '{axis}' begins at byte {fields[axis].offset}, points have {step}")
    if sum(f.name in ("x", "y", "z") for f in message.fields) > 3:
        raise InputError("the cloud has two fields 'x', 'y' or 'z'")
    ends = sorted((fields[a].offset, fields[a].offset + np.dtype(_NUMBERS[fields[a].datatype]).itemsize) for a in "xyz")
    if ends[0][1] > ends[1][0] or ends[1][1] > ends[2][0]:
        raise InputError("the cloud's fields 'x', 'y' and 'z' overlap")
    if count == 0:
        return np.zeros((0, 3))
    kinds = [np.dtype(order + _NUMBERS[fields[a].datatype]) for a in "xyz"]
    offsets = [int(fields[a].offset) for a in "xyz"]
    layout = np.dtype({"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": step})
    data = np.frombuffer(bytes(message.data), np.uint8).reshape(int(message.height), row)
    packed = np.ascontiguousarray(data[:, : int(message.width) * step]).view(layout).reshape(-1)
    with np.errstate(invalid="ignore"):  # a signaling NaN would be a warning on the terminal
        points = np.stack([packed[a].astype(float) for a in "xyz"], axis=1)
    measured = (np.abs(points) < LARGEST_NUMBER).all(axis=1)  # False where one is not a number
    if not measured.any():
        raise InputError(f"none of the cloud's {count} points is a measurement: is the sensor covered?")
    return points[measured]


def read_transform(message: Any) -> tuple[str, str, Array, Array]:
    """Parent, child, position (3) and orientation (4) of a geometry_msgs/TransformStamped. Raises :class:`InputError`."""
    parent, child = str(message.header.frame_id), str(message.child_frame_id)
    if not parent or not child or parent == child:
        raise InputError(f"a transform from '{parent}' to '{child}' is none")
    who, t = f"transform from '{parent}' to '{child}'", message.transform
    q = check_numbers(np.array([getattr(t.rotation, n) for n in lie.PARTS], float), who)
    return parent, child, read_vector(t.translation, who), unit_quaternions(who, q)
