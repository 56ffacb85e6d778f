# Everything a person or a CI job types. Each target sets a fresh machine up by itself.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: help setup demo test check paper bench safety soak wires clean

help:
	@echo "make setup   environment in $(VENV) with every extra, system libraries where it may"
	@echo "make demo    scan a vase on a simulated station and reconstruct it; look at demo-out/report.html"
	@echo "make test    all tests"
	@echo "make check   ruff, format, mypy, import contracts"
	@echo "make paper   reproduce the paper's figures into docs/paper/"
	@echo "make bench   tables of speed, beside the peers"
	@echo "make soak    work a simulated station over bad wires for two of its hours (six minutes); nothing may grow or hang"
	@echo "make wires   ten thousand questions in every protocol over bad ptys and TCP connections (an hour)"
	@echo "make safety  end programs in every way at random instants; how long laser and axes took (an hour)"

setup: $(READY)

$(READY): pyproject.toml tools/setup.sh
	PYTHON="$(PYTHON)" VENV="$(VENV)" sh tools/setup.sh
	@touch $@

demo: setup
	$(BIN)/loftscan demo --out demo-out --overwrite

test: setup
	$(BIN)/python -m pytest -q -n auto

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

paper: setup
	$(BIN)/python docs/paper/reproduce.py

bench: setup
	$(BIN)/pip install --quiet --group bench || echo "open3d-cpu is not available here: its columns stay empty"
	for each in benchmarks/*.py; do echo "== $$each"; $(BIN)/python $$each || exit 1; done

safety: setup
	$(BIN)/python -m tests.campaigns.stopping

soak: setup
	$(BIN)/python -m tests.campaigns.soak

wires: setup
	$(BIN)/python -m tests.campaigns.questions

clean:
	rm -rf $(VENV) demo-out demo-out.scan build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
