# make test          all tests that need no ROS; makes .venv first (python3 >= 3.10, python3-venv)
# make demo          a simulated flight, its replay, its report: demo/
# make bench         the timing tables of README.md
# make lint          flake8 and pydocstyle with the rules of ament_flake8 and ament_pep257; mypy
# make test-matrix   the tests with NumPy 1.26 + OpenCV 4 and with NumPy 2 + OpenCV 5
# make ros-test      test/ros against the ROS 2 in /opt/ros/jazzy
# make bench-long   a survey larger than its memory; ARGS="--voxels 1e7"
# make soak          two hours of flight into an attached map; ARGS="--minutes 10"
# make bench-scale  persem build by recording, tile and observation; ARGS="--flights 8"
# make bench-live  the node under load, through real DDS
# make night        three sessions in one file, RAM for a tenth of it, one killed; ARGS="--frames 150"
# make night-live   the same, two of the sessions flown live into the node
# make fuzz         files that mean harm, for MINUTES=30; prints its seed (SEED=n repeats it)
# make signals      Ctrl-C and SIGTERM at MOMENTS=200 of each command; all of them without streams
# make docs          the documentation as a site, build/site/index.html; a broken link fails
# make docs-links    asks every address on the network
# make clean         away with everything that these made
# PYTHON=python3.12, VENV=folder, ARGS="-k memory" and WORKERS=1 change interpreter, folder,
# arguments and the number of processes that test.

PYTHON ?= python3
VENV ?= .venv
WORKERS ?= $(shell nproc 2>/dev/null || echo 2)
RUN := $(VENV)/bin/python
PEP257 := --ignore=D100,D101,D102,D103,D104,D105,D106,D107,D203,D212,D404 --match='.*\.py'

.DELETE_ON_ERROR:
.PHONY: test demo bench bench-long bench-scale soak night night-live lint test-matrix ros-test bench-live fuzz signals clean docs docs-links
# A sourced ROS would put its own pytest plugins and messages into our environment.
unexport PYTHONPATH
# Each of the many processes that tests start would compile the whole package again.
unexport PYTHONDONTWRITEBYTECODE

# Kernels are compiled before the processes that test, which would all compile them.
test: $(VENV)/installed-test
	$(RUN) -m persem_ros.core.warmup
	$(RUN) -m pytest -q -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

demo: $(VENV)/installed
	$(RUN) -m persem_ros simulate demo/flight --force
	$(RUN) -m persem_ros replay demo/flight --out demo/result --force --set 'memory.dynamic_labels=[10]' \
		--set refine.method=geometry --methods raw2d,majority,persem,geometry --figure demo/demo.png

bench: $(VENV)/installed-bench
	$(RUN) benchmarks/run.py $(ARGS)

bench-long: $(VENV)/installed
	$(RUN) benchmarks/long.py $(ARGS)

soak: $(VENV)/installed-evaluate
	$(RUN) benchmarks/soak.py --figure build/soak.svg $(ARGS)

bench-scale: $(VENV)/installed
	$(RUN) benchmarks/scale.py $(ARGS)

lint: $(VENV)/installed-lint
	$(RUN) -m flake8
	$(RUN) -m mypy
	$(RUN) -m pydocstyle $(PEP257) setup.py persem_ros test $(wildcard benchmarks examples launch)

test-matrix:
	PYTHON=$(PYTHON) .ci/test-matrix $(ARGS)

ros-test:
	.ci/ros-test $(ARGS)

bench-live:
	.ci/bench-live $(ARGS)

night: $(VENV)/installed-test
	$(RUN) benchmarks/night.py build/night $(ARGS)

night-live:
	SCRIPT=benchmarks/night.py .ci/bench-live build/night --node $(ARGS)

MINUTES ?= 30

fuzz: $(VENV)/installed-test
	$(RUN) test/fuzz/fuzz.py --minutes $(MINUTES) $(if $(SEED),--seed $(SEED)) $(ARGS)

MOMENTS ?= 200

signals: $(VENV)/installed-test
	PERSEM_SIGNALS=$(MOMENTS) $(RUN) -m pytest -q test/commands/test_signals.py test/commands/test_streams.py $(ARGS)

docs: $(VENV)/installed-docs
	$(RUN) -m sphinx -W --keep-going -q -b html docs build/site

docs-links: $(VENV)/installed-docs
	$(RUN) -m sphinx -q -b linkcheck docs build/links

clean:
	rm -rf .venv .venv-* build install log demo *.egg-info .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# One stamp an extra; pip runs again only when the requirements may have changed.
$(VENV)/installed: setup.py setup.cfg | $(RUN)
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/installed-%: setup.py setup.cfg | $(RUN)
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable '.[$*]'
	@touch $@

$(RUN):
	@PYTHON=$(PYTHON) .ci/make-venv $(VENV)
