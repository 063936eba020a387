# On a fresh machine with python3 >= 3.11, python3-venv, make and git each command installs what it
# needs into .venv, once:
#   make run       the simulator and the operator's page, and runs the main job
#   make test      runs the tests except the slow ones
#   make check     runs formatter, linters, spelling, type checker, import contracts and docstrings
#   make test-all  runs the slow tests
#   make peers     installs other people's clients for the tests that are skipped without them
#   make studies   runs the studies behind two pages of docs/, and writes these pages, in 40 minutes
#   make bench     measures everything at length, for about two hours
.PHONY: run kernels test test-all check peers studies bench
BIN := .venv/bin
RUNNING := .venv/.running
STUDYING := .venv/.studying
TESTING := .venv/.testing
PROFILE := quick
PYTEST := $(BIN)/pytest --hypothesis-profile=$(PROFILE)
IN_WALL_TIME := $(addprefix tests/, cameras crtk hardware live page)
PARALLEL := --dist loadfile --no-loadscope-reorder
PIP := $(BIN)/pip install --quiet --quiet --disable-pip-version-check --no-compile
# Tests start many processes: each would compile all Python files that it imports.
kernels test test-all: export PYTHONDONTWRITEBYTECODE :=

run: $(RUNNING)
	$(BIN)/rcmservo run

kernels: $(TESTING)
	$(BIN)/python tests/compile_kernels.py

# PROFILE=thorough tries more Hypothesis examples. Tests in wall time need the machine to
# themselves.
test: kernels
	$(PYTEST) $(PARALLEL) -n 2 -m 'not slow and not alone'
	$(PYTEST) -m 'alone and not slow' $(IN_WALL_TIME)

# Slow tests often wait for processes of their own: three workers keep two processors busy.
test-all: $(TESTING)
	$(PYTEST) $(PARALLEL) -n 3 -m 'slow and not alone'
	$(PYTEST) -m 'alone and slow'

# Of a peer only what its test needs, apart from what the project needs: pandas finds NumPy and Arrow
# there. Polars is in two packages of one version. PyBullet has wheels up to Python 3.11; where it has
# none, its test is skipped.
peers: $(TESTING)
	$(PIP) --no-deps --upgrade --target .peers socs==0.6.4 'pandas>=2.2,<4' 'duckdb>=1.1,<3'
	$(PIP) --upgrade --target .peers 'polars>=1.20,<3'
	-$(PIP) --no-deps --upgrade --only-binary :all: --target .peers pybullet==3.2.7

# They go on where they stopped; the page is not written where they no longer bear a sentence of it.
studies: $(STUDYING)
	$(BIN)/python docs/make_studies.py

check: $(TESTING)
	$(BIN)/ruff format --check --quiet src tests benchmarks examples docs
	$(BIN)/ruff check --quiet src tests benchmarks examples docs
	$(BIN)/codespell src tests benchmarks examples README.md CONTRIBUTING.md docs/architecture.md
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports
	$(PYTEST) --quiet tests/test_docstrings.py

bench: $(TESTING)
	$(BIN)/python benchmarks/step_time.py
	$(BIN)/python benchmarks/study.py
	$(BIN)/python benchmarks/cluster.py
	$(BIN)/python benchmarks/tracking.py 150
	$(BIN)/python benchmarks/settle.py
	$(BIN)/python benchmarks/campaign.py faults
	$(BIN)/python benchmarks/campaign.py short
	$(BIN)/python benchmarks/campaign.py none
	$(BIN)/python benchmarks/unnoticed.py
	$(BIN)/python benchmarks/occlusion.py
	$(BIN)/python benchmarks/replays.py 100
	$(BIN)/python benchmarks/damage.py
	$(BIN)/python benchmarks/fuzz.py --count 100000
	$(BIN)/python benchmarks/cameras.py
	$(BIN)/python benchmarks/whole_loop.py
	$(BIN)/python benchmarks/cable.py
	$(BIN)/python benchmarks/galil.py fuzz
	$(BIN)/python benchmarks/galil.py exchanges
	$(BIN)/python benchmarks/crtk.py stream
	$(BIN)/python benchmarks/crtk.py kill
	$(BIN)/python benchmarks/crtk.py servo 5
	$(BIN)/python benchmarks/rig_check.py --seeds 3
	$(BIN)/python benchmarks/rig_check.py --seeds 1 --camera mjpeg
	$(BIN)/python benchmarks/page_drawn.py
	$(BIN)/python benchmarks/page_stop.py
	$(BIN)/python benchmarks/page_cost.py
	$(BIN)/python benchmarks/page_forged.py
	$(BIN)/python benchmarks/first_use.py
	$(BIN)/python benchmarks/soak.py --seconds 600
	$(BIN)/python benchmarks/kill.py --count 200

# The pip of Debian 12 takes 64 s for what a current one does in 42 s. Nothing that runs here uses
# setuptools (10 MB), which Python before 3.12 puts into each environment, the bytecode of pip (8 MB),
# or the backend of zstandard that PyPy takes (12 MB).
define INSTALL
python3 -m venv .venv
-$(PIP) --upgrade pip
$(PIP) -e '.[$(EXTRAS)]'
$(BIN)/pip uninstall -qq --disable-pip-version-check --yes setuptools
find .venv -path '*/pip/*' -name __pycache__ -prune -exec rm -r {} +
rm -f .venv/lib/python3*/site-packages/zstandard/_cffi.*.so
touch $(INSTALLED)
endef

$(RUNNING): EXTRAS := sim,page
$(STUDYING): EXTRAS := sim,page,study
$(TESTING): EXTRAS := dev
$(RUNNING): INSTALLED := $(RUNNING)
$(STUDYING): INSTALLED := $(RUNNING) $(STUDYING)
$(TESTING): INSTALLED := $(RUNNING) $(STUDYING) $(TESTING)
$(RUNNING) $(STUDYING) $(TESTING): pyproject.toml
	$(INSTALL)
