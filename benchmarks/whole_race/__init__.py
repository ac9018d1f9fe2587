"""The whole race: more peers, quadratic programs, a C build, the floor, scaling and the closed loop. ``python benchmarks/race.py``."""
