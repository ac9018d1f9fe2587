"""Simulated robots in MuJoCo, perturbed against the planner's model, and the lockstep loop."""
