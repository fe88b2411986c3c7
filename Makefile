# One way to do each developer task. `make demo` and `make test` need Python 3.11 or later and make, nothing else.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c

PYTHON ?= python3
JOBS ?= 2
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
# Packages come from where pip is told, in its own configuration; torch from one more index, if this names one.
TORCH_INDEX ?=
# Pythons that `make test-minimum` tries; those that are not there are left out.
PYTHONS ?= python3.11 python3.12 python3.13 $(wildcard $(HOME)/.pyenv/versions/3.1[1-9]*/bin/python)
# What they run: tests of the core, of drawing and of agents, without those that take long or need other extras.
MINIMUM_TESTS ?= tests/kernels tests/envs tests/rendering tests/agents/test_policies.py tests/agents/test_report.py \
	$(filter-out %_docs.py %_extras.py %_folders.py %_package.py %_paper.py,$(wildcard tests/test_*.py)) \
	$(patsubst %,--ignore=tests/%,kernels/test_image_rendering.py envs/test_image_observation.py envs/test_picture.py)
export PYTHONUNBUFFERED := 1
# Recorded data for the demonstration and the tests.
ifneq ($(wildcard ../shared/data),)
export RELLOC_DATA ?= $(abspath ../shared/data)
endif

.PHONY: help setup demo test lint format types imports pytest docs test-minimum bench house build clean

help: ## list the tasks
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-12s %s\n", $$1, $$2}' Makefile

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

test-minimum: ## fast tests with the lowest versions of core, render and agents, on each Python here (minutes each)
	@mkdir -p .cache/minimum
	@$(PYTHON) .ci/lowest.py render agents > .cache/minimum/lowest.txt
	@done=" "; for python in $(PYTHONS); do \
		version=$$($$python -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2> /dev/null) || continue; \
		[[ $$done == *" $$version "* ]] && continue; done+="$$version "; folder=.cache/minimum/$$version; \
		echo "Python $$version: the lowest versions"; \
		$$python -m venv --clear $$folder; \
		$$folder/bin/python -m pip --disable-pip-version-check -qq install \
			-c .cache/minimum/lowest.txt -e '.[render,agents]' pytest hypothesis; \
		NUMBA_CACHE_DIR=$$folder/kernels $$folder/bin/python -m pytest -q \
			-W ignore::DeprecationWarning -W ignore::PendingDeprecationWarning $(MINIMUM_TESTS); \
	done; [[ $$done != " " ]]

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

# torch comes first and alone: where an index of builds without CUDA is at hand, its build is a tenth of the size.
.venv/.dev: pyproject.toml constraints.txt | .venv/bin/python
	@echo "Setting up .venv for development (once; some minutes): torch first"
	@$(PIP) install -c constraints.txt --no-deps $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) torch
	@echo "... then all else"
	@$(PIP) install -c constraints.txt -e '.[dev]'
	@touch .venv/.demo $@

.venv/.peers: .venv/.dev
	@echo "Setting up .venv with the environments to compare with (once; a minute or two)"
	@$(PIP) install -c constraints.txt -e '.[peers]'
	@touch $@
