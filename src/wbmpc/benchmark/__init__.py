"""The race: the solver against others on the same discretised problems, in one run on one core."""

from wbmpc.benchmark.problems import Problem, rezero_bench, suite_bench, swerve_bench
from wbmpc.benchmark.race import run_benchmark

__all__ = ["Problem", "rezero_bench", "run_benchmark", "suite_bench", "swerve_bench"]
