# make demo, make test: on a fresh machine with python3 >= 3.10 and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt
STAMP := $(VENV)/.installed
# Discovery stays on this machine; tests take a domain of their own.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
# rclpy refuses to start without a folder for its log.
export ROS_LOG_DIR ?= $(CURDIR)/log/ros
# Solutions are small and many: threads of BLAS would wait for each other.
export OPENBLAS_NUM_THREADS ?= 1
# Otherwise each of the hundreds of processes of the tests compiles all modules.
unexport PYTHONDONTWRITEBYTECODE
# The ROS libraries of another environment must not be found through this variable.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# .venv has its own ROS: libraries of a sourced one would be mixed in.
ifdef AMENT_PREFIX_PATH
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH RMW_IMPLEMENTATION
endif

# Tests of one file share fixtures; conftest.py has the order of the files.
LONGEST_FIRST := --dist loadfile --no-loadscope-reorder
BROWSERS := chromium chromium-browser google-chrome
ASROOT := $(if $(filter 0,$(shell id -u)),,sudo)

.PHONY: demo test long check browser lint style types docs smoke venv clean

venv: $(STAMP)

$(STAMP): setup.py package.xml constraints.txt
	@echo 'installing the package and its dependencies into $(VENV): a minute or two'
	$(PYTHON) -m venv $(VENV)
	$(PIP) setuptools
	$(PIP) --no-build-isolation --editable '.[ros,viewer,test]'
	touch $@

demo: $(STAMP)
	$(BIN)/denoc up config/tip.yaml

lint: style types

style: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint
	$(BIN)/pytest -m 'not ros and not long' --numprocesses auto $(LONGEST_FIRST)

# Tests of nodes, three files at a time, and tests without nodes at low priority run at the same
# time, for nodes wait much of the time. Loops whose timing is checked run alone, at the end.
test: style browser
	@status=0; mkdir -p $(ROS_LOG_DIR); \
	{ nice -n 10 $(BIN)/pytest -m 'not ros and not long' --numprocesses auto $(LONGEST_FIRST); found=$$?; \
	nice -n 10 $(MAKE) --no-print-directory types && exit $$found; } > $(ROS_LOG_DIR)/check.txt 2>&1 & check=$$!; \
	trap 'trap - TERM; kill 0; exit 130' INT TERM; \
	$(BIN)/pytest -m 'ros and not alone and not long' --numprocesses 3 $(LONGEST_FIRST) || status=1; \
	$(BIN)/pytest -m alone campaigns/trust || status=1; \
	wait $$check || status=1; \
	cat $(ROS_LOG_DIR)/check.txt; \
	$(BIN)/pytest -m alone campaigns/bench || status=1; \
	exit $$status

long: $(STAMP) browser
	@status=0; \
	$(BIN)/pytest -m 'long and ros' --numprocesses 2 $(LONGEST_FIRST) || status=1; \
	$(BIN)/pytest -m 'long and not ros' --numprocesses auto $(LONGEST_FIRST) || status=1; \
	exit $$status

# The tests open the viewer's page in a real browser.
browser:
	@for name in $(BROWSERS); do command -v $$name > /dev/null && exit 0; done; \
	$(ASROOT) apt-get update --quiet && $(ASROOT) apt-get install --yes --quiet --no-install-recommends chromium

docs: $(STAMP)
	rm -rf build/site && mkdir -p build/site/source
	$(BIN)/python -m sphinx --quiet --fail-on-warning -c docs/site -d build/site/trees build/site/source build/site/html
	@echo 'build/site/html/index.html'

# The wheel is installed in an empty environment, and its commands are tried.
smoke: $(STAMP)
	$(PIP) build
	$(BIN)/python -m campaigns smoke

clean:
	rm -rf $(VENV) build install log runs
