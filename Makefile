# `make demo` and `make test` work on a fresh clone with Python 3.11 and make; see README.md.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
# Linux machines without an NVIDIA card save about 3 GB with
#   make demo TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	$(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX))

.PHONY: demo test stress kills lint types docs bench-engine bench-error bench-left-out bench-photos bench-priors fuzz new-plugins results check clean help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.runtime ## three photographs to a scored scene, in minutes
	$(BIN)/stereogs demo

test: $(VENV)/.dev ## the test suite
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal

stress: $(VENV)/.dev ## 10,000 poisoned scenes through the engine, new ones each time
	STRESS_SCENES=10000 $(BIN)/python -m pytest tests/core_rasterizer/test_poison.py --timeout 7200

kills: $(VENV)/.dev ## 50 runs killed with SIGKILL at random moments and resumed, new ones each time
	KILLS=50 $(BIN)/python -m pytest -s tests/registry/runs/test_kills.py --timeout 7200

fuzz: $(VENV)/.dev ## 100,000 damaged files of each format through its reader, an hour; resumable
	$(BIN)/python -m tests.fuzzing 100000

new-plugins: $(VENV)/.dev ## a package of each kind, installed by pip, tested by its own tests and trained; minutes
	NEW_PLUGINS=all $(BIN)/python -m pytest tests/registry/plugins/test_scaffolding.py

lint: $(VENV)/.dev ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev ## mypy, strict
	$(BIN)/mypy

docs: $(VENV)/.dev ## docs/components.md and pipelines/pipeline.schema.json, written from the code
	$(BIN)/python docs/make_reference.py
	$(BIN)/stereogs schema > pipelines/pipeline.schema.json

bench-engine: $(VENV)/.dev ## how long the engine takes, beside named baselines
	$(BIN)/python -m benchmarks.engine

bench-error: $(VENV)/.dev ## run time against error, one switch at a time; rewrites its page in docs
	$(BIN)/python -m benchmarks.error --write-docs

bench-priors: $(VENV)/.dev ## sgm and plane_sweep against the truth; rewrites its page in docs
	$(BIN)/python -m benchmarks.priors --write-docs

bench-left-out: $(VENV)/.dev ## the weight-free pipeline on training views left out: how choices are made
	$(BIN)/python -m benchmarks.left_out

bench-photos: $(VENV)/.dev ## cameras that are found against published ones; rewrites its table in docs; resumable
	$(BIN)/python -m benchmarks.photos --write-docs

results: $(VENV)/.dev ## two pipelines on every data set in STEREOGS_DATA; rewrites its page in docs; resumable
	$(BIN)/python -m benchmarks.results --write-docs

check: test lint types ## everything that must hold

clean: ## remove the environment and what was built
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache

# The environment is rebuilt only when what it is made from has changed.
$(VENV)/.runtime: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	@echo "installing into $(VENV) (a few minutes the first time)"
	$(PIP) --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	$(PIP) --editable '.[dev,heic,plot,video]'
	@touch $@
