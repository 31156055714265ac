# make study     the main job, from nothing to figures and a report in results/quick
# make demo      a simulated log with two hidden effects, diagnosed: a report in results/hidden_effect
# make test      the tests but for the longest
# make test-all  all tests
# make lint      ruff and mypy
# make docs      the documentation, in build/docs
# Everything is installed into .venv, and again only when pyproject.toml has changed.

PYTHON ?= python3
ARGS ?=
RUN := .venv/bin/python

.PHONY: study demo test test-all lint docs clean

study: .venv/installed
	$(RUN) -m study.main $(ARGS)

demo: .venv/installed
	$(RUN) examples/hidden_effect.py --html results/hidden_effect/report.html $(ARGS)

test: .venv/installed
	$(RUN) -m pytest -n auto --dist loadfile -m "not long" $(ARGS)

test-all: .venv/installed
	$(RUN) -m pytest -n auto --dist loadfile --no-loadscope-reorder $(ARGS)

lint: .venv/installed
	$(RUN) -m ruff check
	$(RUN) -m ruff format --check
	$(RUN) -m mypy

docs: .venv/installed
	$(RUN) -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "wrote build/docs/index.html"

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $(PYTHON) is older than Python 3.11; name another: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	$(PYTHON) -m venv .venv
	$(RUN) -m pip install --quiet --editable ".[dev]"
	@touch $@

clean:
	rm -rf .venv build dist .mypy_cache .pytest_cache .ruff_cache
