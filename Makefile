# make install  -> .venv with everything; make demo -> the main job on a real scene; make test -> every check;
# make results -> the README's figure, measured anew on the shipped scene (about 10 minutes on two quiet cores);
# make docker-test -> the image and both compose files, built, started and hurt (as root it brings its own engine).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: install demo test results docker-test check clean

install: $(STAMP)

$(STAMP): pyproject.toml .ci/constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c .ci/constraints.txt -e '.[test]'
	touch $(STAMP)

demo: install
	$(BIN)/mark3dgs demo

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: check
	$(BIN)/python -m pytest

results: install
	$(BIN)/mark3dgs evaluate --suite pareto --out out/results
	cp out/results/figures/pareto.png out/results/figures/pareto.svg docs/

docker-test: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c .ci/constraints.txt -e '.[docker-test]'
	$(BIN)/python -m pytest -m docker -ra --durations=10 tests/docker

clean:
	rm -rf $(VENV) demo-out build *.egg-info
