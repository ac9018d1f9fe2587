"""Swerve bases made of a description only: modules on a ring, legs fixed or on hinges, a small arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

#: A range of steering joints [rad], or none: they turn on and on.
Range = tuple[float, float] | None


def write_base(folder: Path, modules: int, hinged: bool, start: float = 0.4, steering: Range = (-3.14, 3.14)) -> Path:
    """A YAML and an MJCF of a base with ``modules`` modules; the first stands at the angle ``start`` [rad]."""
    names = [f"m{i}" for i in range(modules)]
    angles = start + 2.0 * np.pi * np.arange(modules) / modules
    legs = "".join(
        _leg(n, a, 0.35 + 0.03 * (i % 2), hinged, steering) for i, (n, a) in enumerate(zip(names, angles, strict=True))
    )
    folder.mkdir(exist_ok=True)
    (folder / "base.xml").write_text(f"""<mujoco model="ring">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="hull" pos="0 0 0.30">
      <inertial pos="0 0 0" mass="40" diaginertia="2 2 3"/>
      <geom type="cylinder" size="0.35 0.08" contype="0" conaffinity="0"/>
      {legs}
      <body name="shoulder" pos="0 0 0.1">
        <inertial pos="0 0 0.05" mass="3" diaginertia="0.02 0.02 0.02"/>
        <joint name="pan" axis="0 0 1" range="-3 3"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.04" contype="0" conaffinity="0"/>
        <body name="upper" pos="0 0 0.3">
          <inertial pos="0.15 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
          <joint name="lift" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" contype="0" conaffinity="0"/>
          <site name="hand" pos="0.35 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>""")
    entries = [
        {**({"hinge": f"{n}_leg"} if hinged else {}), "steer": f"{n}_steer", "wheel": f"{n}_wheel"} for n in names
    ]
    # wheels along x of the body at home, on the branch within a quarter turn
    steer = {f"{n}_steer": float((-a + np.pi / 2) % np.pi - np.pi / 2) for n, a in zip(names, angles, strict=True)}
    description = {
        "name": f"ring-{modules}",
        "model": "base.xml",
        "base": {"type": "swerve", "body": "hull", "wheel_radius": 0.08, "modules": entries},
        "arm": {"joints": ["pan", "lift"], "tool": "hand"},
        "home": {**steer, "lift": 0.3},
        "limits": {
            "velocity": {"pan": 2.0, "lift": 2.0, **{f"{n}_steer": 5.0 for n in names}, **{f"{n}_wheel": 10.0 for n in names},
                         **({f"{n}_leg": 0.25 for n in names} if hinged else {})},
            "effort": {"pan": 100.0, "lift": 100.0},
        },
    }  # fmt: skip
    path = folder / "ring.yaml"
    path.write_text(yaml.safe_dump(description))
    return path


def _leg(name: str, angle: float, reach: float, hinged: bool, steering: Range) -> str:
    """A leg of 0.3 m at ``angle``, ``reach`` from the middle; steering and wheel at its end."""
    at = f"{reach * np.cos(angle)} {reach * np.sin(angle)} 0"
    turns = f' range="{steering[0]} {steering[1]}"' if steering else ""
    joint = f'<joint name="{name}_leg" axis="0 0 1" range="-1.2 1.2"/>' if hinged else ""
    return f"""
      <body name="{name}_arm" pos="{at}" euler="0 0 {angle}">
        <inertial pos="0.15 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>{joint}
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" contype="0" conaffinity="0"/>
        <body name="{name}_fork" pos="0.3 0 -0.1">
          <inertial pos="0 0 0" mass="1.5" diaginertia="0.005 0.005 0.005"/>
          <joint name="{name}_steer" axis="0 0 1"{turns}/>
          <body name="{name}_disc" pos="0 0 -0.12">
            <inertial pos="0 0 0" mass="1" diaginertia="0.002 0.004 0.002"/>
            <joint name="{name}_wheel" axis="0 1 0"/>
            <geom type="ellipsoid" size="0.08 0.02 0.08" contype="0" conaffinity="0"/>
          </body>
        </body>
      </body>"""
