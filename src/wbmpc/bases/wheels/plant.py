"""A mix of wheels in MuJoCo: tires, wheels with real rollers, steering drives, casters on springs."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc.bases.differential.plant import add_casters, add_tire
from wbmpc.bases.omnidirectional.plant import add_rollers
from wbmpc.bases.planar_motion.plant import PlanarPlant
from wbmpc.bases.wheels.description import WheelsBaseDescription


class WheelsPlant(PlanarPlant):
    """Physics, drives and sensors of a robot on a mix of wheels."""

    def add_wheel(self, spec: mujoco.MjSpec, index: int, radius: float, friction: list[float]) -> None:
        """Of a driven wheel: its tire or rollers."""
        base = self.description.base
        assert isinstance(base, WheelsBaseDescription)
        driven = [w for w in base.wheels if w.driven]
        self._touch(spec, driven[index].joint, driven[index].rollers, radius, friction)

    def _touch(
        self, spec: mujoco.MjSpec, name: str, rollers: float | None, radius: float, friction: list[float]
    ) -> None:
        if rollers is None:
            add_tire(spec.joint(name), radius, friction)
        else:
            add_rollers(spec, spec.joint(name), radius, float(np.deg2rad(rollers)), friction)

    def add_supports(self, spec: mujoco.MjSpec, weight: float) -> None:
        base, friction = self.description.base, [self.draw.friction, 0.005, 1e-4]
        assert isinstance(base, WheelsBaseDescription)
        for wheel in base.wheels:
            if not wheel.driven:
                self._touch(spec, wheel.joint, wheel.rollers, self.model_base.geometry.radius, friction)
        for i, name in enumerate(base.joint_groups().get("steer", [])):
            self.drive_joint(spec, name, np.inf, self.draw.mount_lag[min(i, len(self.draw.mount_lag) - 1)])
        if base.casters:
            add_casters(self, spec, weight, np.array(base.casters))
