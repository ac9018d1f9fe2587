"""What the metrics of experiments with any robot are: by name unit and definition. One table: they mean the same everywhere."""

from __future__ import annotations

from wbmpc.experiment import Definitions

DEFINITIONS: Definitions = {
    "fell": ("1", "whether the robot fell: 1 if it did"),
    "end_effector_error_mean": ("m", "mean distance of the end effector from its reference; true kinematics on the estimated base"),
    "end_effector_error_mean_world": ("m", "mean distance of the end effector from its reference; true"),
    "end_effector_error_max": ("m", "largest distance of the end effector from its reference; true kinematics on the estimated base"),
    "end_effector_error_max_world": ("m", "largest distance of the end effector from its reference; true"),
    "rotation_error_max": ("rad", "largest angle of the end effector to its reference"),
    "base_path_length": ("m", "length of the way of the base over the floor; true"),
    "odometry_drift_ratio": ("1", "final error of the estimated position of the base over its way"),
    "limit_violation_max": ("rad", "largest angle of a joint beyond its range"),
    "path_time": ("s", "time from the start until the end effector is at the end of the path"),
    "contour_error_rms_world": ("m", "rms distance of the end effector from the path until its end is reached, at any time; true"),
    "contour_error_max_world": ("m", "largest distance of the end effector from the path until its end is reached, at any time; true"),
    "grasp_error_mean": ("m", "mean distance of the second end effector, seen from the first, from where it was when they began to hold; true"),
    "grasp_error_max": ("m", "largest distance of the second end effector, seen from the first, from where it was when they began to hold; true"),
    "grasp_rotation_max": ("rad", "largest angle of the second end effector, seen from the first, to how it was when they began to hold; true"),
    "goals_reached": ("1", "share of the goals that the end effector is at for the last half second"),
    "goal_error_max": ("m", "largest distance from a goal in its last half second; estimated"),
    "base_error_mean": ("m", "mean distance of the estimated base from where its orders lead"),
    "base_error_mean_world": ("m", "mean distance of the base from where its orders lead; true"),
    "obstacle_clearance_min": ("m", "smallest distance of the robot to an obstacle; true"),
    "obstacle_contacts": ("1", "how often the robot touched an obstacle"),
    "obstacle_contacts_caused": ("1", "contacts with obstacles that began with the robot moving into them faster than 2 cm/s"),
    "contact_speed_max": ("m/s", "largest speed of a part of the robot into an obstacle that it touches"),
    "pushed_time_max": ("s", "longest contact with an obstacle"),
    "time_stuck": ("s", "time in which the robot stood 5 cm and more off its reference"),
    "braking_plans": ("1", "plans that stop the robot"),
    "reference_delay": ("s", "how long the references waited for the robot"),
    "goal_missed": ("m", "distance of the end effector from the end of its path; true"),
    "passed": ("1", "whether the end effector is within 5 cm of the end of its path at the end: 1 if it is"),
    "map_age_max": ("s", "largest age of the local map"),
    "map_points_dropped": ("1", "points of range sensors that were no measurements or came too late"),
    "wheel_load_min": ("N", "smallest contact force of a wheel; true"),
    "wheel_lifted_time_max": ("s", "longest time in which a wheel carries nothing; true"),
    "tilt_change_max": ("rad", "largest change of the tilt of the base against how it stood; true"),
    "stopping_distance": ("m", "largest way of the base from the order to stop until it rests"),
    "stopping_time": ("s", "time from the order to stop until the base rests"),
}  # fmt: skip
