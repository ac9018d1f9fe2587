"""Which shapes may be near each other, compiled: see :class:`wbmpc.simulation.contacts.Contacts`."""

from __future__ import annotations

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.simulation.compilation import step


@step
def near(n: int, pairs: Integers, centers: Floats, reach: Floats, found: Integers, distance: float) -> int:
    """Of n ``pairs`` of shapes those whose bounding spheres (``reach``: the sum of two radii) are nearer than ``distance`` [m]: into
    ``found``; how many they are."""
    count = 0
    for k in range(n):
        a, b = 3 * pairs[2 * k], 3 * pairs[2 * k + 1]
        x, y, z = centers[a] - centers[b], centers[a + 1] - centers[b + 1], centers[a + 2] - centers[b + 2]
        if np.sqrt(x * x + y * y + z * z) - reach[k] < distance:
            found[count] = k
            count += 1
    return count
