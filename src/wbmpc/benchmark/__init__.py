"""The race: the solver against others on the same discretized problems, in one run on one core."""

from wbmpc.benchmark.race import run_benchmark

__all__ = ["run_benchmark"]
