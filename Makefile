# make demo, make test: on a fresh machine with python3 >= 3.10 and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# discovery never leaves this machine; tests pick a domain of their own
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

.PHONY: demo test check lint nodetest venv clean
venv: $(STAMP)

$(STAMP): setup.py package.xml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[ros,test]'
	touch $@

demo: $(STAMP)
	$(BIN)/denoc up config/canadarm.yaml

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint
	$(BIN)/pytest -m 'not ros'

test: lint
	$(BIN)/pytest

clean:
	rm -rf $(VENV) build install log runs
