"""Slip of a wheel's contact point, compiled. Truth: NumPy's cross products."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.swerve.slip_step import contact_slip
from wbmpc.kernel.step import Backend, bind


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_slip_is_that_of_the_point_along_wheel_and_axle(backend: Backend) -> None:
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    normal = rng.normal(size=3)
    given = {
        "velocity": rng.normal(size=6),
        "center": rng.normal(size=3),
        "axes": axes.ravel(),
        "at": rng.normal(size=3),
    }
    normal /= np.linalg.norm(normal)
    along = np.cross(axes[:, 1], normal)
    along /= np.linalg.norm(along)
    point = given["velocity"][3:] + np.cross(given["velocity"][:3], given["at"] - given["center"])
    slip = bind(contact_slip, given | {"normal": normal}, backend)()
    np.testing.assert_allclose(slip, [point @ along, point @ np.cross(normal, along)], rtol=1e-12)
