"""Simulated robots in MuJoCo, perturbed against the planner's model, and the lockstep loop."""

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
