from wbmpc.benchmark.problems import *
