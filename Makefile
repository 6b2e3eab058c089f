# `make demo` and `make test` do all their own set-up on a fresh Debian or Ubuntu machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
LAB := tests/lab/lab
# What needs a bus runs in the lab, the faults in a lab for each kind of bus.
BUS_ROOMS := vcan lab faults/vcan faults/slcan faults/netem
NO_BUS := $(addprefix --ignore=tests/,$(BUS_ROOMS))
IN_LAB := $(LAB) run --env VCU_REQUIRE_CAN=1
WITH_SLCAN := --modules slcan
WITH_NETEM := --module-param vcan:echo=1 --modules "sch_netem sch_tbf"
# Too slow under coverage's eyes, and the other tests cover the same lines.
EXHAUSTIVE := tests/core/test_exhaustive.py

.PHONY: help setup demo test test-quick test-core test-rest test-more test-vcan test-on-bus test-faults lint nightly soak faults mutants bench lock clean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build .venv with the program and its tools

$(STAMP): pyproject.toml requirements.lock requirements-dev.lock scripts/setup
	@scripts/setup $(PYTHON) $(VENV)
	@touch $@

demo: setup  ## gateway and simulated vehicle with a live table, without hardware
	@$(BIN)/vcu-gateway demo

test: setup lint test-quick test-vcan  ## everything: lint, types, tests, tests on a real vcan0

test-quick: setup  ## the tests that need no CAN, two runs at a time
	-@scripts/test-tools
	@$(MAKE) --no-print-directory -j2 --output-sync=target test-rest test-core test-more

test-core: setup
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -m 'not slow' tests/core --ignore=$(EXHAUSTIVE)
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/core/*' --fail-under=100

test-rest: setup
	$(BIN)/pytest -q -m 'not slow' tests --ignore=tests/core --ignore=tests/watch --ignore=tests/faults $(NO_BUS)

test-more: setup
	$(BIN)/pytest -q -m 'not slow' tests/watch tests/faults/pure
	$(BIN)/pytest -q $(EXHAUSTIVE)

test-vcan: setup  ## the tests on a real vcan0, in the lab where the kernel has no CAN
	$(LAB) install
	$(BIN)/pytest tests/lab
	@$(MAKE) --no-print-directory -j2 --output-sync=target test-on-bus test-faults

test-on-bus: setup
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -m 'not slow' tests/vcan
	$(IN_LAB) --timeout 300 $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan
	$(IN_LAB) --timeout 300 $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem

test-faults: setup
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan

nightly: setup  ## the long tests: deep invariants, ten minutes on vcan0
	scripts/test-tools
	VCU_REQUIRE_PROMTOOL=1 HYPOTHESIS_PROFILE=nightly $(BIN)/pytest $(NO_BUS)
	$(LAB) install
	$(IN_LAB) --timeout 2400 -- $(BIN)/pytest -s tests/vcan tests/faults/vcan
	$(IN_LAB) --timeout 900 $(WITH_SLCAN) -- $(BIN)/pytest tests/faults/slcan
	$(IN_LAB) --timeout 900 $(WITH_NETEM) -- $(BIN)/pytest tests/faults/netem
	$(MAKE) soak MINUTES=60

MINUTES := 10
soak: setup  ## nominal traffic with random faults for MINUTES=10, in the lab
	$(LAB) install
	$(LAB) run --timeout $$(( $(MINUTES) * 60 + 180 )) -- $(BIN)/python -m tests.faults.soak --minutes $(MINUTES)

FAULTS := build/faults
faults: setup  ## every fault that the gateway survives; writes docs/faults.md
	rm -rf $(FAULTS)
	$(LAB) install
	-VCU_FAULT_RESULTS=$(FAULTS) $(BIN)/pytest -q -m 'not slow' tests/faults/pure
	-$(IN_LAB) --timeout 900 --env VCU_FAULT_RESULTS=$(FAULTS) -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem
	$(BIN)/python -m tests.faults.page $(FAULTS)

mutants: setup  ## change the safety core on purpose: every mistake must turn a test red
	scripts/mutants $(BIN)

lint: setup  ## style, types, import contracts, generated files
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/vcu-gateway dbc --check

bench: setup  ## compare with the naive way; writes docs/benchmarks.md
	$(BIN)/python -m bench

lock: setup  ## resolve and hash the dependencies again
	scripts/lock $(BIN)

clean:  ## remove what was built
	rm -rf $(VENV) build dist .coverage* .mypy_cache .ruff_cache .pytest_cache .hypothesis
