# Everything a person or CI does, one word each. Needs Python 3.11 or newer and make.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
EXAM_SEED ?= 1
STAMP := $(VENV)/.installed
.DEFAULT_GOAL := help
.PHONY: help docs pictures demo test test-bench test-long test-oldest test-newest check speed studies exam release clean install

help: ## list the targets
	@awk -F':.*## ' '/^[a-z-]+:.*## /{printf "  make %-11s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "loopshape needs Python 3.11 or newer; set PYTHON=python3.x"; exit 2; }
	@echo "loopshape and its tools go into $(VENV): 2 GB, one to three minutes"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $(STAMP)

install: $(STAMP) ## make the environment in .venv

pictures: $(STAMP) ## draw the pictures of README and docs anew (needs Chromium)
	$(BIN)/python docs/pictures.py

demo: $(STAMP) ## the main job: identify, fit, tune and check the simulated arm and a real bench; figures in demo/
	$(BIN)/loopshape demo --out demo

docs: $(STAMP) ## build the documentation site into build/docs; every warning is an error
	@echo "the examples of the gallery and the notebooks run first: a minute and a half"
	@$(BIN)/python -m sphinx -W --keep-going -q -b html -d build/doctrees docs build/docs
	@echo "build/docs/index.html"

# A worker a core, each with whole files while it has them: what a file's tests share is made once, not on every worker.
WORKERS = -n auto --dist worksteal
test: $(STAMP) ## run the tests
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest $(WORKERS) tests  # libraries add no threads

BENCH = build/bench
test-bench: $(STAMP) ## the tests of the bench, with no toolbox that could be imported
	$(BIN)/python .ci/bench.py $(BENCH)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONSAFEPATH=1 PYTHONPATH=$(abspath $(BENCH)) $(BIN)/pytest $(WORKERS) --ignore tests/toolbox tests

LONG ?= long
test-long: $(STAMP) ## run the tests of minutes: draws by the hundred, kills, damaged files, bad lines; LONG="long and not hour" for what CI runs
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest $(WORKERS) -m "$(LONG)" tests

# Old libraries warn of newer ones: there a warning is no failure.
SHORT = -m pytest $(WORKERS) -m short -o filterwarnings=default -W ignore --timeout 600 tests
EXTRAS = -e '.[uff,mdf,ulog,tdms,ros,fmu,mujoco,cluster,serial]'
RUNNER = pytest pytest-timeout pytest-xdist hypothesis markdown-it-py mcap-protobuf-support
UV := $(BIN)/uv --quiet --no-python-downloads

test-oldest: $(STAMP) ## a short part of the tests on the lowest versions that pyproject allows, in .venv-oldest
	$(UV) venv --clear --python $(BIN)/python .venv-oldest
	$(UV) pip install --python .venv-oldest --resolution lowest-direct $(EXTRAS)
	$(UV) pip install --python .venv-oldest $(RUNNER)
	OMP_NUM_THREADS=1 .venv-oldest/bin/python $(SHORT)

# uv sees what is on PATH; pyenv keeps its versions beside it. PYTHON_NEWEST=3.x or a path chooses one.
PYTHON_NEWEST ?= $(shell ls -d $(HOME)/.pyenv/versions/3.*/bin/python 2>/dev/null | sort -V | tail -1)
test-newest: $(STAMP) ## the same on the newest Python here (PYTHON_NEWEST) and the newest versions, in .venv-newest
	$(UV) venv --clear --python $(or $(PYTHON_NEWEST),'>=3.12') .venv-newest || \
	  { echo "no Python newer than this one is here: the newest versions are tried on it"; $(UV) venv --clear --python $(BIN)/python .venv-newest; }
	$(UV) pip install --python .venv-newest --upgrade $(EXTRAS) $(RUNNER)
	OMP_NUM_THREADS=1 .venv-newest/bin/python $(SHORT)

check: $(STAMP) ## ruff, the type checker, who may import whom, and that the house stays as small as it is
	$(BIN)/ruff check loopshape tests experiments examples docs .ci
	$(BIN)/ruff format --check loopshape tests experiments examples docs .ci
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/house.py

speed: $(STAMP) ## benchmarks against peers (needs a C compiler); no gate
	$(BIN)/python tests/speed/run.py

STUDIES ?= --all
studies: $(STAMP) ## all studies under experiments/ but the exam, within an hour on two cores; installs the extra `learning` (5 GB); STUDIES="pwm qube" runs these
	$(if $(filter --all learning,$(STUDIES)),$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[learning]")
	$(BIN)/python experiments/lab/studies.py $(STUDIES)

exam: $(STAMP) ## diagnose arms with sealed effects and score the answers (an hour or so); EXAM_SEED=n draws another exam
	$(BIN)/python experiments/lab/exam.py --out experiments/exam/seed-$(EXAM_SEED) --seed $(EXAM_SEED)

release: $(STAMP) ## the checklist of a release: sdist, wheel and conda package, each tried in a clean place; WITHOUT_CONDA=0 without rattler-build
	PYTHON=$(BIN)/python .ci/release

clean: ## remove caches (compiled kernels too) and the demo
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
	rm -rf demo docs/made docs/reference .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build *.egg-info
