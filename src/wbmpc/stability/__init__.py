"""Stability of robots on three feet or more: support, zero-moment point, margins."""

from wbmpc.stability.assessment import Assessment, assess
from wbmpc.stability.configurations import configuration_positions, configurations
from wbmpc.stability.drawing import draw
from wbmpc.stability.friction import friction_needed
from wbmpc.stability.geometry import (
    Region,
    Triangle,
    area,
    edge_distances,
    hull,
    margin,
    overlap_regions,
    region_margin,
    support_polygon,
    support_triangles,
    triangle_margins,
)
from wbmpc.stability.robot import Stance, StanceOf, Support, counter_clockwise, standing
from wbmpc.stability.stances import best_stance
from wbmpc.stability.zmp import GRAVITY, Load, slope_gravity, zero_moment_point

__all__ = [
    "GRAVITY", "Assessment", "Load", "Region", "Stance", "StanceOf", "Support", "Triangle", "area", "assess",
    "best_stance", "configuration_positions", "configurations", "counter_clockwise", "draw", "edge_distances",
    "friction_needed", "hull", "margin", "overlap_regions", "region_margin", "slope_gravity", "standing",
    "support_polygon", "support_triangles", "triangle_margins", "zero_moment_point",
]  # fmt: skip
