# make demo   the main job on the simulated laboratory
# make test   the whole test suite
# make bench  the twin's speed, beside the program the paper tested; writes docs/performance.md
# All make the environment first, from requirements.lock.
.PHONY: setup demo test test-fast check bench lock clean
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

lock:
	python3 -m venv build/lock && build/lock/bin/pip install --quiet uv
	build/lock/bin/uv pip compile --universal --python-version 3.11 --generate-hashes --quiet requirements.in -o requirements.lock

clean:
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
