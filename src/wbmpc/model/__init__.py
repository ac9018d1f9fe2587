"""Robot models: layouts, kinematics, dynamics."""

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
