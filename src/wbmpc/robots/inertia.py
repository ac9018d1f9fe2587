"""Finds impossible masses and inertias of links, and replaces them for planners that do not use them."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc.robots.findings import Finding

#: Mass [kg] of a link that moves and has none.
LIGHTEST = 1e-3
#: Density [kg/m³] of the sphere whose inertia replaces an impossible one.
DENSITY = 1000.0
#: Radius of gyration [m] that no link of a robot has: an inertia in kg mm² makes 50 m of 5 cm.
_WIDEST = 5.0
#: MuJoCo treats smaller moments [kg m²] as zero.
_SMALLEST = 2e-14
#: Relative tolerance of the triangle inequality of the moments: exporters round.
_ROUNDING = 1e-6
_FIX = "give its true mass and inertia in the file"


def sphere_inertia(mass: float) -> float:
    """Moment of inertia [kg m²] of a solid sphere of ``mass`` [kg] and :data:`DENSITY`."""
    radius = (3.0 * mass / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)
    return float(0.4 * mass * radius**2)


def replace_inertias(spec: mujoco.MjSpec, balance: bool) -> list[Finding]:
    """Replace, in place, inertias that are not positive definite, and those of moving links without mass; one finding for each.

    ``balance``: let MuJoCo also balance moments of an MJCF that violate the triangle inequality, as it does for URDFs.
    """
    found = []
    for body in spec.bodies[1:]:
        _drop_massless_inertial(body)
        if body.explicitinertial and (fault := _fault(body)) is not None:
            _replace(body, float(body.mass) if body.mass > LIGHTEST else LIGHTEST)
            found.append(
                Finding("warning", "inertia", f"link '{body.name}'", f"{fault}; that of a sphere is used", _FIX)
            )
    spec.compiler.balanceinertia = spec.compiler.balanceinertia or balance
    return found + [_give_mass(body) for body in spec.bodies[1:] if body.joints and not _has_mass(body)]


def _drop_massless_inertial(body: mujoco.MjsBody) -> None:
    """An inertial without mass says nothing; MuJoCo would reject its inertia where that is zero too."""
    if body.explicitinertial and body.mass == 0.0 and np.linalg.eigvalsh(inertia_matrix(body))[0] <= _SMALLEST:
        body.explicitinertial, body.fullinertia = False, np.full(6, np.nan)
        for geom in body.geoms:
            geom.mass = 0.0


def _fault(body: mujoco.MjsBody) -> str | None:
    """What is wrong with the inertia that a file gives a body."""
    matrix = inertia_matrix(body)
    if not np.isfinite(matrix).all() or not np.isfinite(body.mass):
        return "its inertia is not finite"
    moments = np.linalg.eigvalsh(matrix)
    if body.mass == 0.0:
        return None  # it may hang on something that has mass
    if body.mass < 0.0:
        return "its mass is negative"
    if moments[0] <= _SMALLEST:
        return "its inertia is not positive"
    radius = float(np.sqrt(moments[2] / body.mass))
    if radius > _WIDEST:
        return f"its inertia is that of {body.mass:.3g} kg on a circle with a radius of {radius:.3g} m, at most {_WIDEST:g} m is possible"
    return None


def violates_triangle_inequality(body: mujoco.MjsBody) -> bool:
    """Whether one moment of inertia is larger than the sum of the two others, which is impossible."""
    moments = np.linalg.eigvalsh(inertia_matrix(body))
    return bool(moments[0] + moments[1] < moments[2] * (1.0 - _ROUNDING))


def inertia_matrix(body: mujoco.MjsBody) -> np.ndarray:
    """(3, 3) [kg m²] as the file gives it."""
    xx, yy, zz, xy, xz, yz = body.fullinertia
    if np.isnan(xx):
        return np.diag(np.asarray(body.inertia, float))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _replace(body: mujoco.MjsBody, mass: float) -> None:
    body.explicitinertial, body.fullinertia = True, np.full(6, np.nan)
    body.mass, body.inertia = mass, np.full(3, sphere_inertia(mass))
    if not np.isfinite(body.ipos).all():
        body.ipos = np.zeros(3)


def _has_mass(body: mujoco.MjsBody) -> bool:
    """Whether a body, or one that is fixed to it, weighs anything."""
    if body.explicitinertial:
        own = body.mass > 0.0
    else:
        own = any(g.mass != 0.0 and g.density != 0.0 for g in body.geoms)
    return own or any(not child.joints and _has_mass(child) for child in body.bodies)


def _give_mass(body: mujoco.MjsBody) -> Finding:
    _replace(body, LIGHTEST)
    body.ipos, body.iquat = np.zeros(3), [1.0, 0.0, 0.0, 0.0]
    return Finding(
        "warning", "mass", f"link '{body.name}'", f"it moves and has no mass; {LIGHTEST:g} kg is taken", _FIX
    )
