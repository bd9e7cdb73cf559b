# make install  -> .venv with everything; make demo -> the main job on a real scene, with core and lab alone;
# make test -> what must hold before a change lands; make full -> that, and every study, bench and viewer: before a release;
# make quick -> the checks for daily work, under three minutes on two cores: rules and units, no long flow;
# make core-test -> the core alone, in a new environment of each Python that is here; make lab-test -> the laboratory, without its long studies;
# make room-test ROOMS="tests/formats ..." -> what make test leaves to changes of these rooms;
# make mutants -> breaks one line at a time and counts who notices (half an hour; part of it: MUTANTS="--only TEXT");
# make results -> the README's chart and its table in docs/RESULTS.md, measured anew (260 processor seconds a scene;
#   SCENES="a.ply b.sog": on others than the shipped one);
# make families -> how far six attacks must go before ours and other methods break, measured anew; make results draws it;
# make docker-test -> the image and both compose files, built, started and hurt (as root it brings its own engine).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-demo
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c .ci/constraints.txt
SCENES ?= tests/data/plant.splat
# What was measured of this commit is not measured again; cells of another one do not count.
COMMIT ?= $(shell git rev-parse --short HEAD)
MEASURED = out/results/$(COMMIT)
OF_COMMIT = sed 's/"commit": .*/"commit": "$(COMMIT)",/'
SWEPT := docs/results/curves/attack_families.json
# Two more than there are cores: some tests wait for servers and browsers.
WORKERS ?= $(shell expr $$(nproc 2>/dev/null || echo 2) + 2)
UNITS := architecture cli compress credentials flows formats kernels numerics pictures present raster records registration theory watermark
# Also where the environment forbids it: each worker would rewrite the asserts of all tests anew.
export PYTHONDONTWRITEBYTECODE :=
# In the order of tests/conftest.py, longest files first; by default files of few tests, however long, would come last.
PYTEST := $(BIN)/python -m pytest --numprocesses $(WORKERS) --maxprocesses 8 --dist loadfile --no-loadscope-reorder

.PHONY: install demo test full quick core-test lab-test room-test mutants results families docker-test check kernels rewritten clean

install: $(STAMP) kernels

$(STAMP): pyproject.toml .ci/constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) -e '.[test]'
	touch $(STAMP)

# Without bytecode: what is imported is compiled then, a tenth of it all.
$(DEMO_STAMP): pyproject.toml .ci/constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --no-compile -e '.[lab]'
	touch $(DEMO_STAMP)

demo: $(or $(wildcard $(STAMP)),$(DEMO_STAMP))
	$(BIN)/mark3dgs demo

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Compiled once, before a first embedding would wait for it, or several processes would each compile the same.
kernels: $(STAMP)
	$(BIN)/python -m engine.cli.kernel_progress

# Else each worker would rewrite the asserts of all tests: pytest keeps them beside the bytecode.
rewritten: $(STAMP)
	$(BIN)/python -m pytest --collect-only -qq >/dev/null || true  # the tests will tell

test: $(STAMP)
	$(MAKE) --jobs=2 --output-sync check kernels rewritten
	$(PYTEST)

full: $(STAMP)
	$(MAKE) --jobs=2 --output-sync check kernels rewritten
	$(PYTEST) -m 'not docker'

quick: $(STAMP)
	$(MAKE) --jobs=2 --output-sync check kernels rewritten
	$(PYTEST) -m 'not docker and not lab and not slow and not long and not room' $(addprefix tests/,$(UNITS))

core-test: $(STAMP)
	$(BIN)/python -m pytest -m long -ra --numprocesses 2 tests/install tests/end_to_end/test_cli_machines.py

lab-test: $(STAMP) kernels
	$(PYTEST) -m "not docker and not long" tests/lab

# What of tests/conftest.py's OF_ONE_ROOM lies in these folders.
room-test: $(STAMP) kernels
	$(PYTEST) -m "room and not long" $(ROOMS)

mutants: $(STAMP)
	$(BIN)/python -m tests.mutants $(MUTANTS)

results: $(STAMP) kernels
	$(BIN)/mark3dgs evaluate --suite pareto $(addprefix --scene ,$(SCENES)) --out $(MEASURED)
	cp $(MEASURED)/figures/pareto.png docs/
	$(OF_COMMIT) $(MEASURED)/17_profiles.json > docs/results/17_profiles.json
	$(BIN)/python -m engine.lab.evaluate.stability.attack_families $(SWEPT) docs/attack_families.png docs/results/21_attack_families.json
	$(BIN)/python -m engine.lab.evaluate.results_page docs/results docs/RESULTS.md service/claims/error_rates.json

families: $(STAMP) kernels
	$(BIN)/mark3dgs evaluate --suite stability --setting families $(addprefix --scene ,$(SCENES)) --out $(MEASURED)/families
	$(OF_COMMIT) $(MEASURED)/families/attack_families.json > $(SWEPT)

docker-test: $(STAMP)
	$(PIP_INSTALL) -e '.[docker-test]'
	$(BIN)/python -m pytest -m docker -ra --durations=10 tests/docker

clean:
	rm -rf $(VENV) demo-out build *.egg-info
