# `make demo` and `make test` work on a fresh clone with Python 3.11 and make; see README.md.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
VIEWER := stereogs_plugins/reports/html/viewer
BIN := $(VENV)/bin
# Without bytecode each of hundreds of processes would compile the sources again.
unexport PYTHONDONTWRITEBYTECODE
# Linux machines without an NVIDIA card save about 3 GB with
#   make demo TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	$(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX))

# PoCL from pip does not know the newest processors; Intel's runtime, also from pip, does.
BUILDS := import torch, core_rasterizer as engine; engine.list_devices()[0].program(dtype=torch.float32)

RELEASE := $(if $(TORCH_INDEX),PIP_EXTRA_INDEX_URL=$(TORCH_INDEX)) $(BIN)/python -m tests.release

.PHONY: demo test proofs tutorial notebook nerfbaselines browser cluster loggers new-plugins \
	package pythons runtimes races stress kills fuzz sick mutants lint types check docs site flight viewer-bundle \
	methods parts results curve profile gpu \
	bench-engine bench-error bench-growth bench-skips bench-left-out bench-next bench-photos bench-priors bench-confidence clean help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.runtime ## three photographs to a scored scene, in minutes
	$(BIN)/stereogs demo

# COVERAGE=1 also prints the share of lines and branches that this process and its workers run, by package.
test: $(VENV)/.dev ## the test suite
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal $(if $(COVERAGE),--cov --cov-report=)
	$(if $(COVERAGE),@for package in core_rasterizer registry stereogs stereogs_plugins; do \
		echo "coverage of $$package: $$($(BIN)/coverage report --include="$$package/*" --format=total) %"; done)

proofs: $(VENV)/.dev ## the tests that take longest: real photographs and networks, killed runs, all methods
	$(BIN)/python -m pytest -m proof --numprocesses 2 --dist worksteal --timeout 1800

tutorial: $(VENV)/.dev ## the tutorial's commands as written; one of the proofs
	$(BIN)/python -m pytest -m proof tests/test_tutorial.py --timeout 1800

notebook: $(VENV)/.dev ## the notebook in docs/examples, cell by cell; one of the proofs
	$(BIN)/python -m pytest -m proof tests/test_notebook.py

# Without what it depends on: it asks for numpy 1, and works with numpy 2.
nerfbaselines: $(VENV)/.dev ## the method wrapper for NerfBaselines against the real package
	$(PIP) --no-deps --upgrade --target $(VENV)/nerfbaselines nerfbaselines tqdm click
	PYTHONPATH=$(VENV)/nerfbaselines $(BIN)/python -m pytest tests/stereogs/nerfbaselines

flight: $(VENV)/.runtime ## the README's moving picture, made anew
	$(BIN)/python docs/images/make_flight.py

stress: $(VENV)/.dev ## 10,000 poisoned scenes through the engine, new ones each time
	STRESS_SCENES=10000 $(BIN)/python -m pytest tests/core_rasterizer/test_poison.py --timeout 7200

kills: $(VENV)/.dev ## 50 runs killed with SIGKILL at random moments and resumed, new ones each time
	KILLS=50 $(BIN)/python -m pytest -m proof -s tests/registry/runs/test_kills.py --timeout 7200

fuzz: $(VENV)/.dev ## 100,000 damaged files of each format through its reader, an hour; resumable
	$(BIN)/python -m tests.fuzzing 100000

sick: $(VENV)/.dev ## 252 components with one fault each, and what the host says about them; minutes
	$(BIN)/python -m tests.sick

mutants: $(VENV)/.dev ## 120 changes of one place each, which tests must notice; an hour; resumable
	$(BIN)/python -m tests.mutants

# Fetched into build/runtimes with apt-get and pip, installed nowhere; skipped with a reason without a network.
runtimes: $(VENV)/.dev ## the engine's tests on other OpenCL runtimes, fetched first; up to an hour
	$(BIN)/python -m tests.runtimes $(RUNTIMES)

races: $(VENV)/.dev ## all kernels in the simulator oclgrind, fetched first, which finds races; minutes
	$(BIN)/python -m tests.runtimes.races

new-plugins: $(VENV)/.dev ## a package of each kind, installed by pip, tested by its own tests and trained; minutes
	NEW_PLUGINS=all $(BIN)/python -m pytest tests/stereogs/verbs/test_new_plugin.py --timeout 1800

package: $(VENV)/.dev ## wheels and sdists in dist/, installed into an empty environment and used there; minutes
	$(PIP) build twine
	$(RELEASE)

# TESTS=tests runs all of them.
pythons: $(VENV)/.dev ## tests against the built wheels on each Python from 3.11 that is installed; up to an hour
	$(PIP) build twine
	$(RELEASE).pythons $(TESTS)

loggers: $(VENV)/.dev ## the loggers against the packages that they log with, which are large; minutes
	$(PIP) --editable '.[mlflow,rerun,tensorboard,wandb]'
	$(BIN)/python -m pytest tests/stereogs_plugins/observers

# The tools for S3 need an older dateutil than constraints.txt names.
cluster: $(VENV)/.dev ## runs on processes that share a folder, on Ray and on submitit, some killed or without data; S3; minutes
	$(PIP) --editable '.[dev,cluster,slurm]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check s3fs 'moto[server]>=5'
	CLUSTER=1 $(BIN)/python -m pytest -m 'proof or not proof' tests/stereogs_plugins/runners tests/stereogs/experiments/test_sharing.py \
		tests/registry/toolkit/cache/test_remote.py tests/registry/runs/test_remote_runs.py

lint: $(VENV)/.dev ## rules and format of Python, format of kernels, workflow files by their schema
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror core_rasterizer/*/kernels/*.cl
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.dependabot .github/dependabot.yml

types: $(VENV)/.dev ## mypy, strict; what is shipped also as on Windows
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/windows core_rasterizer registry stereogs stereogs_plugins

docs: $(VENV)/.dev ## pipelines/pipeline.schema.json, generated from the code
	$(BIN)/stereogs schema > pipelines/pipeline.schema.json

site: $(VENV)/.docs ## the documentation as a site in build/site; opens without a network
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

methods: $(VENV)/.dev ## every published method under one protocol, hours; rewrites tables; resumable
	$(BIN)/python -m benchmarks.campaigns methods --write-docs

parts: $(VENV)/.dev ## StereoGS's parts, three seeds, hours; rewrites tables; resumable
	$(BIN)/python -m benchmarks.campaigns parts --write-docs

bench-engine: $(VENV)/.dev ## time of the engine, compared with named baselines
	$(BIN)/python -m benchmarks.engine

# gsplat is compiled on first use, which takes a CUDA compiler and minutes. Without a network the one in .venv/gsplat is used.
gpu: $(VENV)/.dev ## the engine on a GPU beside gsplat on the same card, at most eight minutes; rewrites tables
	-$(PIP) --no-deps --upgrade --target $(VENV)/gsplat gsplat ninja
	PYTHONPATH=$(VENV)/gsplat $(BIN)/python -m pytest tests/core_rasterizer/test_against_gsplat.py
	PATH="$(CURDIR)/$(VENV)/gsplat/bin:$$PATH" PYTHONPATH=$(VENV)/gsplat $(BIN)/python -m benchmarks.gpu --write-docs

bench-error: $(VENV)/.dev ## run time against error, one switch at a time; rewrites tables
	$(BIN)/python -m benchmarks.error --write-docs

bench-priors: $(VENV)/.dev ## accuracy of sgm, plane_sweep and patch_match; rewrites tables
	$(BIN)/python -m benchmarks.priors --write-docs

bench-left-out: $(VENV)/.dev ## weightfree_fast on training views left out, to compare variants
	$(BIN)/python -m benchmarks.left_out plain

bench-next: $(VENV)/.dev ## the next photograph, chosen by rules and trained, half an hour; rewrites its table; resumable
	$(BIN)/python -m benchmarks.next_views --write-docs

bench-photos: $(VENV)/.dev ## estimated cameras compared with published ones; rewrites its table; resumable
	$(BIN)/python -m benchmarks.photos --write-docs

bench-confidence: $(VENV)/.dev ## how well confidence predicts errors of test views; rewrites tables; resumable
	$(BIN)/python -m benchmarks.confidence --write-docs

bench-skips: $(VENV)/.dev ## time and PSNR of each shortcut of a pipeline, over an hour; rewrites tables; resumable
	$(BIN)/python -m benchmarks.campaigns skips --write-docs

bench-growth: $(VENV)/.dev ## CPU time and memory with 3 to 300 views; rewrites a table
	$(BIN)/python -m benchmarks.growth --write-docs

profile: $(VENV)/.dev ## time of each stage of weightfree_fast; rewrites its table
	$(BIN)/python -m benchmarks.where_seconds_go --write-docs

curve: $(VENV)/.dev ## a page with error against seconds; needs an idle machine
	$(BIN)/stereogs bench benchmarks/curve.yaml --out benchmarks/out/curve

results: $(VENV)/.dev ## four pipelines on every data set, up to three seeds, hours; rewrites tables; resumable
	$(BIN)/python -m benchmarks.campaigns results --write-docs

browser: $(VENV)/.dev ## every page in Chromium, which must be on PATH; screenshots in tests/browser/screenshots
	BROWSER=1 $(BIN)/python -m pytest tests/browser --timeout 1200

viewer-bundle: ## the 3D view of reports, bundled by npm from the versions in its package-lock.json
	cd $(VIEWER) && npm ci --no-audit --no-fund && npm run bundle && npm run licenses
	rm -r $(VIEWER)/node_modules

check: test lint types ## everything that must hold

clean: ## remove the environment and what was built
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache

# The environment is rebuilt only when what it is made from has changed.
$(VENV)/.runtime: pyproject.toml core_rasterizer/pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	@echo "installing into $(VENV) (a few minutes the first time)"
	$(PIP) --editable ./core_rasterizer --editable '.[video]'
	@$(BIN)/python -c '$(BUILDS)' 2> /dev/null || { \
		echo "no installed OpenCL driver builds kernels for this processor: adding Intel's runtime"; \
		$(PIP) --editable './core_rasterizer[intel]'; }
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	$(PIP) --editable ./core_rasterizer --editable '.[dev,browser,heic,notebook,plot,video,viewer]'
	@touch $@

$(VENV)/.docs: $(VENV)/.dev
	$(PIP) --editable '.[docs]'
	@touch $@
