# make demo, make test: on a fresh machine with python3 >= 3.10 and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt
STAMP := $(VENV)/.installed
# discovery never leaves this machine; tests pick a domain of their own
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
# the log of ROS stays here: rclpy refuses to start where it has no home
export ROS_LOG_DIR ?= $(CURDIR)/log/ros
# small solutions by the thousand: threads of BLAS would wait for each other most of the time
export OPENBLAS_NUM_THREADS ?= 1
# each of the hundreds of processes that tests start would compile all modules anew
unexport PYTHONDONTWRITEBYTECODE
# a Python of another environment must not hand down where its ROS libraries are
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# .venv has a ROS of its own: a sourced one would mix its libraries in
ifdef AMENT_PREFIX_PATH
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH RMW_IMPLEMENTATION
endif

# a file's tests share what they need; conftest.py has the order of files
LONGEST_FIRST := --dist loadfile --no-loadscope-reorder

BROWSERS := chromium chromium-browser google-chrome
# as root, or by who may be it
ASROOT := $(if $(filter 0,$(shell id -u)),,sudo)

.PHONY: demo test long check browser lint style types bench mechanisms rates docs smoke soak siege longbag fuzz load watched requests bounds identification strangers longload ends peers tips fastest readme counts venv clean

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

# side by side: nodes, which wait much of the time, three files at a time, then ends of nodes, their
# faults and a minute of siege; and in the time that these leave what has no nodes, on all cores,
# then types and layers. Loops that are held to time have the machine to themselves, at the end
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

# half an hour: what takes seconds or minutes each, of which make test has shorter forms
long: $(STAMP) browser
	@status=0; \
	$(BIN)/pytest -m 'long and ros' --numprocesses 2 $(LONGEST_FIRST) || status=1; \
	$(BIN)/pytest -m 'long and not ros' --numprocesses auto $(LONGEST_FIRST) || status=1; \
	exit $$status

# the viewer's page is tested in a real browser
browser:
	@for name in $(BROWSERS); do command -v $$name > /dev/null && exit 0; done; \
	$(ASROOT) apt-get update --quiet && $(ASROOT) apt-get install --yes --quiet --no-install-recommends chromium

# the tables of README and docs/nodes.md, from the code
readme: $(STAMP)
	$(BIN)/python test/test_readme.py

# the site, as build/site/html/index.html; a warning is a fault
docs: $(STAMP)
	rm -rf build/site
	mkdir -p build/site/source
	$(BIN)/python -m sphinx --quiet --fail-on-warning -c docs/site -d build/site/trees build/site/source build/site/html
	@echo 'build/site/html/index.html'

# three minutes: the package as the index would give it, in an empty environment, tried from end to end
smoke: $(STAMP)
	$(PIP) build
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m trust.smoke

# how the code is built: lines, lengths, arguments, repeated names, import circles
counts:
	$(PYTHON) campaigns/bench/counts.py

bench: $(STAMP)
	$(BIN)/denoc bench
	$(BIN)/python campaigns/bench/tick_latency.py
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.meshed_speed

# minutes: denoc identify model beside mujoco.sysid and figaroh, which it installs
peers: $(STAMP)
	$(PIP) 'mujoco[sysid]' figaroh
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.identify_peers

# four minutes: the five-bar, meshed and tapered links beside Exudyn; the circle of section 5.5
mechanisms: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.exudyn_five_bar
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.exudyn_links
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.platform_circle docs/platform_circle.png

# half an hour: tip-exact plans by their torque alone and with joints on the plan, in MuJoCo
tips: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.mujoco_tips

# a quarter of an hour: minimum time against one factor and against TOPP-RA
fastest: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.fastest

# seven minutes: the demo's nodes at 1000 and at 500 Hz beside bare ones
rates: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.rates

# ten minutes of faults: what must never move a robot wrongly, hang a node or need cleaning up
soak: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m trust.run --minutes 10

# two hours: 500 ends of each node, from every phase of its life, by every signal
ends: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m trust.ends_campaign --count 500
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m trust.session_ends --count 100

# an hour of whatever can be sent to all five nodes, drawn at random; what fails is shrunk to a few steps
siege: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m trust.siege --minutes 60 --json runs/siege.json

# ten minutes: a bag of 1 GB, made on the spot and replayed
longbag: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.long_bag

# four minutes: a minute of 50 topics with 5 MB/s, all recorded; what that costs a loop beside it
load: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.recorder_load --seconds 60
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.loop_lateness

# three minutes: what the viewer costs the loops of the SSRMS beside it
watched: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.viewer_lateness

# twenty minutes: what ten minutes of requests cost a loop of the SSRMS
requests: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.request_lateness --minutes 10

# ten minutes, 3 GB on the disk
longload: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.recorder_load --seconds 600

# an hour: a hundred random robots whose model is off, identified blind; what is found, and what is said of it
identification: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.identify_truth --count 100 --json runs/identification.json

# two minutes: verdicts on records as strangers make them
strangers: $(STAMP)
	PYTHONPATH=campaigns:test:test/support $(BIN)/python -m bench.identify_strangers --count 500

# a quarter of an hour: all tests of the dynamics with kernels that check every offset
bounds: $(STAMP)
	DENOC_CHECK_BOUNDS=1 $(BIN)/pytest test/dynamics

# a quarter of an hour: thousands of spoiled robots and recordings
fuzz: $(STAMP)
	$(BIN)/pytest --hypothesis-profile fuzz test/fuzz

clean:
	rm -rf $(VENV) build install log runs
