# Two commands do everything on a fresh machine with python3 >= 3.11, python3-venv, make and git:
#   make run    sets up .venv and runs the main job
#   make test   sets up .venv, checks the code, runs the tests, and reports a short live run
# and make bench measures everything at length, for about an hour.
.PHONY: run test check bench
BIN := .venv/bin
READY := .venv/.ready

run: $(READY)
	$(BIN)/rcmservo run

test: check
	$(BIN)/pytest
	$(BIN)/python benchmarks/soak.py --seconds 10
	-$(BIN)/python benchmarks/kill.py --count 4

check: $(READY)
	$(BIN)/ruff format --check --quiet src tests benchmarks examples docs
	$(BIN)/ruff check --quiet src tests benchmarks examples docs
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

bench: $(READY)
	$(BIN)/python benchmarks/step_time.py
	$(BIN)/python benchmarks/tracking.py 150
	$(BIN)/python benchmarks/settle.py
	$(BIN)/python benchmarks/campaign.py faults
	$(BIN)/python benchmarks/campaign.py short
	$(BIN)/python benchmarks/campaign.py none
	$(BIN)/python benchmarks/occlusion.py
	$(BIN)/python benchmarks/replays.py 100
	$(BIN)/python benchmarks/damage.py
	$(BIN)/python benchmarks/fuzz.py --count 100000
	$(BIN)/python benchmarks/soak.py --seconds 600
	$(BIN)/python benchmarks/kill.py --count 200

$(READY): pyproject.toml
	python3 -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $(READY)
