# Two targets do everything on a fresh Debian machine with Python 3.11 or newer: `make demo` and `make test`.
PYTHON ?= python3
# Pins for Python 3.11; pyproject.toml has the ranges that should work. constraints-newest.txt has the
# newest releases on Python 3.13, without PyTorch: make demo PYTHON=python3.13 CONSTRAINTS=constraints-newest.txt
CONSTRAINTS ?= constraints.txt
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile --constraint $(CONSTRAINTS)

.PHONY: demo test robustness lint types docs reference check clean

demo: .venv/demo.stamp
	$(BIN)/skygain survey --city sample:9 --out surveys/demo --overwrite
	@echo "Open surveys/demo/report.html in a browser."
	@if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then $(BIN)/python -m webbrowser -t "file://$(CURDIR)/surveys/demo/report.html"; fi

test: .venv/test.stamp
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal

# A hundred kills of each command, a hundred thousand damaged files, full disks: prints the totals.
robustness: .venv/test.stamp
	SKYGAIN_TRIALS=100 $(BIN)/python -m pytest -n 2 tests/robustness

lint: .venv/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/test.stamp
	$(BIN)/mypy

docs: .venv/test.stamp
	$(BIN)/python docs/check.py
	$(BIN)/python benchmarks/document_tables.py --check

# The API reference out of the docstrings, in reference/.
reference: .venv/docs.stamp
	$(BIN)/python docs/reference.py reference

check: test lint types docs

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("Skygain needs Python 3.11 or newer, found " + sys.version) if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv .venv || { echo "the venv module is missing: apt-get install python3-venv"; rm -rf .venv; exit 1; }

.venv/demo.stamp: .venv/bin/python pyproject.toml $(CONSTRAINTS) packages/install.py
	$(BIN)/python packages/install.py $(CONSTRAINTS)
	@touch $@

.venv/test.stamp: .venv/demo.stamp
	$(PIP) --editable '.[dev]'
	@touch $@

.venv/docs.stamp: .venv/demo.stamp
	$(PIP) --editable '.[docs]'
	@touch $@

clean:
	rm -rf .venv surveys maps reference
