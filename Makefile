# `make demo` and `make test` do all their own set-up on a fresh Debian or Ubuntu machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
LAB := tests/lab/lab
# What needs a bus runs in the lab, the faults in a lab for each kind of bus.
BUS_ROOMS := vcan lab service faults/vcan faults/slcan faults/netem
NO_BUS := $(addprefix --ignore=tests/,$(BUS_ROOMS))
IN_LAB := $(LAB) run --env VCU_REQUIRE_CAN=1
WITH_SLCAN := --modules slcan
WITH_NETEM := --module-param vcan:echo=1 --modules "sch_netem sch_tbf"
# The installed package, in a Debian of its own under a real systemd.
PACKAGES := build/tests
IN_DEBIAN := $(LAB) run --systemd --env VCU_REQUIRE_SYSTEMD=1 --also $(CURDIR)/$(PACKAGES)
IN_GUEST := $(BIN)/pytest -q -p no:cacheprovider
ORDINARY := -m 'not slow'
# Too slow under coverage's eyes, and the other tests cover the same lines.
EXHAUSTIVE := tests/core/test_exhaustive.py

.PHONY: help setup demo test lane-one lane-two lane-calm test-quick test-core test-rest test-more test-exhaustive \
	test-contents test-guests test-service test-package test-lab test-vcan test-on-bus test-faults lint nightly soak faults mutants bench lock clean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build .venv with the program and its tools

$(STAMP): pyproject.toml requirements.lock requirements-dev.lock scripts/setup
	@scripts/setup $(PYTHON) $(VENV)
	@touch $@

demo: setup  ## gateway and simulated vehicle with a live table, without hardware
	@$(BIN)/vcu-gateway demo

# Two lanes of tests that look at the clock, each with a processor; the third takes what they leave.
test: setup  ## everything: lint, types, tests, the service, the real vcan0
	-@scripts/test-tools
	@$(MAKE) --no-print-directory -j3 --output-sync=target RUN=$$(date +%s%N) lane-one lane-two lane-calm

lane-one:
	@$(MAKE) --no-print-directory test-rest
	@$(MAKE) --no-print-directory test-service
	@$(MAKE) --no-print-directory test-on-bus

lane-two:
	@$(MAKE) --no-print-directory test-more
	@$(MAKE) --no-print-directory test-package
	@$(MAKE) --no-print-directory test-lab
	@$(MAKE) --no-print-directory test-faults

lane-calm:
	@$(MAKE) --no-print-directory test-guests
	@nice $(MAKE) --no-print-directory lint
	@nice $(MAKE) --no-print-directory test-core
	@nice $(MAKE) --no-print-directory test-exhaustive
	@nice $(MAKE) --no-print-directory test-contents

test-quick: setup  ## the tests that need no CAN, two runs at a time
	-@scripts/test-tools
	@$(MAKE) --no-print-directory -j2 --output-sync=target test-rest test-core test-more test-exhaustive

test-core: setup
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -m 'not slow' tests/core --ignore=$(EXHAUSTIVE)
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/core/*' --fail-under=100

test-rest: setup
	$(BIN)/pytest -q -m 'not slow' tests $(addprefix --ignore=tests/,core watch faults packaging) $(NO_BUS)

test-more: setup
	$(BIN)/pytest -q -m 'not slow' tests/watch tests/faults/pure

test-exhaustive: setup
	$(BIN)/pytest -q $(EXHAUSTIVE)

test-contents: setup
	$(BIN)/pytest -q -m 'not slow' tests/packaging

test-guests: setup
	@scripts/test-guests $(BIN) $(PACKAGES) $(RUN)

test-service: setup test-guests  ## the installed service under a real systemd, in the lab
	@[ ! -f $(PACKAGES)/first.deb ] || $(IN_DEBIAN) --timeout 1500 --modules slcan --install $(PACKAGES)/first.deb -- \
		$(IN_GUEST) $(ORDINARY) tests/service --ignore=tests/service/test_package.py

test-package: setup test-guests  ## the package installed, upgraded and removed, in the lab
	@[ ! -f $(PACKAGES)/first.deb ] || $(IN_DEBIAN) --timeout 1500 \
		--env VCU_DEB=$(CURDIR)/$(PACKAGES)/first.deb --env VCU_DEB_NEXT=$(CURDIR)/$(PACKAGES)/next.deb -- \
		$(IN_GUEST) $(ORDINARY) tests/service/test_package.py

test-vcan: setup  ## the tests on a real vcan0, in the lab where the kernel has no CAN
	$(LAB) install
	@$(MAKE) --no-print-directory -j2 --output-sync=target test-on-bus test-faults

test-lab: setup test-guests
	$(BIN)/pytest -q tests/lab

test-on-bus: setup
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -m 'not slow' tests/vcan
	$(IN_LAB) --timeout 450 $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan
	$(IN_LAB) --timeout 450 $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem

test-faults: setup
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan

nightly: setup  ## the long tests: deep invariants, ten minutes on vcan0
	scripts/test-tools
	VCU_REQUIRE_PROMTOOL=1 HYPOTHESIS_PROFILE=nightly $(BIN)/pytest $(NO_BUS)
	$(LAB) install
	$(IN_LAB) --timeout 2400 -- $(BIN)/pytest -s tests/vcan tests/faults/vcan
	$(IN_LAB) --timeout 900 $(WITH_SLCAN) -- $(BIN)/pytest tests/faults/slcan
	$(IN_LAB) --timeout 900 $(WITH_NETEM) -- $(BIN)/pytest tests/faults/netem
	$(MAKE) test-service test-package ORDINARY=
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

.PHONY: deb dist
deb: setup  ## the Debian package, in build/deb
	scripts/deb $(BIN)

dist: setup  ## wheel and sdist, in dist
	scripts/dist $(BIN)

clean:  ## remove what was built
	rm -rf $(VENV) build dist .coverage* .mypy_cache .ruff_cache .pytest_cache .hypothesis
