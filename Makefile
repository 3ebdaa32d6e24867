# SPDX-License-Identifier: Apache-2.0
# make train   set up, then train a cart-pole on whatever device there is
# make test    set up, then run the tests
# make docs    set up, then build the docs site in site/; a warning is an error
#
# Variables: PYTHON (interpreter to build the environment from), VENV (where), TORCH (which torch; one that is already
# in VENV is kept), TORCH_INDEX (extra package index for torch; by default the CPU builds where there is no NVIDIA GPU),
# TASK and ARGS (of make train), PYTEST_ARGS (of make test).

PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python3.10; do \
	$$p -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && echo $$p && break; done)
VENV ?= .venv
TORCH ?= torch==2.13.0
TORCH_CPU_INDEX = https://download.pytorch.org/whl/cpu
PYTEST_ARGS ?= --numprocesses 2 --dist loadfile
TASK ?= Stripe-Cartpole-Direct-v0
BIN = $(VENV)/bin
PIP = $(BIN)/python -m pip --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help train test docs lint format clean-venv

help:
	@sed -n '2,8s/^# \{0,1\}//p' Makefile

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "stripe-newton needs Python 3.10 to 3.13, and none was found. Install one, or name it:" \
		"make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "$(PYTHON) -m venv failed: on Debian and Ubuntu install" \
		"the package python3-venv"; exit 1; }

# torch first, for the choice of its build: the ones for NVIDIA GPUs are gigabytes that a CPU cannot use.
$(VENV)/.torch: | $(BIN)/python
	@$(BIN)/python -c 'import importlib.metadata as m; print("torch", m.version("torch"), "is there already")' 2>/dev/null \
	|| { index="$(TORCH_INDEX)"; \
		if [ -z "$$index" ] && [ "$$(uname -s)" = Linux ] && ! nvidia-smi >/dev/null 2>&1 \
			&& $(BIN)/python -c 'import urllib.request as u; u.urlopen("$(TORCH_CPU_INDEX)/", timeout=5)' 2>/dev/null; \
		then index="$(TORCH_CPU_INDEX)"; fi; \
		set -x; $(PIP) install "$(TORCH)" $${index:+--extra-index-url "$$index"}; }
	@touch $@

$(VENV)/.base: pyproject.toml | $(VENV)/.torch
	$(PIP) install -e .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/.torch
	$(PIP) install -e ".[dev]"
	$(PIP) install --no-deps "mjlab~=1.6.0"  # for its robot files alone
	@touch $@ $(VENV)/.base

train: $(VENV)/.base
	$(BIN)/stripe-newton train $(TASK) $(ARGS)

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(PYTEST_ARGS)

docs: $(VENV)/.base
	$(PIP) install -e ".[docs]"
	$(BIN)/python -m tools.documentation.site.build_site site

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean-venv:
	rm -rf $(VENV)
