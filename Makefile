# Everything runs in .venv, made from constraints.txt. Another interpreter: make test PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
TYPED := build/typed/seqsweep

.PHONY: demo test lint docs evidence bench env clean

demo: $(READY)
	@mkdir -p build
	$(BIN)/seqsweep run examples/table1.toml -o build/table1.parquet --force
	$(BIN)/seqsweep show build/table1.parquet --plot build/table1.png

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist loadfile

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

# The heavy trials: they rewrite the figures in docs/. The verdicts take a new seed every time.
evidence: $(READY)
	$(BIN)/python -m pytest -n 2 -m evidence
	$(BIN)/python benchmarks/verdicts.py --tables 3500 --swept 0.6 --calibration 2000 --jobs 2 --write --check

bench: $(READY)
	$(BIN)/python benchmarks/run_all.py

env: $(READY)

$(READY): pyproject.toml constraints.txt
	@command -v $(PYTHON) > /dev/null || \
	  { echo "$(PYTHON) not found: name a Python 3.11 or newer, as in 'make $(MAKECMDGOALS) PYTHON=python3.11'" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is older than Python 3.11: name a newer one, as in 'make $(MAKECMDGOALS) PYTHON=python3.11'" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2> /dev/null || \
	  { echo "$(PYTHON) cannot make environments: run 'apt-get install python3-venv' (as root), then again" >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,docs,dask,fmu,exchange,excel,formats]' -c constraints.txt
	@touch $@

clean:
	rm -rf $(VENV) build dist docs/generated docs/gallery docs/notebooks *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
