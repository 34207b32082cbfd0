# `make run` and `make test` need only Python 3.10-3.14 and make; everything else is installed into .venv.
PYTHON ?= python3
VENV := .venv
ifeq ($(OS),Windows_NT)
BIN := $(VENV)/Scripts
CALL := $(VENV)\Scripts\bearings
ACTIVATE := $(VENV)\Scripts\activate
else
BIN := $(VENV)/bin
CALL := $(BIN)/bearings
ACTIVATE := . $(BIN)/activate
endif

.PHONY: run test versions lint check format docs notebooks release clean

run: $(VENV)/installed
	$(BIN)/bearings run --shape 32,32,32
	@echo "From now on: $(CALL), or first $(ACTIVATE) and then plain bearings"

test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal
	$(BIN)/python -m pytest -n auto --dist worksteal --precision f32 tests/kernels tests/laws tests/agreement
	$(BIN)/python -m pytest -n auto --dist worksteal --compiler quadrants tests/kernels tests/agreement/test_methods.py
	$(BIN)/python -m pytest -n auto --dist worksteal --arch vulkan tests/kernels/test_devices.py
	$(BIN)/python -m pytest -n auto --dist worksteal --arch vulkan --precision f32 tests/kernels/test_devices.py

# Every Python promised that is here, with the newest packages, and the oldest with all of them at their floors.
versions: $(VENV)/installed
	$(BIN)/python -m tests.versions

lint: $(VENV)/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

check: lint
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow" $(addprefix tests/,agreement analysis conic kernels \
		laws numerics plots properties scene solvers test_floors.py test_names.py test_shape.py test_words.py)

format: $(VENV)/installed-dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -q -W --keep-going docs docs/_build/html
	@echo "Open docs/_build/html/index.html"

notebooks: $(VENV)/installed-docs
	$(BIN)/python docs/run_notebooks.py

# What is uploaded, in dist/, tried in an environment of its own.
release: $(VENV)/installed-release
	$(PYTHON) -c "import shutil; [shutil.rmtree(name, ignore_errors=True) for name in ('dist', 'build')]"
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python -m tests.try_wheel dist

$(VENV)/bare:
	$(PYTHON) -m venv $(VENV)
	$(PYTHON) -c "open('$@', 'w')"

$(VENV)/installed: $(VENV)/bare pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	$(PYTHON) -c "open('$@', 'w')"

$(VENV)/installed-dev: $(VENV)/bare pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]"
	$(PYTHON) -c "open('$@', 'w'); open('$(VENV)/installed', 'w')"

$(VENV)/installed-docs: $(VENV)/bare pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[docs]"
	$(PYTHON) -c "open('$@', 'w'); open('$(VENV)/installed', 'w')"

$(VENV)/installed-release: $(VENV)/bare pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[release]"
	$(PYTHON) -c "open('$@', 'w'); open('$(VENV)/installed', 'w')"

clean:
	$(PYTHON) -c "import shutil; shutil.rmtree('$(VENV)', ignore_errors=True)"
