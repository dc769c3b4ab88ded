# Everything sets itself up: the first target that runs makes .venv and installs the package into it.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
FIGURES ?= figures

# Random runs of `make soak`: take another first seed each time.
FIRST ?= 0
COUNT ?= 3000

.PHONY: demo test mutants soak sanitize bench clean

demo: $(VENV)/installed
	$(BIN)/coadjoint reproduce --out $(FIGURES)

test: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n 2

# Plants the defects of tests/mutants one after the other, in a copy, and prints those that no test notices.
mutants: $(VENV)/installed
	$(BIN)/python tests/mutants/plant.py $(MUTANTS)

# Random systems, schemes and crowds: the same bits in any company, and an end to every run.
soak: $(VENV)/installed
	cd tests && ../$(BIN)/python -m random_runs.soak $(FIRST) $(COUNT) --jobs 2

# The kernels built to find their own faults, under tests and random runs.
sanitize: $(VENV)/installed
	cd tests && ../$(BIN)/python sanitize.py address
	cd tests && ../$(BIN)/python sanitize.py threads

bench: $(VENV)/peers
	$(BIN)/python benchmarks/run_all.py

$(VENV)/installed: pyproject.toml setup.py $(wildcard src/coadjoint/kernels/source/*/* src/coadjoint/methods/*.cpp)
	@test -n "$(PYTHON)" || { echo "coadjoint needs Python 3.11 or newer: set PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

# The integrators that coadjoint is measured beside.
$(VENV)/peers: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	@touch $@

clean:
	rm -rf $(VENV) $(FIGURES)
