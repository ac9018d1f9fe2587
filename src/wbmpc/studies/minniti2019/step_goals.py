"""The steps of the end effector that `rezero-steps` and `rezero-taskspace` ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc import lie

#: The last second [s] of a step is judged as steady.
STEADY = 1.0


@dataclass(frozen=True)
class Step:
    """A change of the end effector's pose: translation [m] in the world, or a rotation [rad] about a world or end effector axis."""

    name: str
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] | None = None
    angle: float = 0.0
    of_end_effector: bool = False


STEPS = (
    Step("+x 0.2 m", (0.2, 0.0, 0.0)),
    Step("-x 0.2 m", (-0.2, 0.0, 0.0)),
    Step("+y 0.2 m", (0.0, 0.2, 0.0)),
    Step("-y 0.2 m", (0.0, -0.2, 0.0)),
    Step("+z 0.1 m", (0.0, 0.0, 0.1)),
    Step("-z 0.1 m", (0.0, 0.0, -0.1)),
    Step("yaw 30 deg", axis=(0.0, 0.0, 1.0), angle=np.pi / 6),
    Step("pitch 20 deg", axis=(0.0, 1.0, 0.0), angle=np.pi / 9, of_end_effector=True),
)
#: A roll about the forearm, which an arm with yaw and two pitch joints does not have: asked for last, then home again.
IMPOSSIBLE = Step("roll 30 deg", axis=(0.0, 0.0, 1.0), angle=np.pi / 6, of_end_effector=True)


def target(step: Step, position: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The end effector's pose after a step from home."""
    if step.axis is None:
        return position + np.array(step.move), quaternion
    turn = lie.quaternion_about(step.axis, step.angle)
    turned = (
        lie.quaternion_multiply(quaternion, turn) if step.of_end_effector else lie.quaternion_multiply(turn, quaternion)
    )
    return position, turned
