.PHONY: race test test-all check setup clean
SHELL := /bin/bash
RIG := .venv/bin/rig

race: .venv/.base  ## race the learned controller against Shin's on the simulated pair
	@$(RIG) race ours shin

test: .venv/.dev  ## the tests that CI runs
	@.venv/bin/python -m pytest -m "not heavy and not hardware"

test-all: .venv/.dev  ## every test that needs no camera, minutes-long ones included
	@.venv/bin/python -m pytest -m "not hardware"

check: .venv/.dev  ## lint, format, types, layers
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@.venv/bin/mypy
	@.venv/bin/lint-imports

setup: .venv/.base

.venv/.base: pyproject.toml constraints.txt tools/setup.sh
	@tools/setup.sh base

.venv/.dev: .venv/.base
	@tools/setup.sh dev

clean:
	rm -rf .venv build dist *.egg-info
