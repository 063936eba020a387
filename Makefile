# Two commands do everything on a fresh machine with python3 >= 3.11, python3-venv, make and git:
#   make run    sets up .venv and runs the main job
#   make test   sets up .venv, checks the code and runs the tests
.PHONY: run test check bench
BIN := .venv/bin
READY := .venv/.ready

run: $(READY)
	$(BIN)/rcmservo run

test: check
	$(BIN)/pytest

check: $(READY)
	$(BIN)/ruff format --check --quiet src tests benchmarks examples docs
	$(BIN)/ruff check --quiet src tests benchmarks examples docs
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

bench: $(READY)
	$(BIN)/python benchmarks/step_time.py
	$(BIN)/python benchmarks/tracking.py 150
	$(BIN)/python benchmarks/settle.py

$(READY): pyproject.toml
	python3 -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $(READY)
