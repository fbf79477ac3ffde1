# All that a fresh machine needs is Python 3.11 or newer and make. `make help` lists what can be made.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
export OPENBLAS_NUM_THREADS ?= 1# the arrays are small: more threads only stand in each other's way
BUILD = $(BIN)/jupyter-book build -W -n --keep-going

PDF = _build/particle-filters-alive.pdf

.DEFAULT_GOAL := help
.PHONY: help env browser book read test test-core test-browser test-lite self-hosted pdf lab lint notebooks tables requirements clean

help: ## list what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

book: env ## build the book: environment, notebooks executed, warnings as errors
	$(BUILD) .
	@echo "The book is built. Read it with Python in its pages: make read (or open _build/html/index.html: pictures only)"

read: book ## build the book, serve it on 127.0.0.1 and open the browser
	$(BIN)/python -m pfedu.live.serve _build/html

test: test-core test-browser ## everything: code, notebooks, book, and the book in a real browser

test-core: lint ## code and notebooks
	$(BIN)/python -m pytest -m "not browser" -n 2 pfedu tests
	$(BIN)/python -m pytest -m "not browser" -n 2 --dist loadfile book

test-browser: book self-hosted ## the built book in Chromium; says so where there is none
	$(BIN)/python -m pytest -m browser tests/test_browser.py tests/test_lite.py -n 2

test-lite: book self-hosted ## every chapter run to its end as a live notebook in Chromium (minutes each)
	PFEDU_LITE=all $(BIN)/python -m pytest -m browser tests/test_lite.py

self-hosted: env _build/pyodide/pyodide-lock.json ## build the book with its own Pyodide: it asks nothing of any other site
	PFEDU_PYODIDE=_build/pyodide $(BUILD) --path-output _build/self-hosted .

pdf: book ## print the book with Chromium into one PDF, and build it again with a link to that
	$(BIN)/python -m pfedu.live.pdf _build/html $(PDF)
	PFEDU_PDF=$(PDF) $(BUILD) .

lab: env ## open the notebooks in JupyterLab
	$(BIN)/jupyter lab book

lint: env ## check the style of code and notebooks, and the spelling
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell

notebooks: env ## execute the notebooks in place, to commit their outputs
	$(BIN)/python -m pfedu.live.execute $(wildcard book/*.ipynb)

tables: env ## measure the reference numbers of the sources anew, beside those found by other programs (minutes)
	$(BIN)/python benchmarks/tables.py

env: $(VENV)/made ## make the environment

browser: env ## install a Chromium for the tests, where the system has none
	$(BIN)/python -m playwright install --with-deps chromium

requirements: env ## pin the newest versions of everything in requirements.in
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --universal --upgrade --python-version 3.11 --no-header --no-annotate --quiet \
		requirements.in --output-file requirements.txt

clean: ## remove the environment and the built book
	rm -rf _build $(VENV) *.egg-info

$(VENV)/made: requirements.txt pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(None if sys.version_info >= (3, 11) else 'Python 3.11 or newer is needed: make ... PYTHON=python3.12')"
	@echo "Making the environment in $(VENV): a minute or two, about 1 GB"
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt -e .
	@touch $@

_build/pyodide/pyodide-lock.json: pfedu/live/self_host.py | $(VENV)/made
	$(BIN)/python -m pfedu.live.self_host _build/pyodide
	@touch $@
