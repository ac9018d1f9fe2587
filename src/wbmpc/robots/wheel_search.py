"""What of a model looks like a wheel."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from wbmpc.robots.mechanism import Array, Joint, Mechanism
from wbmpc.robots.wheel_geometry import radius_of

#: Wheels' centers are at most so much [m] above the lowest.
_LOW = 0.15
#: A joint with a range that is wider [rad] may be a wheel.
_TURNS = 4.0 * np.pi
#: So many joints below a wheel are its rollers.
_ROLLERS = 4
#: A caster's wheel is at least this [m] behind its axis.
_TRAIL = 1e-3
CASTER = re.compile(r"cast[eo]r|passive|idler", re.IGNORECASE)


@dataclass(frozen=True)
class Wheel:
    """``center`` (3) [m] and ``axle`` (3) in the world of the file, at zero; ``radius`` [m] as the shapes show it, or else the height of
    the center above the file's world (``assumed``); ``steer``: a vertical axis above it; ``leg``: a hinge with a vertical axis, or a
    horizontal slide, above that; ``offset`` [m]: from the steering axis; ``passive``: a caster's; ``held``: its rollers and its
    suspension; ``driven``: False for a tire without a drive."""

    joint: str
    center: Array
    axle: Array
    radius: float | None
    assumed: bool
    steer: str | None
    leg: str | None
    offset: float
    passive: bool
    held: tuple[str, ...]
    driven: bool = True

    @property
    def heading(self) -> Array:
        """(2): unit vector along which it rolls at a positive rate."""
        along = np.array([self.axle[1], -self.axle[0]])
        return np.asarray(along / np.linalg.norm(along))

    @property
    def right_below(self) -> bool:
        """Whether it stands under its steering axis, as no caster's wheel does."""
        return self.steer is not None and self.offset < _TRAIL

    @property
    def rollers(self) -> bool:
        """Whether the file draws rollers."""
        return len(self.held) >= _ROLLERS


def find_wheels(mechanism: Mechanism) -> list[Wheel]:
    """Continuous hinges with a horizontal axis, near the ground, with at most vertical axes and suspensions above them."""
    found = [w for j in mechanism.joints.values() if (w := _wheel(mechanism, j)) is not None]
    lowest = min((w.center[2] for w in found), default=0.0)
    low = [w for w in found if w.center[2] <= lowest + _LOW]
    if all(w.passive for w in low):  # a base on casters alone does not move: those that trail nothing are none
        low = [replace(w, passive=w.passive and not w.right_below) for w in low]
    limited = [w for w in low if _has_limits(mechanism, w)]
    if not limited:
        return low
    names, steered = {w.joint for w in limited}, all(w.steer for w in limited)
    powered = any(_says_something(mechanism, w.joint) for w in limited)
    return [w if w.joint in names else _unlimited(w, steered, powered) for w in low]


def _unlimited(wheel: Wheel, steered: bool, powered: bool) -> Wheel:
    """A wheel of whose drive the file says nothing, beside others of which it does: a caster, but beside wheels that are all
    ``steered`` a tire on a fixed axle is no caster: it keeps the base from moving sideways (a tricycle's, a car's rear wheels)."""
    if wheel.passive or wheel.rollers or wheel.steer or not steered:
        return replace(wheel, passive=True)
    return replace(wheel, driven=not powered)


def _has_limits(mechanism: Mechanism, wheel: Wheel) -> bool:
    """Whether the file says anything of its drives; where it does of some wheels, the others are casters."""
    return any(_says_something(mechanism, n) for n in (wheel.joint, wheel.steer) if n)


def _says_something(mechanism: Mechanism, joint: str) -> bool:
    drive = mechanism.joints[joint].drive
    return drive.driven or drive.velocity is not None or drive.effort is not None


def _wheel(mechanism: Mechanism, joint: Joint) -> Wheel | None:
    below = mechanism.below(joint.name)
    turns = joint.range is None or joint.range[1] - joint.range[0] >= _TURNS
    if joint.kind != "hinge" or joint.drive.no_range or not (turns and joint.horizontal) or 0 < len(below) < _ROLLERS:
        return None
    above = [mechanism.joints[n] for n in joint.above if n in mechanism.joints]
    hinges = [a for a in above if a.kind == "hinge" and a.vertical]
    # a leg is above a steering axis
    slides = [a for a in above if a.kind == "slide" and a.horizontal and not _suspends(a) and hinges]
    if not all(a.vertical or a in slides or _suspends(a) for a in above):
        return None
    legs = [*slides, *hinges[:-1]]
    if len(legs) > 1 or any(len(mechanism.below(n)) < len(mechanism.below(joint.name)) for n in below):
        return None
    return _record(mechanism, joint, hinges, legs, [a.name for a in above if a not in (*hinges, *slides)], below)


def _suspends(joint: Joint) -> bool:
    """Whether a joint is a suspension: a short vertical slide, or a rocker that hardly turns."""
    width = np.inf if joint.range is None else joint.range[1] - joint.range[0]
    return bool(width < 0.2 if joint.kind == "slide" else width < 0.5)


def _record(
    mechanism: Mechanism, joint: Joint, hinges: list[Joint], legs: list[Joint], suspension: list[str],
    rollers: list[str],
) -> Wheel:  # fmt: skip
    center = mechanism.data.xpos[mechanism.model.body(joint.body).id].copy()
    drawn = radius_of(mechanism.file, mechanism.model, joint.name)
    height = float(center[2])
    radius = drawn if drawn is not None else height if 0.02 < height < 0.5 else None
    steer = hinges[-1] if hinges else None
    offset = float(np.hypot(*(center - steer.position)[:2])) if steer else 0.0
    names = " ".join((joint.name, joint.body, *(h.name for h in hinges)))
    driven = joint.drive.driven or (steer is not None and steer.drive.driven)
    return Wheel(
        joint.name, center, joint.axis, radius, drawn is None, steer.name if steer else None,
        legs[0].name if legs else None, offset,
        passive=bool(CASTER.search(names)) and not driven, held=(*suspension, *rollers),
    )  # fmt: skip
