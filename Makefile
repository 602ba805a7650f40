# Every target sets up what it needs in .venv, once, and again when pyproject.toml changes.
#
#   make train [SEED=0] [TRIALS=4] [OUT=folder]     make test [ARGS="-k kernels"]

PYTHON ?= python3
TORCH  := torch==2.13.0
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip -qq install
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder

# A stamp says which part of the package is installed.
ENV_READY  := $(VENV)/.stamp-$(subst ==,-,$(TORCH))
CORE_READY := $(VENV)/.stamp-core
DEV_READY  := $(VENV)/.stamp-dev
DOCS_READY := $(VENV)/.stamp-docs

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help train test test-slow test-claims check format docs stale clean

help: ## say what there is
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 20

train: $(CORE_READY) ## learn the cart-pole swing-up; SEED, TRIALS and OUT are optional
	$(BIN)/mcpilco train $(if $(SEED),--seed $(SEED)) $(if $(TRIALS),--trials $(TRIALS)) $(if $(OUT),--out "$(OUT)")

# One thread for each of two workers: small matrices do not gain from more.
test test-slow test-claims: export OMP_NUM_THREADS := 1
test test-slow test-claims: export OPENBLAS_NUM_THREADS := 1
test test-slow test-claims: export MKL_NUM_THREADS := 1
# Many tests start processes, and each would compile the package again.
test test-slow test-claims: export PYTHONDONTWRITEBYTECODE :=

test: $(DEV_READY) ## run the tests that take seconds
	$(PYTEST) -m "not slow" $(ARGS)

test-slow: $(DEV_READY) ## run the tests that take minutes
	$(PYTEST) -m slow $(ARGS)

test-claims: $(DEV_READY) ## run the tests of what the project stands for, some minutes
	$(PYTEST) -m claim $(ARGS)

check: $(DEV_READY) ## look at format, style, types, spelling and imports; change nothing
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/lint-imports

format: $(DEV_READY) ## format the code and mend what can be mended
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

docs: $(DOCS_READY) ## build the documentation into site/
	$(BIN)/python docs/build_reference.py
	$(BIN)/zensical build --strict --clean

stale: $(DEV_READY) ## list the tables of runs/ that are not of today's code
	@$(BIN)/python runs/stale.py $(ARGS)

clean: ## remove what the targets made, but for .venv and the runs
	rm -rf site docs/reference dist build .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache
	find mcpilco envs baselines tests -name __pycache__ -prune -exec rm -rf {} +

# torch comes first and by version: the other packages then take it as it is.
$(ENV_READY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "mcpilco needs Python 3.11 or newer; name one: make PYTHON=python3.11"; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv $(VENV)
	@echo "Installing $(TORCH) into $(VENV): some minutes, once."
	$(PIP) "$(TORCH)"
	@touch $@

$(CORE_READY): pyproject.toml $(ENV_READY)
	$(PIP) -e ".[report]"
	@touch $@

$(DEV_READY): $(CORE_READY)
	$(PIP) -e ".[dev]"
	@touch $@

$(DOCS_READY): $(CORE_READY)
	$(PIP) -e ".[docs]"
	@touch $@
