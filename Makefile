# One way to do each developer task. `make demo` and `make test` need Python 3.11 or later and make, nothing else.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c

PYTHON ?= python3
JOBS ?= 2
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
export PYTHONUNBUFFERED := 1

.PHONY: help setup demo test lint format types imports pytest docs bench house build clean

help: ## list the tasks
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "  make %-8s %s\n", $$1, $$2}' Makefile

setup: .venv/.dev ## create .venv with everything a developer needs

demo: .venv/.demo ## the main job: two robots find each other, simulated and recorded; report in out/demo
	@$(BIN)/python -m agents demo --out out/demo

test: lint types imports pytest docs ## every check, as CI runs them

lint: .venv/.dev ## style: ruff's formatter and rules
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .

format: .venv/.dev ## reformat, and mend what ruff can mend
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

types: .venv/.dev ## static types: mypy, strict
	@$(BIN)/mypy

imports: .venv/.dev ## who may import whom: import-linter
	@$(BIN)/lint-imports --no-logo --cache-dir .cache/import-linter

pytest: .venv/.dev ## the tests alone; ARGS="tests/kernels -x" chooses
	@$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(ARGS)

docs: .venv/.dev ## the documentation site in out/docs; runs the notebooks, fails at a dead link or any warning
	@$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --fresh-env -d .cache/docs docs out/docs

bench: .venv/.peers ## speed beside other environments (half an hour, on an idle machine); report in out/speed
	@$(BIN)/python -m benchmarks speed --out out/speed
	@$(BIN)/python -m benchmarks profile --out out/speed

house: .venv/.dev ## sizes of the code: rooms, long files and functions, wide kernels, words; a report, not a check
	@$(BIN)/python -m benchmarks.house

build: .venv/.dev ## wheel and source archive in dist/
	@$(BIN)/hatchling build

clean: ## remove what the tasks made, .venv included
	@rm -rf .venv .cache out dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: a set-up is done again when the list of dependencies changes, not otherwise. The demo's is the smaller one.
.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or later is needed, but $(PYTHON) is " + sys.version.split()[0] + ": make PYTHON=python3.11 ...")'
	@$(PYTHON) -m venv .venv

.venv/.demo: pyproject.toml constraints.txt | .venv/bin/python
	@echo "Setting up .venv (once; a minute or two)"
	@$(PIP) install -c constraints.txt -e '.[agents,logs]'
	@touch $@

# torch comes first and alone, so that Linux gets the build without CUDA (a tenth of the size).
.venv/.dev: pyproject.toml constraints.txt | .venv/bin/python
	@echo "Setting up .venv for development (once; some minutes): torch first"
	@echo "(a warning about $(TORCH_INDEX) is harmless where pip finds torch elsewhere)"
	@$(PIP) install -c constraints.txt --no-deps --retries 1 --extra-index-url $(TORCH_INDEX) torch
	@echo "... then all else"
	@$(PIP) install -c constraints.txt -e '.[dev]'
	@touch .venv/.demo $@

.venv/.peers: .venv/.dev
	@echo "Setting up .venv with the environments to compare with (once; a minute or two)"
	@$(PIP) install -c constraints.txt -e '.[peers]'
	@touch $@
