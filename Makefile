# Everything a person types here explains itself: make help
.DEFAULT_GOAL := help
.PHONY: help setup run test chaos check format bench bench-search fuzz-api clean

PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.ready

help:  ## show this list
	@awk -F':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(STAMP): pyproject.toml constraints.txt dashboards/package-lock.json
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt pip setuptools
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	$(BIN)/python -m dashboards.vendor
	@touch $(STAMP)

setup: $(STAMP)  ## make .venv with everything pinned (constraints.txt)

run: $(STAMP)  ## the main job: search for different ways to jump over a bar, then show what was found
	$(BIN)/halma run studies/quickstart.yaml

# Rooms whose tests start whole services and browsers have both cores to themselves.
ALONE := tests/chaos tests/dashboards tests/end_to_end

test: $(STAMP)  ## all tests
	$(BIN)/pytest --numprocesses 2 --dist loadfile $(addprefix --ignore=,$(ALONE)) tests
	$(BIN)/pytest $(ALONE)

chaos: $(STAMP)  ## break studies more than 500 times, and print what came of it (options in CHAOS=...; needs root)
	PYTHONPATH=tests:. $(BIN)/python tests/chaos/campaign.py $(or $(CHAOS),run)

check: $(STAMP)  ## lint, format, types, import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)  ## put the code in the house's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(STAMP)  ## the quick benchmarks, each figure beside its baseline
	$(BIN)/python benchmarks/storage.py
	$(BIN)/python benchmarks/simulation.py

bench-search: $(STAMP)  ## the searches against their controls, quick version (minutes)
	$(BIN)/python -m benchmarks.search.diversity --quick
	$(BIN)/python -m benchmarks.search.quality --quick
	$(BIN)/python -m benchmarks.search.speed --quick

fuzz-api: $(STAMP)  ## thousands of generated requests against the API's own description
	$(BIN)/python benchmarks/fuzz_api.py --requests 6000

clean:  ## forget the environment and caches (never the trial database)
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .import_linter_cache build *.egg-info
