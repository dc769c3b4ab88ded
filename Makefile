# Everything sets itself up: the first target that runs makes .venv and installs the package into it.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
# Targets that leave this folder call Python by its whole path: with `..` in it, Python 3.14 warns in every process.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
BUILD := build/editable
FIGURES ?= figures

# Two processes on two cores: threads of BLAS beside them would spin, and small matrices take twice the time.
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1

# Without stored bytecode each process that a test starts compiles the sources again, for half a second.
unexport PYTHONDONTWRITEBYTECODE

# Random runs of `make soak`: take another first seed each time.
FIRST ?= 0
COUNT ?= 3000
# Configurations, and as many calls, of `make fuzz`.
FUZZED ?= 50000

# A copy of a checkout has the environment and the build folder of the other one, which name its paths.
MOVED := $(shell sed -n 's/^command = .* //p' $(VENV)/pyvenv.cfg 2>/dev/null | grep -vxF '$(abspath $(VENV))')
BUILT := $(shell sed -n 's/^CMAKE_HOME_DIRECTORY:INTERNAL=//p' $(BUILD)/CMakeCache.txt 2>/dev/null | grep -vxF '$(CURDIR)')
# Installing configures the build folder too.
CONFIGURE := $(if $(BUILT),$(if $(MOVED),,$(if $(wildcard $(VENV)/installed),package)))

.PHONY: moved demo test pages variants long core torch minimum newest coverage mutants soak fuzz sanitize compilers aarch64 levels cross bench explorer explorer-test site site-test kernels package packages release-checks clean

demo: kernels
	$(BIN)/coadjoint reproduce --out $(FIGURES)

# Hypothesis draws the same cases on every machine; in `make long` others each time. Numba optimizes functions less, which
# takes half the time to compile and does not change their bits, and XLA not at all; in `make long` as for users. The tests
# of a file run in one process, which compiles their functions once: half the processor time.
test: kernels
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	{ $(BIN)/mypy && $(MAKE) --no-print-directory pages; } > $(VENV)/checks.txt 2>&1 & checks=$$!; \
	NUMBA_OPT=1 XLA_FLAGS=--xla_backend_optimization_level=0 $(ONE_THREAD) \
		$(BIN)/pytest -n 2 --dist loadfile -m "not long" --hypothesis-profile=ci; tests=$$?; \
	wait $$checks || tests=1; cat $(VENV)/checks.txt; exit $$tests

# Every page of the site is read, with warnings such as links that lead nowhere as errors, and none is written; pictures
# are not drawn.
SPHINX := $(BIN)/sphinx-build --quiet --fail-on-warning --keep-going

pages: kernels
	$(ONE_THREAD) $(BIN)/python docs/site/write_sources.py --blank build/pages
	$(SPHINX) --builder dummy --doctree-dir build/pages-doctrees build/pages build/pages-none

# More seeds, schemes and compilers than `make test` has time for, in about an hour. A process takes over tests of the
# other one when it has none left, since some files take half an hour.
long: kernels
	$(ONE_THREAD) $(BIN)/pytest -n 2 --dist worksteal -m long

# The sensitive tests again, and digests of runs, as on machines with other instructions, and on one that is busy.
variants: kernels
	cd tests && $(ONE_THREAD) "$(CURDIR)/$(BIN)/python" variants.py

# What the package promises without its extras, installed into a virtual environment that has nothing else.
core:
	rm -rf build/core
	$(PYTHON) -m venv build/core
	build/core/bin/python -m pip install --quiet --disable-pip-version-check . pytest
	cd tests && "$(CURDIR)/build/core/bin/python" -m pytest internal/project/test_core_alone.py

# The functions of PyTorch, which `make test` does not install, in a virtual environment of their own.
torch:
	rm -rf build/torch
	$(PYTHON) -m venv build/torch
	build/torch/bin/python -m pip install --quiet --disable-pip-version-check ".[jax]" pytest torch==2.13.0
	cd tests && "$(CURDIR)/build/torch/bin/python" -m pytest public/derivatives/test_torch*.py

# What depends most on other packages, with the lowest versions that pyproject.toml permits, and with the newest, also
# those that are not yet released.
DEPENDENT := internal/project/test_core_alone.py public/command/test_typical_session.py public/command/test_command.py \
	public/archives public/files public/pictures public/algebras public/runs/test_integrate.py \
	public/runs/test_functions_in_python.py public/derivatives/test_jax.py public/derivatives/test_xla.py
EXTRAS := all,jax

minimum: VERSIONS := --constraint tests/minimum_versions.txt
newest: VERSIONS := --upgrade --pre
minimum newest:
	rm -rf build/$@
	$(PYTHON) -m venv build/$@
	build/$@/bin/python -m pip install --quiet --disable-pip-version-check ".[$(EXTRAS)]" pytest hypothesis jsonschema $(VERSIONS)
	cd tests && $(ONE_THREAD) "$(CURDIR)/build/$@/bin/python" -m pytest -m "not long" $(DEPENDENT)

# Which tests cover which lines and branches, in build/coverage: for `make mutants`, and a report.
coverage: kernels
	mkdir -p build/coverage
	$(ONE_THREAD) $(BIN)/pytest -n 2 --dist loadfile -m "not long" --hypothesis-profile=ci --cov --cov-context=test --cov-report=
	$(BIN)/coverage report --sort=miss --skip-covered | tail -n 40

build/coverage/tests:
	$(MAKE) coverage

# Draws N defects in FILES (patterns of paths from src/coadjoint), plants one after the other in a copy, runs the tests
# that cover it, and prints those that no test notices; with LISTED=tests/mutants/standing.txt those of a list. Defects
# in C++ are tested by the tests of the kernels.
FILES ?= *.py
N ?= 100
SEED ?= 0

mutants: kernels build/coverage/tests
	cd tests && "$(CURDIR)/$(BIN)/python" -m mutants.plant $(foreach file,$(FILES),'$(file)') --count $(N) \
		--seed $(SEED) $(if $(LISTED),--listed "$(abspath $(LISTED))")

# Random systems, schemes and ensembles: the same bits in any company, and an end to every run. Then runs with archives
# are killed at random moments, 100 times or COUNT / 10 times, whichever is more, and workers 12 or COUNT / 100 times.
soak: kernels
	cd tests && "$(CURDIR)/$(BIN)/python" -m matrix.soak $(FIRST) $(COUNT) --jobs 2
	cd tests && "$(CURDIR)/$(BIN)/python" public/archives/killed_runs.py $(FIRST) $$(( $(COUNT) > 1000 ? $(COUNT) / 10 : 100 ))
	cd tests && "$(CURDIR)/$(BIN)/python" public/ensembles/killed_workers.py $(FIRST) $$(( $(COUNT) > 1200 ? $(COUNT) / 100 : 12 ))

# Configurations and calls with wild values: a result or one sentence for each, however many.
fuzz: kernels
	cd tests && "$(CURDIR)/$(BIN)/python" -m fuzz.run configurations $(FIRST) $(FUZZED) --jobs 2
	cd tests && "$(CURDIR)/$(BIN)/python" -m fuzz.run calls $(FIRST) $(FUZZED) --jobs 2

# The kernels built to find their own faults, under tests and random runs.
sanitize: kernels
	cd tests && "$(CURDIR)/$(BIN)/python" sanitize.py address
	cd tests && "$(CURDIR)/$(BIN)/python" sanitize.py threads

# The same bits by GCC and by Clang, with and without fused products; `make long` builds one of the four.
compilers: kernels
	COADJOINT_COMPILERS=all $(BIN)/pytest tests/internal/builds/test_compilers.py

# The same bits on aarch64, under emulation; what is missing for that is named.
aarch64: kernels
	cd tests && "$(CURDIR)/$(BIN)/python" aarch64.py ../build/aarch64

# Each level of x86-64 is chosen where it is the highest, with the same bits, on processors that qemu emulates.
levels: export COADJOINT_LEVELS = all
levels: kernels
	cd tests && $(ONE_THREAD) "$(CURDIR)/$(BIN)/python" levels.py

# The libraries of every wheel, compiled and linked by zig's Clang for Linux, macOS and Windows: quickly, or with
# CROSS_OPTIONS= as for a release. TARGETS names some of the systems. Exported C is compiled for a Cortex-M4 and for
# WebAssembly, and runs there if qemu and node are installed.
CROSS := build/cross

cross: kernels $(CROSS)/venv/installed
	$(CROSS)/venv/bin/python packaging/cross/build.py $(CROSS) $(TARGETS)
	$(BIN)/python -m pytest -q tests/public/exports -k "microcontroller or webassembly"

$(CROSS)/venv/installed:
	$(PYTHON) -m venv $(CROSS)/venv
	$(CROSS)/venv/bin/python -m pip install --quiet --disable-pip-version-check cmake ninja lief ziglang
	@touch $@

bench: kernels $(VENV)/peers
	$(BIN)/python benchmarks/run_all.py

# The explorer in build/explorer/site: the kernels in WebAssembly, their tables, and the page. It needs emcc, of
# Emscripten, and npm, of Node.js 20 or newer.
EMCC := $(shell command -v emcc)
NPM := $(shell command -v npm)
EXPLORER := build/explorer
WITH_EXPLORER := $(if $(EMCC),$(if $(NPM),$(EXPLORER)/site))

explorer: kernels $(EXPLORER)/public/kernels.wasm explorer/node_modules/.package-lock.json
	$(ONE_THREAD) $(BIN)/python docs/write_explorer.py $(EXPLORER)/public
	npm --prefix explorer run --silent build

$(EXPLORER)/public/kernels.wasm: $(wildcard explorer/wasm/*) $(wildcard src/coadjoint/kernels/source/*/*) \
		src/coadjoint/methods/taylor.cpp src/coadjoint/methods/isospectral_gauss.cpp
	explorer/wasm/build.sh $(EXPLORER)

explorer/node_modules/.package-lock.json: explorer/package-lock.json
	npm --prefix explorer ci --silent
	@touch $@

# Its numbers in Node.js and in a browser, beside those of the library.
explorer-test: explorer $(VENV)/browser
	$(ONE_THREAD) $(BIN)/python tests/browsed/explorer_runs.py $(EXPLORER)/runs.json
	npm --prefix explorer run --silent check
	npm --prefix explorer run --silent test
	$(ONE_THREAD) $(BIN)/python tests/browsed/explorer.py $(EXPLORER)/site

# The documentation in build/site: pages, reference, and pictures that are drawn now. Without emcc or npm the explorer is
# left out, and nothing links to it.
site: kernels $(if $(WITH_EXPLORER),explorer)
	$(if $(WITH_EXPLORER),,@echo "the site is built without the explorer: it needs emcc and npm")
	$(ONE_THREAD) $(BIN)/python docs/site/write_sources.py $(WITH_EXPLORER:%=--explorer %) build/site-sources
	$(SPHINX) --jobs 2 --doctree-dir build/site-doctrees build/site-sources build/site

# The pages as a browser shows them: needs Chromium or Chrome, found by its usual names or CHROMIUM=/path/to/it. Then the
# notebooks, each in a kernel, which takes some minutes.
site-test: site $(VENV)/browser $(if $(WITH_EXPLORER),explorer-test)
	$(BIN)/python tests/browsed/site.py build/site
	$(ONE_THREAD) $(BIN)/python tests/browsed/notebooks.py build/site

$(VENV)/browser: tests/browsed/requirements.txt $(VENV)/installed
	$(PIP) --requirement tests/browsed/requirements.txt
	@touch $@

# With the tools of the build beside the package, so that it can be built again without looking for them. What it needs
# is loaded while the kernels are compiled.
NEEDED := import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	extras = project["optional-dependencies"]; \
	print(*project["dependencies"], *(one for name in extras if not name.startswith(("bench", "torch")) \
	for one in extras[name] if not one.startswith("coadjoint[")), sep="\n")

$(VENV)/installed: pyproject.toml $(if $(MOVED),moved)
	@test -n "$(PYTHON)" || { echo "coadjoint needs Python 3.11 or newer: set PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) cmake ninja scikit-build-core
	@$(MAKE) --no-print-directory --jobs=2 package packages
	@touch $@

moved:
	@echo "$(VENV) was made for $(MOVED): it is made again"
	rm -rf $(VENV)

package:
	$(PIP) --no-build-isolation --no-deps --editable .

packages:
	@$(BIN)/python -c '$(NEEDED)' > $(VENV)/needed.txt
	$(PIP) --requirement $(VENV)/needed.txt

# Compiles what has changed. COADJOINT_LEVELS=all builds for every level of x86-64.
kernels: $(VENV)/installed
	$(if $(CONFIGURE),@echo "$(BUILD) was made for $(BUILT): it is configured again"; $(MAKE) --no-print-directory package)
	$(if $(COADJOINT_LEVELS),$(BIN)/cmake -DCOADJOINT_LEVELS="$(COADJOINT_LEVELS)" $(BUILD))
	@$(BIN)/cmake --build $(BUILD)

# The integrators that coadjoint is measured beside.
$(VENV)/peers: $(VENV)/installed
	$(PIP) --no-build-isolation --editable '.[bench]'
	@touch $@

# Metadata, citation, workflows and source distribution, by tools in a virtual environment of their own. Then the source
# distribution is built and installed from a folder of packages, without an index. Once the tools and the packages are
# there, nothing is downloaded.
RELEASE := build/release
REQUIRED := import tomllib; found = tomllib.load(open("pyproject.toml", "rb")); \
	print(*found["build-system"]["requires"], *found["project"]["dependencies"], "cmake", "ninja", sep="\n")
FRESH := PIP_NO_INDEX=1 PIP_FIND_LINKS="$(CURDIR)/$(RELEASE)/packages" $(RELEASE)/fresh/bin/python -m pip --quiet \
	--disable-pip-version-check --no-cache-dir
TRIED := import coadjoint as co; body = co.systems.rigid_body((1, 2, 3)); \
	sol = co.integrate(body, (1.0, 0.2, 0.1), (0, 1), 0.1); \
	print("installed without an index, one run:", sol.x[-1])

release-checks: $(RELEASE)/installed
	$(RELEASE)/bin/validate-pyproject pyproject.toml
	$(RELEASE)/bin/repo-review .
	$(RELEASE)/bin/cffconvert --validate
	$(RELEASE)/bin/zizmor --offline --pedantic .github
	PATH="$(CURDIR)/$(RELEASE)/bin:$$PATH" $(RELEASE)/bin/check-sdist --no-isolation
	rm -rf build/dist
	PATH="$(CURDIR)/$(RELEASE)/bin:$$PATH" $(RELEASE)/bin/python -m build --no-isolation --sdist --outdir build/dist
	rm -rf $(RELEASE)/fresh
	$(PYTHON) -m venv $(RELEASE)/fresh
	$(FRESH) wheel --no-deps --wheel-dir build/dist build/dist/coadjoint-*.tar.gz
	$(FRESH) install build/dist/coadjoint-*.whl
	cd $(RELEASE) && fresh/bin/python -c '$(TRIED)'
	$(RELEASE)/bin/twine check --strict build/dist/*

$(RELEASE)/installed: pyproject.toml
	$(PYTHON) -m venv $(RELEASE)
	$(PYTHON) -c '$(REQUIRED)' > $(RELEASE)/requires.txt
	$(RELEASE)/bin/python -m pip download --quiet --disable-pip-version-check -r $(RELEASE)/requires.txt \
		--dest $(RELEASE)/packages
	$(RELEASE)/bin/python -m pip install --quiet --disable-pip-version-check -r $(RELEASE)/requires.txt \
		build check-sdist cffconvert 'repo-review[cli]' sp-repo-review twine 'validate-pyproject[all]' zizmor
	@touch $@

clean:
	rm -rf $(VENV) $(FIGURES) build explorer/node_modules src/coadjoint/kernels/*.so src/coadjoint/kernels/*.dylib
