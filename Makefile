# Everything sets itself up: the first target that runs makes .venv and installs the package into it.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
FIGURES ?= figures

# Random runs of `make soak`: take another first seed each time.
FIRST ?= 0
COUNT ?= 3000

.PHONY: demo test core mutants soak sanitize bench release-checks clean

demo: $(VENV)/installed
	$(BIN)/coadjoint reproduce --out $(FIGURES)

test: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n 2

# What the package promises without its extras, installed into a virtual environment that has nothing else.
core:
	rm -rf build/core
	$(PYTHON) -m venv build/core
	build/core/bin/python -m pip install --quiet --disable-pip-version-check . pytest
	cd tests && ../build/core/bin/python -m pytest test_core_alone.py

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

# Metadata, citation, workflows, source distribution and wheel, by tools in a virtual environment of their own. Once that
# is there, nothing is downloaded.
RELEASE := build/release
REQUIRED := import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")

release-checks: $(RELEASE)/installed
	$(RELEASE)/bin/validate-pyproject pyproject.toml
	$(RELEASE)/bin/repo-review .
	$(RELEASE)/bin/cffconvert --validate
	$(RELEASE)/bin/zizmor --offline --pedantic .github
	PATH="$(CURDIR)/$(RELEASE)/bin:$$PATH" $(RELEASE)/bin/check-sdist --no-isolation
	rm -rf build/dist
	PATH="$(CURDIR)/$(RELEASE)/bin:$$PATH" $(RELEASE)/bin/python -m build --no-isolation --outdir build/dist
	$(RELEASE)/bin/twine check --strict build/dist/*

$(RELEASE)/installed: pyproject.toml
	$(PYTHON) -m venv $(RELEASE)
	$(PYTHON) -c '$(REQUIRED)' > $(RELEASE)/requires.txt
	$(RELEASE)/bin/python -m pip install --quiet --disable-pip-version-check -r $(RELEASE)/requires.txt cmake ninja \
		build check-sdist cffconvert 'repo-review[cli]' sp-repo-review twine 'validate-pyproject[all]' zizmor
	@touch $@

clean:
	rm -rf $(VENV) $(FIGURES)
