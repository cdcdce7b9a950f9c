# Everything is installed into .venv; needed beforehand are Python 3.11 or later, make and git.

PYTHON ?= $(shell for python in python3.11 python3; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$python && break; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTEST := $(BIN)/pytest --numprocesses 2 --dist loadscope
INSTALL := DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends
CHROMIUM := $(INSTALL) chromium fonts-dejavu-core
LATEX := $(INSTALL) texlive-science

.PHONY: help demo test test-all test-numerics fuzz lint browser latex docs tables table-ages package installs lock clean
.DEFAULT_GOAL := help

help: ## This list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

demo: $(READY) ## Fly over generated terrain, estimate the motion, compare and plot; results in runs/demo
	$(BIN)/fvslam demo

test: lint browser ## Lint, types and tests, in two processes
	$(PYTEST)

test-all: test ## ... and the long ones, over many seeds
	$(PYTEST) -m slow

test-numerics: $(READY) ## Those on which a processor's last bits tell; OPENBLAS_CORETYPE=Nehalem, say, is another processor
	$(PYTEST) tests/vo tests/slam tests/graph tests/fusion tests/test_estimator.py tests/test_pipeline.py

fuzz: $(READY) ## Spoilt inputs, twenty times as many as among the tests
	FVSLAM_FUZZ=20 $(BIN)/pytest tests/fuzz

lint: $(READY) ## ruff and mypy
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

# The report of a study is looked at in a browser: Debian's Chromium, where it is or can be installed.
browser:
	@command -v chromium >/dev/null || { test "$$(id -u)" = 0 && command -v apt-get >/dev/null && \
		{ $(CHROMIUM) || { apt-get update -qq && $(CHROMIUM); }; } >/dev/null 2>&1; } || \
		echo "There is no Chromium: the tests of reports in a browser are skipped."

latex: ## Debian's LaTeX, by which tables are set in the tests; without it, these are skipped
	@command -v pdflatex >/dev/null || { test "$$(id -u)" = 0 && command -v apt-get >/dev/null && \
		{ $(LATEX) || { apt-get update -qq && $(LATEX); }; } >/dev/null 2>&1; } || \
		echo "There is no LaTeX: the tests that set tables are skipped."

docs: $(READY) ## The documentation in build/site, with strict links
	$(BIN)/mkdocs build --strict

tables: $(READY) ## Measure all tables of the docs again: hours, and the recordings; then say which are older than the code
	$(BIN)/python scripts/make_tables.py make

table-ages: $(READY) ## Which tables of the docs are older than the code that they measure
	$(BIN)/python scripts/make_tables.py ages

# The wheel with what its users get, the newest libraries; the tests with the locked ones.
package: $(READY) ## Build wheel and sdist; without the repository, fly the demo with the one, run the other's tests
	rm -rf dist build/wheel build/sdist
	$(BIN)/hatchling build
	$(PYTHON) -m venv build/wheel
	build/wheel/bin/pip install --quiet --disable-pip-version-check "$$(ls dist/*.whl)[eval]"
	cd build/wheel && bin/fvslam demo --frames 30 --out demo
	$(PYTHON) -m venv build/sdist
	build/sdist/bin/pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements.lock
	build/sdist/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation dist/*.tar.gz
	tar -xzf dist/*.tar.gz -C build/sdist --strip-components 1 --one-top-level=source
	cd build/sdist/source && ../bin/pytest --numprocesses 2 --dist loadscope

installs: OUT ?= runs/installs
installs: $(READY) ## Fresh installs without extras and with each: size, import time, demo; wheels for ARM
	rm -rf dist
	$(BIN)/hatchling build --target wheel
	$(BIN)/python scripts/installs.py dist/*.whl --out $(OUT)

lock: ## Pin the newest versions that pyproject.toml allows in requirements.lock
	$(PYTHON) -m venv build/lock
	build/lock/bin/pip install --quiet uv
	UV_CUSTOM_COMPILE_COMMAND="make lock" build/lock/bin/uv pip compile --quiet --upgrade --universal \
		--python-version 3.11 --generate-hashes --all-extras --group dev --group docs --output-file requirements.lock pyproject.toml

clean: ## Remove .venv, caches and builds; runs stay
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache
	find fvslam_graph scripts tests -name __pycache__ -prune -exec rm -rf {} +

# The build backend is among the locked packages, so that nothing else is fetched for the build of our own.
$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "Python 3.11 or later is needed, as python3.11 or python3; if it is elsewhere:" \
		"make PYTHON=/path/to/python" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@
