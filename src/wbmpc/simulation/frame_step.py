"""Frames seen from others, compiled: see :meth:`wbmpc.simulation.world.World.frames`, :meth:`wbmpc.simulation.scene.SceneReader.links`."""

from __future__ import annotations

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.simulation.compilation import step


@step
def from_base(
    base: Floats, rotation: Floats, tool: Floats, tool_rotation: Floats, seen: Floats, turned: Floats
) -> None:
    """Position ``seen`` (3) and rotation ``turned`` (3, 3) in the base's axes of a ``tool``; both in world axes."""
    for i in range(3):
        seen[i] = 0.0
        for j in range(3):
            seen[i] += rotation[3 * j + i] * (tool[j] - base[j])
            turned[3 * i + j] = 0.0
            for k in range(3):
                turned[3 * i + j] += rotation[3 * k + i] * tool_rotation[3 * k + j]


@step
def in_parents(poses: Floats, moving: Integers, parents: Integers, links: Floats, n: int) -> None:
    """``links`` (n, 7): rows ``moving`` (n) of ``poses`` in the frames of rows ``parents`` (n), position and quaternion."""
    for k in range(n):
        a, b, out = 7 * parents[k], 7 * moving[k], 7 * k
        w, x, y, z = poses[a + 3], poses[a + 4], poses[a + 5], poses[a + 6]
        p, q, r, s = poses[b + 3], poses[b + 4], poses[b + 5], poses[b + 6]
        dx, dy, dz = poses[b] - poses[a], poses[b + 1] - poses[a + 1], poses[b + 2] - poses[a + 2]
        links[out] = (1.0 - 2.0 * (y * y + z * z)) * dx + 2.0 * (x * y + w * z) * dy + 2.0 * (x * z - w * y) * dz
        links[out + 1] = 2.0 * (x * y - w * z) * dx + (1.0 - 2.0 * (x * x + z * z)) * dy + 2.0 * (y * z + w * x) * dz
        links[out + 2] = 2.0 * (x * z + w * y) * dx + 2.0 * (y * z - w * x) * dy + (1.0 - 2.0 * (x * x + y * y)) * dz
        links[out + 3] = w * p + x * q + y * r + z * s
        links[out + 4] = w * q - x * p - y * s + z * r
        links[out + 5] = w * r + x * s - y * p - z * q
        links[out + 6] = w * s - x * r + y * q - z * p
