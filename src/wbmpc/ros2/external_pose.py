"""Poses of another localization, compared with the robot's own motion before its estimator uses them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.ros2.convert import planar
from wbmpc.ros2.localization import PoseGate
from wbmpc.runtime.safety import SafeStop

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode


class ExternalPose:
    """What the adapter asks for a pose at every control tick."""

    def __init__(self, control: ControlNode) -> None:
        self.control = control
        self._gate = PoseGate(control.settings.topics.pose, control.settings.safety.jump)

    def reset(self) -> None:
        """The robot may be anywhere."""
        self._gate.reset()

    def take(self) -> tuple[float, np.ndarray, np.ndarray] | None:
        """A new pose: its time [s] on the runner's clock, the pose (x, y, yaw), its covariance (3, 3). One that jumps while the
        robot moves does not count: a robot that can stop does (:class:`SafeStop`), and is placed by the next one."""
        control, adapter = self.control, self.control.adapter
        if control.running:
            seen = adapter.snapshot()
            if seen is not None:
                self._gate.note(seen[0], planar(*adapter.planner.base_pose(seen[1])))
        # a robot that would fall goes on without poses
        taken = control.source.newest() if adapter.must_keep_running else control.source.take()
        if taken is None:
            return None
        pose = control.clock.now() - taken[0], *taken[1:]
        estimate = adapter.estimate()
        if not control.running or estimate is None:
            control.source.judge("")
            return pose
        jumped = self._gate.jumped(*pose, estimate.covariance[np.ix_([0, 1, 5], [0, 1, 5])])
        control.source.judge(jumped, adapter.must_keep_running)
        if jumped and not adapter.must_keep_running:
            adapter.relocate()
            raise SafeStop(jumped)
        return None if jumped else pose
