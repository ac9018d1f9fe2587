"""Tests of this directory may import what stands beside them, and the benchmark of the bus."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "benchmarks")]
