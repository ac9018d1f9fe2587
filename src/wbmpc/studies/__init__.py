"""Experiments of two papers, one file each. Nothing outside of this package imports it: :mod:`wbmpc.registry` finds them."""

from __future__ import annotations

#: The main experiment of each paper: what 'wbmpc demo' runs.
DEMO = ("swerve-track", "rezero-steps")
#: Name -> "module:attribute" of the built-in experiments, in the order of 'wbmpc list'. The entry points in pyproject.toml are the
#: same table.
EXPERIMENTS: dict[str, str] = {
    "swerve-track": "wbmpc.studies.pankert2022.track:EXPERIMENT",
    "swerve-fixed": "wbmpc.studies.pankert2022.fixed:EXPERIMENT",
    "swerve-calibrate": "wbmpc.studies.pankert2022.calibrate:EXPERIMENT",
    "swerve-brakes": "wbmpc.studies.pankert2022.brakes:EXPERIMENT",
    "swerve-drive": "wbmpc.studies.pankert2022.drive:EXPERIMENT",
    "legs": "wbmpc.studies.pankert2022.legs:EXPERIMENT",
    "swerve-fast": "wbmpc.studies.pankert2022.fast:EXPERIMENT",
    "swerve-plaster": "wbmpc.studies.pankert2022.plaster:EXPERIMENT",
    "swerve-wipe": "wbmpc.studies.pankert2022.wipe:EXPERIMENT",
    "swerve-stability": "wbmpc.studies.pankert2022.stability:EXPERIMENT",
    "swerve-unified": "wbmpc.studies.pankert2022.unified:EXPERIMENT",
    "swerve-wobble": "wbmpc.studies.pankert2022.wobble:EXPERIMENT",
    "rezero-steps": "wbmpc.studies.minniti2019.steps:EXPERIMENT",
    "rezero-circle": "wbmpc.studies.minniti2019.circle:EXPERIMENT",
    "touch": "wbmpc.studies.minniti2019.touch:EXPERIMENT",
    "slip": "wbmpc.studies.minniti2019.slip:EXPERIMENT",
    "rezero-door": "wbmpc.studies.minniti2019.door:EXPERIMENT",
    "rezero-frequency": "wbmpc.studies.minniti2019.frequency:EXPERIMENT",
    "rezero-taskspace": "wbmpc.studies.minniti2019.taskspace:EXPERIMENT",
    "rezero-wholebody": "wbmpc.studies.minniti2019.wholebody:EXPERIMENT",
    "rezero-obstacles": "wbmpc.studies.minniti2019.obstacles:EXPERIMENT",
    "rezero-push-ball": "wbmpc.studies.minniti2019.push:BALL_EXPERIMENT",
    "rezero-push-hand": "wbmpc.studies.minniti2019.push:HAND_EXPERIMENT",
    "rezero-push-limit-ball": "wbmpc.studies.minniti2019.push_limit:BALL_EXPERIMENT",
    "rezero-push-limit-hand": "wbmpc.studies.minniti2019.push_limit:HAND_EXPERIMENT",
}
