# make demo   sets up everything and runs the two experiments
# make test   sets up everything and runs the tests
PYTHON ?= python3
VENV ?= .venv
# at most this many test processes
PYTEST_WORKERS ?= 2
BIN := $(VENV)/bin
ENVIRONMENT := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
.PHONY: demo test fast bench race realtime bus soak study reproduce readme lateness random grids limits robustness swerve rivals ball ball-rivals regulators ball-robustness door push-map rates twist frequency lint format pictures clean

demo: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/wbmpc demo

# those that need the wall clock run after the others and alone, so that other tests do not take their time;
# both parts run whatever the first one said (5: nothing selected); "worksteal" leaves the tests of a module with one process, so
# that what they share is made once
test: $(VENV)/.tested
	@status=0; \
	$(ENVIRONMENT) $(BIN)/python -m pytest -n auto --maxprocesses $(PYTEST_WORKERS) --dist worksteal -m "not wallclock" $(PYTEST_ARGS) || status=$$?; \
	$(ENVIRONMENT) $(BIN)/python -m pytest -m wallclock $(PYTEST_ARGS) || { late=$$?; [ $$late = 5 ] || status=$$late; }; \
	[ $$status = 5 ] || exit $$status

# a minute of tests that need no long run: what breaks often
FAST_TESTS := tests/test_layering.py tests/test_lie.py tests/test_configuration.py tests/ocp tests/kernel/test_cache_owner.py \
	tests/solver/test_sqp.py tests/solver/test_riccati.py tests/mpc/test_policy_limits.py tests/mpc/test_buffer.py
fast: $(VENV)/.tested
	$(ENVIRONMENT) $(BIN)/python -m pytest -x -n auto --maxprocesses $(PYTEST_WORKERS) -m "not wallclock" $(FAST_TESTS)

# against other solvers, then the soak
bench: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/wbmpc bench
	$(ENVIRONMENT) $(BIN)/python benchmarks/soak.py

# the whole race: more peers, C, scaling, floor, closed loop (minutes)
race: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/wbmpc bench --peers --out runs/race

# both robots by the wall clock, 60 s each; REALTIME_ARGS="--process --fifo" and others
realtime: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/python benchmarks/realtime.py $(REALTIME_ARGS)

# the swerve robot over a ROS 2 bus: two processes against one, the stream of commands
bus: $(VENV)/.tested
	$(ENVIRONMENT) $(BIN)/python benchmarks/ros2_bus.py $(BUS_ARGS)

# 100 000 solves: memory and drift
soak: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/python benchmarks/soak.py

# the reporting seeds of both experiments (minutes)
study: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/python benchmarks/seeds.py

# every experiment over the reporting seeds and one site of it: reproduced/index.html (minutes; goes on where it stopped)
reproduce: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[video]"
	$(ENVIRONMENT) $(BIN)/wbmpc reproduce $(REPRODUCE_ARGS)

# README's figures (between their marks) and clip from a site of reproduced runs, which is completed first;
# README_ARGS="--only swerve-track --only rezero-steps"
readme: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[video]"
	$(ENVIRONMENT) $(BIN)/wbmpc reproduce $(README_ARGS)
	$(BIN)/python scripts/readme.py

# how late the 400 Hz loop is with and without a browser on its view
lateness: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[viz]"
	$(ENVIRONMENT) $(BIN)/python benchmarks/view_lateness.py $(LATENESS_ARGS)

# random problems of all kinds of constraints, ours and IPOPT's answers (minutes)
random: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/python benchmarks/random_problems.py --seeds 1000-1599

# error and time of the swerve robot's MPC over grids of the horizon (minutes)
grids: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/python benchmarks/grids.py

# hard limits in closed loop, five variants of the solver (half an hour; goes on where it was interrupted)
limits: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/hard_limits.py $(LIMITS_ARGS)

# the swerve robot under loads, on a slope, with other delays (hours; goes on where it stopped; ROBUSTNESS_ARGS="--seeds 200-201")
robustness: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/robustness.py $(ROBUSTNESS_ARGS)

# the ball robot on other floors, with masses in its hand, over cables, with late drives (hours; goes on where it stopped)
ball-robustness: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/robustness.py --out runs/ball-robustness --only \
	  rezero-steps rezero-push-hand rezero-push-ball rezero-wholebody rezero-circle rezero-door $(ROBUSTNESS_ARGS)

# the ball robot's experiments over the reporting seeds as the protocol has them (hours; goes on where it stopped)
ball: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/robustness.py --conditions protocol --out runs/ball --only \
	  rezero-steps rezero-push-ball rezero-push-hand rezero-wholebody rezero-taskspace rezero-circle rezero-door \
	  rezero-frequency $(BALL_ARGS)

# gains of the ball robot's rivals by one search on tuning seeds, then all controllers on reporting seeds (hours; goes on);
# `make regulators`: those of the regulators of the push map, on the model and then in simulation
regulators: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/regulator_search.py --file runs/regulators.jsonl $(REGULATORS_ARGS)

ball-rivals: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rezero_rivals.py --search all --file runs/ball-rivals.jsonl
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rezero_rivals.py --file runs/ball-rivals.jsonl $(RIVALS_ARGS)

# the swerve experiments and their variants over the reporting seeds, against their goals: runs/swerve/goals.md (hours; goes on
# where it stopped; SWERVE_ARGS="--seeds 200-204")
swerve: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/robustness.py --out runs/swerve --conditions protocol vertical peaks \
	  "radii of each wheel" "calibrated arm" "odometry only" "ten minutes" --only swerve-track swerve-unified swerve-drive \
	  swerve-fixed swerve-plaster swerve-brakes swerve-wobble swerve-stability swerve-calibrate $(SWERVE_ARGS)

# gains of the rivals without MPC: a search on tuning seeds (an hour)
rivals: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rivals.py --rival ik $(RIVALS_ARGS)
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rivals.py --rival four_wheel $(RIVALS_ARGS)
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rivals.py --rival tour $(RIVALS_ARGS)

# the ball robot's door with and without its equation, estimated impedance and friction cone (an hour; goes on where it stopped)
door: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/door_table.py $(DOOR_ARGS)

# the ball robot's push map: impulses from which it recovers, 16 directions, 4 lengths (hours; goes on where it stopped)
push-map: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/push_map.py $(PUSH_MAP_ARGS)

# the MPC's rate, 80 to 1000 Hz: push recovery and hand error of the ball robot (minutes; goes on where it stopped)
rates: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/rates.py $(RATES_ARGS)

# the weight of the hand's twist, 0.1 to 100 times the default: rise time, steady error, tilt (minutes; goes on where it stopped)
twist: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/twist.py $(TWIST_ARGS)

# torque tracking of elastic drives, plain and frequency-aware, against the hand's rise time (minutes; goes on where it stopped)
frequency: $(VENV)/.installed
	$(ENVIRONMENT) nice $(BIN)/python benchmarks/frequency.py $(FREQUENCY_ARGS)

lint: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.tested
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

pictures: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[video]"
	$(BIN)/python scripts/pictures.py
	rm -rf build/clip
	$(ENVIRONMENT) $(BIN)/wbmpc run swerve-track --set periods=1 --set rest=2 --out build/clip --quiet
	$(BIN)/wbmpc render build/clip --gif docs/images/swerve.gif --force --speed 6 --width 360 --height 200

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "wbmpc needs Python 3.11 or newer, and there is no '$(PYTHON)': install python3, or call 'make PYTHON=/path/to/python3'." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "wbmpc needs Python 3.11 or newer, and '$(PYTHON)' is $$($(PYTHON) -V 2>&1): call 'make PYTHON=/path/to/newer/python3'." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "This Python has no 'venv': install it (on Debian and Ubuntu: apt-get install python3-venv)." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "The virtual environment $(VENV) could not be made (see above)." >&2; exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.tested: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist src/*.egg-info
