# `make demo`: from a fresh clone to a repaired take, its report and a picture.
# `make test`: from a fresh clone to a green suite. Both need Python 3.11 or newer and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test check slow docs fuzz clean

demo: $(VENV)/.app
	$(BIN)/motionmend demo -o demo

test: $(VENV)/.dev
	$(BIN)/pytest -n auto

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

slow: $(VENV)/.dev
	$(BIN)/pytest -n auto -m slow

docs: $(VENV)/.docs
	$(BIN)/sphinx-build -W -b html docs docs/_build

fuzz: $(VENV)/.dev
	$(BIN)/python tests/fuzz.py --files 100000

$(VENV)/.app: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.app
	$(BIN)/pip install -q --disable-pip-version-check -e ".[test,check]"
	@touch $@

$(VENV)/.docs: $(VENV)/.app
	$(BIN)/pip install -q --disable-pip-version-check -e ".[docs]"
	@touch $@

clean:
	rm -rf $(VENV) build dist demo docs/_build
