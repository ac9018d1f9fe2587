"""The base type ``planar``: a base that takes speeds, and whose wheels are not described."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.base import Base, Proposal, Question
from wbmpc.bases.planar_motion.description import Place, PlanarBaseDescription
from wbmpc.bases.planar_motion.model import PlanarBase, PointFootprint, standing_on
from wbmpc.bases.planar_motion.plugin import PlanarBaseType
from wbmpc.bases.planar_motion.proposal import RIM_ACCELERATION
from wbmpc.bases.planar_motion.wheels import FixedWheels
from wbmpc.model.tree import Tree, read_tree
from wbmpc.robots import RobotDescription
from wbmpc.robots.findings import Finding
from wbmpc.robots.model_checks import BESIDE

if TYPE_CHECKING:
    from wbmpc.arrays import Array
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel


Acceleration = Annotated[float, Field(gt=0, ge=1e-3, le=1e4)]
#: Where a file says nothing of accelerations, those of a turn follow from the wheels' at this distance [m].
LEVER = 0.4
#: Links of wheels and tracks.
ROLLS = re.compile(r"wheel|cast[eo]r|(?<![a-z])tracks?(?![a-z])", re.IGNORECASE)


class MobileBaseDescription(PlanarBaseDescription):
    """``drive``: "omni" takes speeds ahead, aside and a turn; "differential", "skid" and "tracks" speeds ahead and a turn about ``center``
    [m], how far ahead of the body's frame they turn; ``height`` [m] of the body's frame above the floor; ``acceleration``, of the speeds
    [m/s²] and of the turn [rad/s²], up to which plans change them. Wheels are held (``fixed_joints``). ``casters`` (x, y) [m] in the axes
    of the body: on what it stands in the simulator, by default the corners of a square about its center of mass."""

    joint_key: ClassVar[str] = ""
    takes_twist: ClassVar[bool] = True

    type: Literal["planar"]
    wheels: tuple[str, ...] = Field((), max_length=0)
    wheel_radius: None = None
    drive: Literal["omni", "differential", "skid", "tracks"]
    center: float = Field(0.0, ge=-100, le=100)
    height: float = Field(0.0, ge=-10, le=10)
    acceleration: tuple[Acceleration, Acceleration] = (RIM_ACCELERATION, RIM_ACCELERATION / LEVER)
    casters: tuple[tuple[Place, Place], ...] = ()

    @property
    def slips(self) -> bool:
        """Whether wheels or tracks are dragged sideways in turns."""
        return self.drive in ("skid", "tracks")


class MobileBase(PlanarBase):
    """State: (x, y, yaw) of the body's frame and the arm; input: the base's speeds and the arm's rates. Each of its speeds counts as a wheel
    that turns at that rate."""

    def __init__(
        self, description: RobotDescription, tree: Tree, height: float, names: tuple[str, ...], twist: Array
    ) -> None:
        wheels = FixedWheels(np.zeros((0, 2)), np.zeros(0), 1.0, height)
        super().__init__(description, tree, wheels, np.asarray(np.linalg.pinv(twist), float), names, twist)
        assert isinstance(description.base, MobileBaseDescription)
        ahead, turning = description.base.acceleration
        self.wheel_upper = np.full(len(names), np.inf)
        self.wheel_acceleration = np.array([*[ahead] * (len(names) - 1), turning])
        casters = np.array(description.base.casters).reshape(-1, 2)
        self.footprint = standing_on(PointFootprint(casters, [f"caster {i}" for i in range(len(casters))], True))
        self.feet_of_rows = []  # what it counts are speeds

    def _check_rank(self, description: RobotDescription) -> None:
        """Nothing: there are no wheels."""


class MobileBaseType(PlanarBaseType):
    """Planning, and a simulated base that is driven by a force: its wheels are not described."""

    Description = MobileBaseDescription
    parts: ClassVar[Mapping[str, str]] = {**PlanarBaseType.parts, "plant": "bases.planar.plant:MobilePlant"}

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can be driven."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """Wheels of which no other base type knows how they drive the base; those that do not turn in the file."""
        drawn = [] if wheels else [b for b in mechanism.bodies if ROLLS.search(b)]
        if not wheels and len(drawn) < 2:
            return None
        held = tuple(n for w in wheels for n in (*((w.steer,) if w.steer else ()), w.joint, *w.held))
        turns = _turn_beside_axis(mechanism, wheels)
        drive = "omni" if turns else "skid"
        question = Question("drive", "speeds that the base takes: omni, differential, skid or tracks", drive)
        return Proposal(
            {"drive": drive},
            0.3 if wheels else 0.95,
            f"{len(wheels)} wheels, driven by speeds of the base"
            + (f"; '{wheels[0].steer}' turns them all about an axis beside their axle: any way" if turns else "")
            if wheels
            else f"wheels or tracks that do not turn in the file, '{drawn[0]}' first",
            (),
            held,
            questions=(question,),
        )

    def diagnose(self, description: RobotDescription, base: Base) -> list[Finding]:
        assert isinstance(description.base, MobileBaseDescription)
        if not description.base.slips:
            return []
        text = "wheels or tracks slip sideways in every turn: how far the base turns depends on the floor"
        return [
            Finding(
                "warning", "base", "key 'base.drive'", text,
                "take the base's pose from a gyro and a localization, not from its wheels",
            )
        ]  # fmt: skip

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> MobileBase:
        base = description.base
        assert isinstance(base, MobileBaseDescription)
        names: tuple[str, ...] = ("vx", "vy", "wz") if base.drive == "omni" else ("v", "wz")
        # a point ahead of the center goes aside in turns
        one = np.array([[1.0, 0.0], [0.0, -base.center], [0.0, 1.0]])
        twist = np.eye(3) if base.drive == "omni" else one
        return MobileBase(description, read_tree(spec, base.body), base.height, names, twist)


def _turn_beside_axis(mechanism: Mechanism, wheels: Sequence[Wheel]) -> bool:
    """Whether one steering axis, ahead of or behind their axle, turns several wheels: a caster with two driven wheels, which moves the
    base any way."""
    steers = {w.steer for w in wheels}
    if len(wheels) < 2 or len(steers) > 1 or wheels[0].steer is None:
        return False
    axis = mechanism.joints[wheels[0].steer].position[:2]
    return min(abs(float((w.center[:2] - axis) @ w.heading)) for w in wheels) > BESIDE
