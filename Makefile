# Everything lives in .venv (the environment) and runs/ (what it produced); git ignores both.
PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
ARGS   ?=

.PHONY: train test lint evaluate table clean
.DELETE_ON_ERROR:

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check torch==2.13.0 -c constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]' -c constraints.txt
	touch $@

train: $(VENV)/installed            ## train, evaluate, draw: make train ARGS="preset=smoke seed=1"
	$(BIN)/python -m irl_dal.train $(ARGS)

evaluate: $(VENV)/installed         ## make evaluate ARGS="policy=expert episodes=100"
	$(BIN)/python -m irl_dal.evaluate $(ARGS)

table: $(VENV)/installed            ## the tables of README and docs/results.md from results/
	$(BIN)/python -m irl_dal.report runs=results page=README.md $(ARGS) > /dev/null
	$(BIN)/python -m irl_dal.report runs=results page=docs/results.md $(ARGS)

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Bytecode is kept whatever the shell says: twenty processes import the same modules.
test: lint                          ## lint, types, import contracts, tests: make test ARGS="tests/shield"
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 -m "not slow" $(ARGS)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis
