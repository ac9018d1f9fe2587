# make demo   sets up everything and runs the two main experiments
# make test   sets up everything and runs the tests
# make docs   builds the documentation: docs/_build/html/index.html
# Measurements are commands of their own: benchmarks/README.md.
PYTHON ?= python3
VENV ?= .venv
# test processes
PYTEST_WORKERS ?= 2
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable
ENVIRONMENT := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
.PHONY: setup demo test fast lint docs bench clean

setup: $(VENV)/.installed

demo: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/wbmpc demo

# side by side, then those by the wall clock, then once more and alone what failed; AFTER_FAST=1 leaves out what "make fast" has run
test: $(VENV)/.tested
	@$(ENVIRONMENT) $(BIN)/python scripts/suite.py --workers $(PYTEST_WORKERS) $(PYTEST_ARGS) $(if $(AFTER_FAST),$(addprefix --ignore=,$(FAST_TESTS)))

# a minute of tests that need no long run: what breaks often
FAST_TESTS := tests/test_layering.py tests/test_no_base_names.py tests/test_lie.py tests/test_configuration.py tests/ocp \
	tests/kernel/test_cache_owner.py tests/solver/test_line_search.py tests/mpc/test_policy_limits.py
fast: $(VENV)/.tested
	$(ENVIRONMENT) $(BIN)/python -m pytest -x -n $(PYTEST_WORKERS) -m "not wallclock" $(FAST_TESTS)

lint: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# tutorials are executed, warnings are errors; the pages open from file://
docs: $(VENV)/.installed
	$(PIP) '.[docs]'
	$(ENVIRONMENT) $(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html $(DOCS_ARGS)

# the solver against IPOPT and Fatrop, then 100 000 solves: memory and drift
bench: $(VENV)/.installed
	$(ENVIRONMENT) $(BIN)/wbmpc bench
	$(ENVIRONMENT) $(BIN)/python benchmarks/soak.py

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist docs/_build src/*.egg-info

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "wbmpc needs Python 3.11 or newer, and there is no '$(PYTHON)': install python3, or call 'make PYTHON=/path/to/python3'." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "wbmpc needs Python 3.11 or newer, and '$(PYTHON)' is $$($(PYTHON) -V 2>&1): call 'make PYTHON=/path/to/newer/python3'." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "This Python has no 'venv': install it (on Debian and Ubuntu: apt-get install python3-venv)." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "The virtual environment $(VENV) could not be made (see above)." >&2; exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(PIP) .
	@touch $@

$(VENV)/.tested: pyproject.toml | $(VENV)/bin/python
	$(PIP) '.[test]'
	@touch $@ $(VENV)/.installed
