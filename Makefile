# Everything runs in .venv, made from pinned requirements by plain pip. No compiler is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ifeq ($(OS),Windows_NT)
BIN := $(VENV)/Scripts
endif

# So that the processes that tests start need not compile the sources again.
export PYTHONDONTWRITEBYTECODE :=
PYTEST := $(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --durations 20

.PHONY: demo test test-all test-slow test-extras test-soak coverage test-learn test-types test-cluster test-remote test-distributed test-peers test-napari test-solvers test-printers test-newest test-matrix mutants fuzz check docs gallery bench figures wheel sbom clean

demo: $(VENV)/base.stamp            ## the main job on an embedded sample: look into out/
	$(BIN)/trabecula demo --out out

test: $(VENV)/dev.stamp             ## the tests of minutes, by as many processes as there are cores
	$(PYTEST) -m "not (whole or slow)"

test-all: $(VENV)/dev.stamp         ## every test of the base install but the slow ones, and those of each extra
	$(PYTEST) -m "not slow"
	$(MAKE) --no-print-directory test-extras

test-slow: $(VENV)/dev.stamp $(VENV)/learn.stamp $(VENV)/cluster.stamp $(VENV)/remote.stamp   ## tests that take many seconds beside others like them: weekly, and before a release
	$(PYTEST) -m slow

test-soak: $(VENV)/dev.stamp        ## ten runs of every test in random order beside full load; hours
	$(BIN)/python tests/soak.py

coverage: $(VENV)/dev.stamp $(VENV)/learn.stamp $(VENV)/cluster.stamp $(VENV)/remote.stamp   ## branches that the tests reach: of the Python code by all, of kernels by a sample that runs them uncompiled
	$(PYTEST) --cov --cov-report=term
	$(BIN)/python tests/plain_kernels.py

test-extras: $(VENV)/dev.stamp $(VENV)/learn.stamp $(VENV)/cluster.stamp $(VENV)/remote.stamp   ## the tests of the extras, two at a time: what they need is installed before
	$(MAKE) --no-print-directory --jobs 2 test-learn test-distributed

test-distributed:                   ## test-cluster, then test-remote
	$(MAKE) --no-print-directory test-cluster
	$(MAKE) --no-print-directory test-remote

test-learn: $(VENV)/dev.stamp $(VENV)/learn.stamp   ## the tests that need PyTorch, which `make test` skips where it is not installed
	$(PYTEST) -m "not slow" tests/synth/gan tests/contract -k gan

test-types: $(VENV)/dev.stamp $(VENV)/types.stamp   ## mypy and Pyright over a user's script
	$(BIN)/python -m pytest tests/types
	$(BIN)/basedpyright --pythonpath $(BIN)/python --project tests/types/pyrightconfig.json

test-cluster: $(VENV)/dev.stamp $(VENV)/cluster.stamp   ## the tests that need Dask, which `make test` skips where it is not installed
	$(BIN)/python -m pytest -m "not slow" tests/engine/test_cluster.py

test-remote: $(VENV)/dev.stamp $(VENV)/remote.stamp   ## the tests that need an object store, an emulation of which runs meanwhile
	$(BIN)/python -m pytest -m "not slow" tests/remote tests/engine/test_storage.py

test-peers: $(VENV)/dev.stamp $(VENV)/peers.stamp   ## packages of the field take an image as an array, and are oracles: they are installed, 1.5 GB
	$(BIN)/python -m pytest tests/peers

test-napari: $(VENV)/dev.stamp $(VENV)/napari.stamp   ## the plugin of napari without a screen, and DICOM and HDF5, which `make test` skips where they are not installed
	QT_QPA_PLATFORM=offscreen $(BIN)/python -m pytest -rs tests/napari_plugin tests/io/test_readers.py

test-solvers: $(VENV)/dev.stamp     ## CalculiX and OpenFOAM solve what is exported: apt-get installs them where it may, else the tests are skipped with a reason
	@(which ccx && which simpleFoam) >/dev/null 2>&1 || apt-get install --yes --no-install-recommends calculix-ccx openfoam || echo "not installed: see the reasons of the skips"
	$(BIN)/python -m pytest -rs tests/solvers

test-printers: $(VENV)/dev.stamp    ## PrusaSlicer reads and slices what is exported: apt-get installs it where it may, else the tests are skipped with a reason
	@which prusa-slicer >/dev/null 2>&1 || apt-get install --yes --no-install-recommends prusa-slicer || echo "not installed: see the reasons of the skips"
	$(BIN)/python -m pytest -rs tests/printers

fuzz: $(VENV)/dev.stamp             ## 10,000 damaged files and 1,000 strange calls: an error of ours or a sound result; minutes
	$(BIN)/python tests/fuzz/run.py files --count 10000
	$(BIN)/python tests/fuzz/run.py arguments --count 1000

test-newest:                        ## the wheel on the newest Python at hand, with the newest dependencies that the index has: weekly, since most of what it finds comes from there
	$(PYTHON) tests/matrix/run.py --python last --dependencies newest

test-matrix:                        ## the same on every Python at hand, with the oldest and the newest; minutes each
	$(PYTHON) tests/matrix/run.py

mutants: $(VENV)/dev.stamp $(VENV)/learn.stamp   ## faults put into a copy of the package, one at a time: the tests must find 95 % of them; 15 minutes
	$(BIN)/python tests/mutants/mutate.py

check: $(VENV)/dev.stamp            ## ruff, mypy, import rules of rooms and files
	$(BIN)/ruff check src tests benchmarks docs release
	$(BIN)/ruff format --check src tests benchmarks docs release
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest tests/language/test_layers.py

docs: $(VENV)/docs.stamp            ## executes every example, builds docs/_build/html
	$(BIN)/python docs/build.py

gallery: $(VENV)/docs.stamp         ## only its pictures: docs/gallery
	$(BIN)/python docs/build.py gallery

bench: $(VENV)/dev.stamp            ## the tables; minutes
	$(BIN)/python benchmarks/run.py

figures: $(VENV)/dev.stamp          ## measures again what README and docs quote, and fails where a figure moved; minutes
	$(BIN)/python benchmarks/quoted.py

wheel: $(VENV)/dev.stamp            ## dist/*.whl
	$(BIN)/python -m pip wheel --no-deps --wheel-dir dist .

sbom: $(VENV)/release.stamp wheel   ## what the base install brings: build/release/sbom.json (CycloneDX) and licences.md
	rm -rf build/base && $(PYTHON) -m venv --without-pip build/base
	$(BIN)/python -m pip --python build/base install --quiet "$$(ls -t dist/*.whl | head -1)"
	mkdir -p build/release
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --mc-type library --output-reproducible --output-file build/release/sbom.json build/base
	$(BIN)/pip-licenses --python $(subst $(VENV),build/base,$(BIN))/python --from mixed --format markdown --output-file build/release/licences.md
	@cat build/release/licences.md

$(VENV)/base.stamp: requirements/base.txt pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --requirement requirements/base.txt
	$(BIN)/python -m pip install --quiet --no-deps --editable .
	touch $@

$(VENV)/dev.stamp: $(VENV)/base.stamp requirements/dev.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/dev.txt
	touch $@

$(VENV)/learn.stamp: $(VENV)/base.stamp requirements/learn.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/learn.txt
	touch $@

$(VENV)/types.stamp: $(VENV)/base.stamp requirements/types.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/types.txt
	touch $@

$(VENV)/cluster.stamp: $(VENV)/base.stamp requirements/cluster.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/cluster.txt
	touch $@

$(VENV)/remote.stamp: $(VENV)/base.stamp requirements/remote.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/remote.txt
	touch $@

$(VENV)/peers.stamp: $(VENV)/base.stamp requirements/peers.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/peers.txt
	touch $@

$(VENV)/napari.stamp: $(VENV)/base.stamp requirements/napari.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/napari.txt
	touch $@

$(VENV)/docs.stamp: $(VENV)/base.stamp requirements/docs.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/docs.txt
	touch $@

$(VENV)/release.stamp: $(VENV)/base.stamp requirements/release.txt
	$(BIN)/python -m pip install --quiet --requirement requirements/release.txt
	touch $@

clean:
	rm -rf $(VENV) out build dist docs/_build docs/gallery docs/methods docs/reference
