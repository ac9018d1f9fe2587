"""Slip of wheels' contact points, compiled. Truth: velocities of MuJoCo's own function, and NumPy's cross products."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from toys import made
from wbmpc import load_robot
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.slip_step import contact_slips
from wbmpc.kernel.step import Backend, bind


def expected(plant: SwervePlant) -> np.ndarray:
    """(n, 2) [m/s]: of each wheel at its deepest contact, along the wheel and along its axle."""
    m, d, slip = plant.model, plant.data, np.zeros((4, 2))
    for i, module in enumerate(plant.base.modules):
        geom = m.geom(f"contact_{module.wheel}").id
        own = [c for c in d.contact if geom in (c.geom1, c.geom2)]
        if not own:
            continue
        contact, body, velocity = min(own, key=lambda c: c.dist), m.geom_bodyid[geom], np.zeros(6)
        mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        point = velocity[3:] + np.cross(velocity[:3], contact.pos - d.xpos[body])
        along = np.cross(d.xmat[body].reshape(3, 3)[:, 1], contact.frame[:3])
        along /= np.linalg.norm(along)
        slip[i] = point @ along, point @ np.cross(contact.frame[:3], along)
    return slip


def rolling() -> SwervePlant:
    """A robot whose wheels drag each other."""
    plant = SwervePlant(load_robot("swerve-ur10").description)
    for _ in range(40):
        plant.step(SwerveCommand(np.array([3.0, 1.0, -2.0, 0.5]), np.full(4, 0.3), np.zeros(6), np.zeros(4)), 5)
    plant.world.refresh()
    return plant


def test_slip_is_that_of_the_deepest_contact_point_along_wheel_and_axle() -> None:
    plant = rolling()
    found = plant._slip()
    assert (np.abs(found) > 1e-3).any(axis=1).all(), "all wheels slip"
    np.testing.assert_allclose(found, expected(plant), rtol=1e-9, atol=1e-12)


def test_there_is_room_for_any_number_of_contacts_and_a_wheel_in_the_air_has_none() -> None:
    plant = rolling()
    plant._bind_slip(1)
    np.testing.assert_allclose(plant._slip(), expected(plant), rtol=1e-9, atol=1e-12)
    lifted = SwervePlant(load_robot("swerve-ur10").description, lift=0.5, settle=0.0)
    assert not lifted._slip().any()


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_of_several_contacts_of_a_wheel_the_deepest_counts(backend: Backend) -> None:
    rng = np.random.default_rng(0)
    frames = np.ascontiguousarray(np.linalg.qr(rng.normal(size=(3, 3, 3)))[0])
    given = {
        "geoms": np.array([7, 9]), "bodies": np.array([1, 2]), "roots": np.array([1, 1]), "cvel": rng.normal(size=(3, 6)),
        "subtree_com": rng.normal(size=(3, 3)), "xmat": np.ascontiguousarray(np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]),
        "touching": np.array([[0, 7], [7, 3], [4, 5]]), "distance": np.array([-0.1, -0.2, -0.3]), "at": rng.normal(size=(3, 3)),
        "frame": frames, "slip": np.ones((2, 2)),
    }  # fmt: skip
    flat = {name: values.ravel() for name, values in given.items()}  # (views)
    made(backend, bind, contact_slips, flat, n=2)(3)
    point = given["cvel"][1, 3:] + np.cross(given["cvel"][1, :3], given["at"][1] - given["subtree_com"][1])
    along = np.cross(given["xmat"][1][:, 1], frames[1, 0])
    along /= np.linalg.norm(along)
    np.testing.assert_allclose(given["slip"][0], [point @ along, point @ np.cross(frames[1, 0], along)], rtol=1e-12)
    assert not given["slip"][1].any()
