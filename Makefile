# make demo   the main job on the simulated laboratory
# make test   the whole test suite
# make bench  the twin's speed, beside the program the paper tested; writes docs/performance.md
# make judges  programs of others on our simulators, our drivers on theirs; writes docs/judges.md
# make docs   the documentation as a site in build/docs; a broken link is an error
# make reliability   scans that are killed, cut, starved and disturbed; writes docs/reliability.md
# All make the environment first, from requirements.lock.
.PHONY: setup demo test test-fast check bench judges reliability docs lock clean
BIN := .venv/bin
WORKERS ?= 2

setup:
	@tools/setup

demo: setup
	$(BIN)/goniotwin scan --simulate --speed 120

test: setup
	$(BIN)/python -m pytest -m "slow or not slow" -n $(WORKERS) --dist loadfile

test-fast: setup
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	$(BIN)/python benchmarks/bench_tracer.py

judges: setup
	$(BIN)/python benchmarks/judges/run.py

reliability: setup
	$(BIN)/python benchmarks/reliability.py

docs: setup
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

lock:
	python3 -m venv build/lock && build/lock/bin/pip install --quiet uv
	build/lock/bin/uv pip compile --universal --python-version 3.11 --generate-hashes --quiet requirements.in -o requirements.lock

clean:
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
