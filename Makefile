# One command each. `make setup` needs Python >= 3.11, make and a package index; everything else it installs into .venv.
PYTHON ?= python3
BIN := .venv/bin
WORKERS ?= 2
# files of others that some tests read: tests/outside_files.py
TILTCAL_TEST_FILES ?= $(abspath $(wildcard ../shared))
export TILTCAL_TEST_FILES
# of linear algebra, in each process
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-long check bench docs lock clean

help:  ## show what each target does
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: .venv/.ready  ## create .venv with the pinned, hash-checked dependencies and the tiltcal command

.venv/.ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; v = sys.version_info; v >= (3, 11) or sys.exit("make setup: found Python %d.%d, need 3.11 or newer; call make PYTHON=python3.12 setup" % v[:2])'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	$(BIN)/python -m compileall -q tiltcal sim  # once, not at each command where nothing may be written
	@touch $@

demo: setup  ## simulate, calibrate and verify on built-in scenarios; prints a table and the report's path
	@$(BIN)/tiltcal demo --progress -o demo-output

test: setup  ## the test suite, without what is marked long
	@$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal tests

test-long: setup  ## before a release: statistics at length, and every benchmark at its smallest size; prints the time of each
	@$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m long --durations=0 --durations-min=1 tests

check: setup  ## format, lint, types, import contract, ids of effects, docstrings, limits of the source
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.checks.effect_ids
	$(BIN)/python -m tests.checks.docstrings
	$(BIN)/python -m tests.checks.structure

bench: setup  ## accuracy, speed and memory figures (never part of the tests)
	@$(ONE_THREAD) $(BIN)/python -m tests.benchmarks

docs: setup  ## the site, into site/
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "documentation: site/index.html"

lock:  ## renew requirements.lock (needs uv)
	uv pip compile pyproject.toml --all-extras --group dev --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --no-annotate -o requirements.lock

clean:
	rm -rf .venv build dist site .docs_cache demo-output .pytest_cache .mypy_cache .ruff_cache .hypothesis
