# make study   the main job, from nothing to figures and a report in results/quick
# make test    the whole test suite
# make lint    ruff and mypy
# Everything is installed into .venv, and again only when pyproject.toml has changed.

PYTHON ?= python3
ARGS ?=
RUN := .venv/bin/python

.PHONY: study test lint clean

study: .venv/installed
	$(RUN) -m study.main $(ARGS)

test: .venv/installed
	$(RUN) -m pytest $(ARGS)

lint: .venv/installed
	$(RUN) -m ruff check
	$(RUN) -m ruff format --check
	$(RUN) -m mypy

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $(PYTHON) is older than Python 3.11; name another: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	$(PYTHON) -m venv .venv
	$(RUN) -m pip install --quiet --editable ".[dev]"
	@touch $@

clean:
	rm -rf .venv build dist .mypy_cache .pytest_cache .ruff_cache
