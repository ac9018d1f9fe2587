"""Export the controller, compile ``loop.cpp`` with it, and run the same loop in Python. Run: python examples/cpp_loop/compare.py"""

import math
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from problem import make_mpc

import wbmpc as wb

HERE = Path(__file__).parent


def plant(x, u, h):
    swing = -(9.81 * math.sin(x[1]) + u * math.cos(x[1]))
    return np.array([x[0] + h * x[2], x[1] + h * x[3], x[2] + h * u, x[3] + h * swing])


def in_python():
    mpc, x, states = make_mpc(), np.zeros(4), []
    for k in range(2400):
        t = k / 400.0
        if k == 1200:
            mpc.reference["state"] = wb.Reference.constant([2.0, 0.0, 0.0, 0.0])
        if k % 8 == 0:
            policy = mpc.update(wb.Observation(t, x))
        x = plant(x, policy(t, x)[0], 1.0 / 400.0)
        states.append(x)
    return np.array(states)


def in_cpp(folder):
    wb.export(make_mpc(), folder, prefix="crane")
    # -ffp-contract=off: the plant's products and sums are rounded one by one, as in Python
    options = ["-std=c++17", "-O2", "-ffp-contract=off", f"-I{folder}"]
    subprocess.run(
        ["c++", *options, str(HERE / "loop.cpp"), f"{folder}/crane.o", "-lm", "-o", f"{folder}/loop"], check=True
    )
    text = subprocess.run([f"{folder}/loop"], capture_output=True, text=True, check=True).stdout
    return np.array([[float.fromhex(word) for word in line.split()] for line in text.splitlines()])


with tempfile.TemporaryDirectory() as folder:
    cpp, python = in_cpp(folder), in_python()
print(f"C++: the trolley is at {cpp[-1, 0]:.3f} m; largest difference to Python: {np.abs(cpp - python).max():.3g}")
