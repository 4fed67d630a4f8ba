# Everything runs in .venv, made from constraints.lock. Another interpreter: make test PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
TYPED := build/typed/seqsweep
EXTRAS := test docs dask fmu exchange excel formats

.PHONY: demo test lint docs evidence bench env lock audit clean

demo: $(READY)
	@mkdir -p build
	$(BIN)/seqsweep run examples/table1.toml -o build/table1.parquet --force
	$(BIN)/seqsweep show build/table1.parquet --plot build/table1.png

# Three workers on two cores: tests that wait for a time limit or for a process to end leave a core to others.
# Byte code first, also where PYTHONDONTWRITEBYTECODE is set: the tests begin hundreds of processes.
test: $(READY)
	$(BIN)/python -m compileall -q seqsweep plant identify tuning sweep
	$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder --durations=20 --durations-min=1

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@rm -rf build/typed && mkdir -p build/typed && cp -R seqsweep plant identify tuning sweep build/typed/
	@mv build/typed/plant build/typed/identify build/typed/tuning build/typed/sweep $(TYPED)/
	$(BIN)/mypy
	cd build/typed && ../../$(BIN)/lint-imports --no-cache --config ../../pyproject.toml

# The site, in build/site: every command on its pages is run, and what it prints is written into them; warnings are errors.
docs: $(READY)
	$(BIN)/python docs/site/executed.py
	@rm -rf build/site
	$(BIN)/python -m sphinx -W --keep-going -q -b html -d build/doctrees docs build/site
	$(BIN)/python docs/site/held.py build/site
	@echo "open build/site/index.html"

# The heavy trials: they rewrite the figures in docs/, with a new seed every time. One that misses a bar stops no other.
evidence: $(READY)
	@failed=0; set -x; \
	$(BIN)/python -m pytest -n 2 -m evidence || failed=1; \
	$(BIN)/python benchmarks/verdicts.py --tables 3500 --swept 0.6 --calibration 2000 --jobs 2 --write --check || failed=1; \
	$(BIN)/python benchmarks/surrogate.py --designs 200 --covered 200 --pairs 1000 --grids 100 --searches 20 --placements 50 \
	  --runs 1 --campaigns 1 --rivals 1 --jobs 2 --write --check || failed=1; \
	exit $$failed

bench: $(READY)
	$(BIN)/python benchmarks/run_all.py

env: $(READY)

$(READY): pyproject.toml constraints.lock
	@command -v $(PYTHON) > /dev/null || \
	  { echo "$(PYTHON) not found: name a Python 3.11 or newer, as in 'make $(MAKECMDGOALS) PYTHON=python3.11'" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is older than Python 3.11: name a newer one, as in 'make $(MAKECMDGOALS) PYTHON=python3.11'" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2> /dev/null || \
	  { echo "$(PYTHON) cannot make environments: run 'apt-get install python3-venv' (as root), then again" >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r constraints.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# The check sums of all files of the versions in constraints.txt, and the list of what everything stands on.
lock: constraints.txt pyproject.toml
	@test -x build/uv/bin/uv || { $(PYTHON) -m venv build/uv && build/uv/bin/pip install --quiet uv==0.13.9; }
	echo 'setuptools>=77' | build/uv/bin/uv pip compile --quiet --generate-hashes --no-annotate --no-header --no-emit-index-url \
	  --python-version 3.11 -c constraints.txt $(EXTRAS:%=--extra %) pyproject.toml - -o constraints.lock
	$(MAKE) $(READY)
	$(BIN)/python supply/dependencies.py

audit: $(READY)
	$(BIN)/python supply/audit.py

clean:
	rm -rf $(VENV) build dist docs/generated docs/gallery docs/notebooks *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
