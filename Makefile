# Everything a fresh machine needs is Python 3.11 or newer and make. `make help` lists the targets.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
BUILD = $(BIN)/jupyter-book build -W -n --keep-going
NOTEBOOKS := $(wildcard book/*.ipynb)

.DEFAULT_GOAL := help
.PHONY: help book read test test-core test-browser self-hosted lab lint notebooks requirements clean

help: ## list what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

book: $(VENV)/made ## build the book: environment, notebooks executed, warnings as errors
	$(BUILD) .
	@echo "The book is built. Open _build/html/index.html, or read it with live figures: make read"

read: book ## build the book, serve it on 127.0.0.1 and open the browser
	$(BIN)/python -m pfedu.live.serve _build/html

test: test-core test-browser ## everything: code, notebooks, book, and the book in a real browser

test-core: $(VENV)/made lint ## code and notebooks
	$(BIN)/python -m pytest -m "not browser"

test-browser: book self-hosted ## the built book in Chromium; says so where there is none
	$(BIN)/python -m pytest tests -m browser

self-hosted: $(VENV)/made _build/pyodide/pyodide-lock.json ## the book with its own Pyodide, which asks nothing of any other site
	PFEDU_PYODIDE=_build/pyodide $(BUILD) --path-output _build/self-hosted .

lab: $(VENV)/made ## open the notebooks in JupyterLab
	$(BIN)/jupyter lab book

lint: $(VENV)/made ## style of code and notebooks
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

notebooks: $(VENV)/made ## execute the notebooks in place, to commit their outputs
	cd book && ../$(BIN)/jupyter nbconvert --to notebook --execute --inplace --ExecutePreprocessor.store_widget_state=False \
		--ExecutePreprocessor.record_timing=False $(notdir $(NOTEBOOKS))

requirements: $(VENV)/made ## pin the newest versions of everything in requirements.in
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --universal --upgrade --python-version 3.11 --no-header --no-annotate -q requirements.in -o requirements.txt

clean: ## remove all that was made
	rm -rf _build $(VENV) *.egg-info

$(VENV)/made: requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt -e .
	@touch $@

_build/pyodide/pyodide-lock.json: pfedu/live/self_host.py | $(VENV)/made
	$(BIN)/python -m pfedu.live.self_host _build/pyodide
	@touch $@
