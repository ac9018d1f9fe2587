"""Runs inside crocoddyl's own environment: reads problems as JSON from standard input, writes figures as JSON.

Imports nothing of this library. The models are built from crocoddyl's own C++ classes, so that no Python runs in its loops.
"""

import json
import sys
import time
from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin

Spec = dict[str, Any]


def placement(link: Spec) -> Any:
    return pin.SE3(np.array(link["rotation"]), np.array(link["position"]))


def multibody(links: list[Spec], tip: Spec, armature: float) -> Any:
    """Pinocchio's model of a list of links with one joint each; the frame ``tip`` is fixed to its link."""
    model = pin.Model()
    ids: list[int] = []
    for link in links:
        axis = np.array(link["axis"], float)
        revolute = link["kind"] == "revolute"
        joint = pin.JointModelRevoluteUnaligned(axis) if revolute else pin.JointModelPrismaticUnaligned(axis)
        parent = ids[link["parent"]] if link["parent"] >= 0 else 0
        index = model.addJoint(parent, joint, placement(link), link["name"])
        inertia = pin.Inertia(link["mass"], np.array(link["com"]), np.array(link["inertia"]))
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        ids.append(index)
    model.addFrame(pin.Frame("tip", ids[tip["link"]], 0, placement(tip), pin.FrameType.OP_FRAME))
    model.armature = np.full(model.nv, armature)
    return model


def weighted(weights: list[float]) -> Any:
    return crocoddyl.ActivationModelWeightedQuad(np.array(weights, float))


def action(spec: Spec, state: Any, model: Any, step: float, terminal: bool) -> Any:
    """One node: ½ Σ w r² of end effector, state and torque as in the library's problem; free forward dynamics."""
    actuation = crocoddyl.ActuationModelFull(state)
    costs = crocoddyl.CostModelSum(state, actuation.nu)
    tip, hand = model.getFrameId("tip"), spec["hand"]
    target = crocoddyl.ResidualModelFrameTranslation(state, tip, np.array(hand["position"]), actuation.nu)
    costs.addCost("end_effector", crocoddyl.CostModelResidual(state, weighted(hand["weight"]), target), 1.0)
    if "orientation" in hand:
        goal = pin.SE3(np.array(hand["orientation"]), np.array(hand["position"]))
        turn = crocoddyl.ResidualModelFrameRotation(state, tip, goal.rotation, actuation.nu)
        costs.addCost("turn", crocoddyl.CostModelResidual(state, weighted(hand["turn_weight"]), turn), 1.0)
        still, axes = pin.Motion.Zero(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        speed = crocoddyl.ResidualModelFrameVelocity(state, tip, still, axes, actuation.nu)
        costs.addCost("speed", crocoddyl.CostModelResidual(state, weighted(hand["speed_weight"]), speed), 1.0)
    error = crocoddyl.ResidualModelState(state, np.array(spec["reference"]), actuation.nu)
    costs.addCost("state", crocoddyl.CostModelResidual(state, weighted(spec["state_weight"]), error), 1.0)
    if not terminal:
        torque = crocoddyl.ResidualModelControl(state, np.array(spec["torque"]))
        costs.addCost("torque", crocoddyl.CostModelResidual(state, weighted(spec["torque_weight"]), torque), 1.0)
    free = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
    if terminal or spec["integrator"] == "euler":
        return crocoddyl.IntegratedActionModelEuler(free, 0.0 if terminal else step)
    return crocoddyl.IntegratedActionModelRK(free, crocoddyl.RKType.two, step)


def shooting(spec: Spec) -> tuple[Any, np.ndarray]:
    n = spec["intervals"]
    if spec["kind"] == "lqr":
        node = crocoddyl.ActionModelLQR(spec["nx"], spec["nu"], False)
        end = crocoddyl.ActionModelLQR(spec["nx"], spec["nu"], False)
        return crocoddyl.ShootingProblem(np.ones(spec["nx"]), [node] * n, end), np.zeros(spec["nu"])
    model = multibody(spec["links"], spec["tip"], spec["armature"])
    state = crocoddyl.StateMultibody(model)
    nodes = [action(spec, state, model, spec["horizon"] / n, False)] * n
    end = action(spec, state, model, 0.0, True)
    return crocoddyl.ShootingProblem(np.array(spec["x0"]), nodes, end), np.array(spec["u0"])


def run(spec: Spec) -> Spec:
    """Milliseconds of one iteration: derivatives, direction, one trial; and of a whole solve with its iterations."""
    problem, u0 = shooting(spec)
    problem.nthreads = 1
    solver = crocoddyl.SolverFDDP(problem)
    xs, us = [np.array(problem.x0)] * (problem.T + 1), [u0] * problem.T
    start = time.process_time()
    solver.th_stop = 1e-12
    done = solver.solve(xs, us, 200, False)
    total, iterations = time.process_time() - start, solver.iter + 1
    parts: dict[str, list[float]] = {"iteration": [], "direction": [], "derivatives": []}
    for _ in range(spec["repeat"]):
        solver.setCandidate(solver.xs, solver.us, False)
        a = time.process_time()
        problem.calc(solver.xs, solver.us)
        problem.calcDiff(solver.xs, solver.us)
        b = time.process_time()
        solver.computeDirection(False)
        c = time.process_time()
        solver.tryStep(1.0)
        d = time.process_time()
        for name, value in (("iteration", d - a), ("direction", c - b), ("derivatives", b - a)):
            parts[name].append(1e3 * value)
    figures = {f"{name}_ms": float(np.min(values)) for name, values in parts.items()}
    tip = None
    if spec["kind"] != "lqr":
        model = multibody(spec["links"], spec["tip"], spec["armature"])
        data = model.createData()
        pin.framesForwardKinematics(model, data, np.array(solver.xs[-1][: model.nq]))
        tip = data.oMf[model.getFrameId("tip")].translation.tolist()
    counts = {"iterations": int(iterations), "total_ms": 1e3 * total, "success": bool(done), "cost": float(solver.cost)}
    return {**figures, **counts, "tip": tip, "version": crocoddyl.__version__}


if __name__ == "__main__":
    answers = []
    for given in json.load(sys.stdin):
        try:
            answers.append(run(given))
        except Exception as error:
            answers.append({"success": False, "error": str(error)[:200]})
    json.dump(answers, sys.stdout)
