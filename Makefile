# The commands of this repository. `make demo` needs nothing but Python 3.11 to 3.13; everything else it installs into .venv/.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3 python; do command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && { echo $$p; break; }; done)
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint requirements/constraints.txt
PYTEST_ARGS ?= -n 2 --dist loadfile
KERNEL_TESTS = -m "kernels and not compiled" $(shell grep -rlE "^(pytestmark = |@)pytest\.mark\.kernels" tests)

.PHONY: demo test coverage lint bench docs format clean help
.DEFAULT_GOAL := help

help:
	@echo "make demo             simulate two drives, upload them, map them, leave the dashboard running (ONCE=1: end)"
	@echo "make demo LOG=PATH    the same with a drive log of your own (GNSS=PATH: a GNSS log kept beside it; MODEL=NAME: network)"
	@echo "make demo PORT=8001   the same where the usual port is taken"
	@echo "make test             lint, type check, import contracts, migration check, tests"
	@echo "make coverage         the tests once more, and which lines none of them runs"
	@echo "make lint             the part of it that runs nothing"
	@echo "make docs             the pages of docs/ as a site, in build/site"
	@echo "make bench            benchmarks: ratios against naive twins and, where installed, peers"

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "wayloom needs Python 3.11, 3.12 or 3.13: install one, or say PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv .venv

.venv/.runtime: pyproject.toml requirements/constraints.txt | .venv/bin/python
	@echo "installing wayloom and what it needs into .venv (about a minute)"
	$(PIP) --editable .
	@touch $@

.venv/.dev: .venv/.runtime
	@echo "installing what the tests need into .venv"
	$(PIP) --editable '.[dev]'
	@touch $@

demo: .venv/.runtime
	$(BIN)/wayloom demo $(if $(LOG),--log '$(LOG)') $(if $(GNSS),--gnss '$(GNSS)') $(if $(MODEL),--model '$(MODEL)') $(if $(PORT),--port '$(PORT)') $(if $(ONCE),--once)

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m wayloom.store.migrate --check

# Tests start many processes, which read bytecode that the first one wrote, whatever the caller's shell says of writing it.
test: export PYTHONDONTWRITEBYTECODE =
# Kernels are compiled beside the checks that run nothing: else two processes of tests would compile each of them at once.
test: .venv/.dev
	$(BIN)/python -m wayloom.pipeline.kernels_ahead 2>/dev/null & compiling=$$!; $(MAKE) --no-print-directory lint || { kill $$compiling; exit 1; }; wait $$compiling || true
	$(BIN)/pytest $(PYTEST_ARGS)
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest $(KERNEL_TESTS) $(PYTEST_ARGS)

coverage: .venv/.dev
	$(BIN)/coverage run -m pytest
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run --append -m pytest $(KERNEL_TESTS)
	$(BIN)/coverage report

bench: .venv/.dev
	for name in odometry labelling stitching tiles; do echo "== $$name"; $(BIN)/python benchmarks/$$name.py || exit 1; done

docs: .venv/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "build/site/index.html"

format: .venv/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv demo-out
