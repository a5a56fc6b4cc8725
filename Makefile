# Two commands do all the set-up, without root: `make demo` and `make test`.
# All they make lies in this folder, apart from what pip, PoCL and Matplotlib keep in the user's own cache.

# A Python of 3.11 or later; `make PYTHON=/path/to/python demo` names another.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3.14 python3 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
# The extra that brings OpenCL on the CPU; `make POCL= demo` does without, on a system that has its own.
POCL ?= pocl
PYTEST_ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
comma := ,

.PHONY: help demo reproduce test test-slow test-all lint format bench bench-smoke clean
# Two installs at once into one environment would break it.
.NOTPARALLEL:
.DELETE_ON_ERROR:

help:
	@echo 'make demo      human bodies that were in no training set, into out/demo'
	@echo 'make reproduce the experiments of the paper and the forward check, into out/reproduce'
	@echo 'make test      the tests, less the slow ones (make test-slow, make test-all)'
	@echo 'make lint      ruff and mypy; make format mends what ruff can'
	@echo 'make bench     every case against its contenders, into out/bench (make bench-smoke only checks that they run)'
	@echo 'make clean     removes all that the others made, .venv included'

reproduce: $(VENV)/.has-fem
	$(BIN)/accel-shapegen reproduce all --out out/reproduce

demo: $(VENV)/.has-demo
	$(BIN)/accel-shapegen demo --out out/demo

test: $(VENV)/.has-test
	$(BIN)/python -m pytest $(PYTEST_ARGS)

test-slow: $(VENV)/.has-test
	$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

test-all: $(VENV)/.has-test
	$(BIN)/python -m pytest -m 'slow or not slow' $(PYTEST_ARGS)

lint: $(VENV)/.has-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.has-lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.has-bench
	$(BIN)/python -m bench --out-dir out/bench

bench-smoke: $(VENV)/.has-bench
	$(BIN)/python -m bench --quick --json out/bench/quick.json

clean:
	rm -rf $(VENV) out build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

EXTRAS_demo = $(POCL),plot
EXTRAS_test = $(POCL),test
EXTRAS_lint = lint
EXTRAS_fem = $(POCL),plot,fem
EXTRAS_bench = $(POCL),bench

# Editable, since Python started in this folder would find the folder before an installed copy.
# One stamp for each set of extras: pip runs again only when pyproject.toml has changed.
$(VENV)/.has-%: pyproject.toml $(VENV)/.made
	@echo 'installing accel-shapegen[$(patsubst $(comma)%,%,$(EXTRAS_$*))] into $(VENV) ...'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[$(patsubst $(comma)%,%,$(EXTRAS_$*))]' || { status=$$?; \
		echo 'The OpenCL wheel behind the extra "pocl" is made for Linux on x86_64. If that was missing: install' >&2; \
		echo 'an OpenCL driver of your system (Debian: pocl-opencl-icd) and run `make POCL= $*`.' >&2; exit $$status; }
	@touch $@

# A Python that was split from its ensurepip (Debian without python3-venv) still has a pip, of any age, to fill .venv with.
$(VENV)/.made:
	@test -n '$(PYTHON)' || { echo 'no Python of 3.11 or later on PATH; name one: make PYTHON=/path/to/python3.11' >&2; exit 1; }
	@'$(PYTHON)' -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed, this is " + sys.version)'
	@'$(PYTHON)' -m venv --clear $(VENV) >/dev/null 2>&1 || { '$(PYTHON)' -m venv --clear --without-pip $(VENV) \
		&& '$(PYTHON)' -m pip install --quiet --target $(VENV)/bootstrap pip \
		&& PYTHONPATH=$(VENV)/bootstrap $(BIN)/python -m pip install --quiet --force-reinstall pip \
		&& rm -rf $(VENV)/bootstrap; }
	@echo '$(CURDIR)' >$@

# A folder that was moved or copied, or a Python that is gone, leaves an environment that points elsewhere.
ifneq ($(shell cat $(VENV)/.made 2>/dev/null && $(BIN)/python -c '' 2>/dev/null),$(CURDIR))
$(shell rm -f $(VENV)/.made)
endif
