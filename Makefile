# Everything sets itself up: Python 3.11 or newer, git and make are enough. Where uv is on the PATH, it installs, in a
# fraction of the time (`make UV= demo` does without).
PYTHON ?= python3
UV ?= $(shell command -v uv 2> /dev/null)
VENV := .venv
BIN := $(VENV)/bin
DEMO := $(VENV)/.demo-ready
READY := $(VENV)/.ready
PAGES := nmes/lab/pages/index.html

# Images often say that no bytecode is to be written. The tests start a thousand processes that load the same modules:
# compiling them each time would take most of it.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup demo lab test test-long conform-selftest lint format clients types editor imports layout bench docs man figures goldens constraints clean

help:
	@echo "make demo              serve, drive, record and reproduce the example worlds, and draw one"
	@echo "make lab               build the pages of nmes lab (with Node, or one from the package index)"
	@echo "make test              lint, type-check and test (and install what that needs)"
	@echo "make test-long         the same with the tests that take minutes"
	@echo "make conform-selftest  show that the conformance suite finds what is wrong with broken servers"
	@echo "make bench             print the benchmark table"
	@echo "make docs              build the documentation as a site in build/site"
	@echo "make man               write manual pages in build/man"
	@echo "make figures           draw the figures in docs/pictures anew (with Graphviz)"
	@echo "make goldens           record the corpus in replays/ anew"
	@echo "make format            write anew what is written from the schemas, mend what the linter can mend"
	@echo "make clients           write the messages of the clients in Go and TypeScript anew (with Go)"
	@echo "make clean             remove what was built, the environment too"

setup: layout

ifeq ($(UV),)
CREATE = $(PYTHON) -m venv $(VENV)
# Bytecode is made when a module is first loaded: most never are.
INSTALL = $(BIN)/python -m pip install --disable-pip-version-check --no-compile -c constraints.txt
else
CREATE = $(UV) venv -q --allow-existing --python $(PYTHON) $(VENV)
INSTALL = $(UV) pip install --python $(BIN)/python -c constraints.txt
endif

# setuptools first, pinned, so that the package is built by the one that constraints.txt names.
$(DEMO): pyproject.toml setup.py constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "NMES needs Python 3.11 or newer; this is " + sys.version.split()[0] + " (make PYTHON=/path/to/python3.11)")'
	@echo "Installing NMES, with what draws films, into $(VENV): about 600 MB, once"
	@$(CREATE)
	@$(INSTALL) -q setuptools
	@$(INSTALL) --no-build-isolation -e '.[film]'
	@touch $@

$(READY): $(DEMO)
	@echo "Installing the other extras and what the tests need: about 1.5 GB more, once"
	@$(INSTALL) --no-build-isolation -e '.[all,dev]'
	@touch $@

demo: $(DEMO)
	@$(BIN)/python examples/demo.py

lab: $(PAGES)

# Node is only wanted here: a wheel carries what was built.
$(PAGES): $(DEMO) $(wildcard tools/lab_pages.py lab/*.json lab/*.mjs lab/src/* lab/src/*/* clients/typescript/src/*)
	@$(BIN)/python tools/lab_pages.py

test: lint $(PAGES)
	$(BIN)/pytest -n auto --dist worksteal -m 'not long'

test-long: lint $(PAGES)
	$(BIN)/pytest -n auto --dist worksteal --hypothesis-profile=search

conform-selftest: $(READY)
	@PYTHONPATH=tests/support:tests/mutants $(BIN)/python tools/selftest.py

lint: $(READY) types imports editor
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: layout
	$(BIN)/mypy --cache-dir build/mypy -p nmes
	$(BIN)/mypy --cache-dir build/mypy tests tools benchmarks
	$(BIN)/mypy --cache-dir build/mypy examples

# What an editor resolves: pyproject.toml tells it, in [tool.pyright], of the layout.
editor: layout
	$(BIN)/basedpyright tests/project/editor_example.py

imports: layout
	cd build/layout && PYTHONPATH=. ../../$(BIN)/lint-imports --config ../../pyproject.toml --no-logo

# The package as it is once installed, for tools and editors that do not follow setuptools' package-dir.
layout: $(READY)
	@$(BIN)/python tools/layout.py build/layout

format: layout
	$(BIN)/python tools/client_docs.py
	$(BIN)/python tools/reference_docs.py
	$(BIN)/python -m nmes.schemas > build/messages.md && mv build/messages.md docs/messages.md
	$(BIN)/python -m nmes.conformance > build/cases.md && mv build/cases.md docs/conformance-cases.md
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The messages of clients in other languages; it takes Go.
clients: layout
	$(BIN)/python tools/go_messages.py
	$(BIN)/python tools/go_schemas.py
	$(BIN)/python tools/ts_messages.py

bench: $(READY)
	@$(BIN)/python benchmarks/bench.py

docs: $(READY)
	$(BIN)/mkdocs build --strict

man: $(READY)
	@$(BIN)/python tools/man.py build/man
	@echo "Read one with: man -l build/man/nmes.1"

figures: docs/pictures/architecture.svg

%.svg: %.dot
	dot -Tsvg $< -o $@

goldens: $(READY)
	@$(BIN)/python tools/goldens.py

# Pins the newest versions that fit pyproject.toml: names and versions only.
constraints: $(READY)
	$(BIN)/python -m pip install -q uv
	$(BIN)/uv pip compile --universal --upgrade --all-extras --no-annotate --no-header --no-emit-index-url \
		--no-emit-find-links -q pyproject.toml -o constraints.txt

clean:
	rm -rf $(VENV) build dist nmes/lab/pages lab/node_modules recordings *.egg-info .*_cache .coverage*
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
