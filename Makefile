# `make demo`: from a fresh clone to a repaired take, its report and a picture.
# `make test`: from a fresh clone to a green suite. Both need Python 3.11 or newer and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
TORCH ?= 2.13.0

.PHONY: demo test quick check slow blender docs fuzz clean

demo: $(VENV)/.app
	$(BIN)/motionmend demo -o demo

test: $(VENV)/.dev
	$(BIN)/pytest -n auto

# What a change to a reader, a body or a fill can break: under a minute of one core, and no torch.
quick: .venv-quick/.done
	.venv-quick/bin/pytest -n auto tests/io tests/body tests/metrics tests/damage tests/fills tests/rigs tests/constraints

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

slow: $(VENV)/.dev
	$(BIN)/pytest -n auto -m slow

# The GLB files in Blender's own hands; bpy is large, so the suite skips this where it is absent.
blender: $(VENV)/.dev
	$(PYTHON) -m venv .venv-blender
	.venv-blender/bin/pip install -q --disable-pip-version-check bpy==5.0.1
	MOTIONMEND_BPY_PYTHON=$(CURDIR)/.venv-blender/bin/python $(BIN)/pytest tests/io/test_glb.py

docs: $(VENV)/.docs
	$(BIN)/sphinx-build -W -b html docs docs/_build

fuzz: $(VENV)/.dev
	$(BIN)/python tests/io/fuzz.py --files 100000

$(VENV)/.app: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.app
	$(BIN)/pip install -q --disable-pip-version-check torch==$(TORCH)
	$(BIN)/pip install -q --disable-pip-version-check -e ".[test,check,train,tensorboard]"
	@touch $@

.venv-quick/.done: pyproject.toml
	$(PYTHON) -m venv .venv-quick
	.venv-quick/bin/pip install -q --disable-pip-version-check -e ".[test]"
	@touch $@

$(VENV)/.docs: $(VENV)/.app
	$(BIN)/pip install -q --disable-pip-version-check -e ".[docs]"
	@touch $@

clean:
	rm -rf $(VENV) .venv-blender .venv-quick build dist demo docs/_build
