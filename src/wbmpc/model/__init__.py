"""Robot models: layouts, kinematics, dynamics."""
