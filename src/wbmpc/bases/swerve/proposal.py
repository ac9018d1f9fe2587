"""How a swerve base is found in a model without a robot file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.bases.base import Proposal, Question
from wbmpc.bases.swerve.model import LARGEST_OFFSET

if TYPE_CHECKING:
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel

#: Rim speed [m/s], steering and leg rates [rad/s], of legs that slide [m/s], where a file has no limit; radius [m] where nothing shows it.
RIM_SPEED, STEER_RATE, LEG_RATE, SLIDE_RATE, RADIUS = 1.5, 5.0, 0.4, 0.17, 0.1
#: How fast they change: rim [m/s²] without slipping, steering and legs [rad/s²], legs that slide [m/s²].
RIM_ACCELERATION, STEER_ACCELERATION, LEG_ACCELERATION, SLIDE_ACCELERATION = 4.0, 60.0, 5.0, 2.0


def propose(mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
    """Wheels under steering axes that turn about +z, on fixed legs, on hinges or on slides; None for others."""
    steered = [w for w in wheels if w.steer is not None]
    if len(steered) < 2 or len(steered) < len(wheels) or len({w.steer for w in steered}) < len(steered):
        return None
    upright = all(mechanism.joints[str(w.steer)].axis[2] > 0.0 for w in steered)
    if not upright or max(w.offset for w in steered) > LARGEST_OFFSET:
        return None
    known = [w.radius for w in steered if w.radius is not None]
    radius = round(float(np.median(known)), 4) if known else RADIUS
    sure = len(known) == len(steered) and not any(w.assumed for w in steered)
    asked = () if sure else (Question("wheel_radius", "radius of the wheels [m]", radius),)
    moved = all(w.leg for w in steered)
    modules = [_module(mechanism, w, moved) for w in steered]
    held = [n for w in steered for n in (*w.held, *(() if moved or not w.leg else (w.leg,)))]
    rates = {"hinge": LEG_RATE, "slide": SLIDE_RATE, "steer": STEER_RATE, "wheel": RIM_SPEED / radius}
    changes = {
        "hinge": LEG_ACCELERATION, "slide": SLIDE_ACCELERATION, "steer": STEER_ACCELERATION,
        "wheel": RIM_ACCELERATION / radius,
    }  # fmt: skip
    speed, acceleration = ({n: round(v[part], 2) for m in modules for part, n in m.items()} for v in (rates, changes))
    reason = f"{len(steered)} wheels under steering axes" + (
        f", on {'sliding' if 'slide' in modules[0] else 'hinged'} legs" if moved else ""
    )
    section: dict[str, Any] = {"wheel_radius": radius, "modules": modules}
    return Proposal(section, 0.9, reason, tuple(speed), tuple(held), speed, acceleration, asked)


def _module(mechanism: Mechanism, wheel: Wheel, moved: bool) -> dict[str, str]:
    leg = {mechanism.joints[wheel.leg].kind: wheel.leg} if moved and wheel.leg else {}
    return {**leg, "steer": str(wheel.steer), "wheel": wheel.joint}
