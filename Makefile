# Each target makes .venv on first use and again when the pins change.
PYTHON ?= python3
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal --durations=30 --durations-min=2
SEEDS ?= 42
OUT ?= runs/reproduce

.PHONY: reproduce test test-slow test-extras coverage lint validate bench docs figures wheel clean

reproduce: .venv/installed
	$(BIN)/pinav reproduce --seeds $(SEEDS) --out $(OUT) --resume

test: .venv/installed-dev
	$(PYTEST) -m "not slow and not extras"

# Whole commands, examples and snippets, from end to end, as users run them: types are
# checked at run time by `make test` and `make coverage` alone, and take half of the time.
test-slow: .venv/installed-dev
	PINAV_UNCHECKED=1 $(PYTEST) -m "slow and not extras"

# Tests that need the optional packages with which published numbers were made.
test-extras: .venv/installed-extras
	$(PYTEST) -m extras --extras

coverage: .venv/installed-dev
	$(PYTEST) --cov --cov-report=term --cov-fail-under=90

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

validate: .venv/installed-dev
	$(BIN)/python -m pytest validation -v -s
	PINAV_LONG=1 XLA_FLAGS=--xla_cpu_use_fusion_emitters=false $(BIN)/python -m pytest -v tests/test_docs.py -k "code and (bead or tracker or wrong-force)"

bench: .venv/installed-dev
	$(BIN)/python -m benchmarks gradient
	$(BIN)/python -m benchmarks growth
	$(BIN)/python -m benchmarks fit
	$(BIN)/python -m benchmarks heat
	$(BIN)/python -m benchmarks navigate

# The documentation site, offline after the install; examples are run for the gallery.
docs: .venv/installed-docs
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet $(SPHINX) docs site
	@echo "site/index.html"

# Every figure of the pages, from runs that are kept in runs/figures.
figures: .venv/installed-extras
	$(BIN)/python -m docs.figures.draw

# Wheel and source distribution, in dist.
wheel: .venv/installed
	rm -rf dist
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --constraint constraints.txt --no-deps --wheel-dir dist .
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt hatchling
	$(BIN)/python -m hatchling build --target sdist --directory dist

clean:
	rm -rf site docs/gallery .venv .pytest_cache .ruff_cache .hypothesis .coverage

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else f"pinav needs Python 3.11 or later, this is {v.major}.{v.minor}; run make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	$(BIN)/python -m compileall -q src  # pip does it for a package that is not editable
	touch $@

.venv/installed-dev: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test,lint]'
	touch $@

.venv/installed-extras: .venv/installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[symbolic,peers,mri,notebook,exchange]'
	touch $@

.venv/installed-docs: .venv/installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	touch $@
