# `make demo` and `make test` do all their own set-up on a fresh Debian or Ubuntu machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
LAB := tests/lab/lab
# What needs a bus runs in the lab, the faults in a lab for each kind of bus.
BUS_ROOMS := vcan oracle controller lab power_cut recorded service faults/vcan faults/slcan faults/netem
NO_BUS := $(addprefix --ignore=tests/,$(BUS_ROOMS) web)
IN_LAB := $(LAB) run --env VCU_REQUIRE_CAN=1
WITH_SLCAN := --modules slcan
WITH_NETEM := --module-param vcan:echo=1 --modules "sch_netem sch_tbf"
# The installed package, in a Debian of its own under a real systemd: of this machine's suite where
# that is one that the package is tested on, else Debian 12's; SUITE=trixie for another one. The
# guest runs its own python3, with the tests' libraries for that.
SUITES := bookworm trixie
SUITE ?= $(or $(filter $(SUITES),$(shell scripts/own-suite)),bookworm)
PACKAGES := build/tests/$(SUITE)
IN_SUITE := --root $(SUITE) --also $(CURDIR)/$(PACKAGES) --env PYTHONPATH=$(CURDIR)/src:$(CURDIR)/$(PACKAGES)/site \
	--env PYTHONPYCACHEPREFIX=$(CURDIR)/$(PACKAGES)/cache
IN_DEBIAN := $(LAB) run --systemd $(IN_SUITE) --env VCU_REQUIRE_SYSTEMD=1
IN_GUEST := /usr/bin/python3 -m pytest -q -p no:cacheprovider
# Two emulated CAN controllers on one bus, in Debian's own kernel.
IN_QEMU := $(LAB) run --qemu --timeout 2400 $(IN_SUITE) --env VCU_REQUIRE_CONTROLLER=1
LAB_QEMU := tests/lab/test_qemu.py
ORDINARY := -m 'not slow'
# Too slow under coverage's eyes, and the other tests cover the same lines.
EXHAUSTIVE := tests/core/test_exhaustive.py tests/core/test_invariants.py

.PHONY: help setup demo test test-quick test-bus test-elsewhere tools lab test-core coverage-shell test-exhaustive test-serving test-shell test-others test-recorder test-web test-web-server test-web-vcan test-web-figures test-web-fuzz \
	test-faults-pure test-contents test-guests test-service test-package test-debian test-debians test-lab test-power-cut test-golden test-recorded test-vcan test-oracle test-controller test-lab-qemu test-realtime test-faults-vcan \
	test-faults-slcan test-faults-netem test-systems lint nightly soak recorded-soak golden-accept golden-mutants faults mutants oracle-mutants bench lock clean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build .venv with the program and its tools

$(STAMP): pyproject.toml requirements.lock requirements-dev.lock scripts/setup
	@scripts/setup $(PYTHON) $(VENV)
	@touch $@

demo: setup  ## gateway and simulated vehicle with a live table, without hardware
	@$(BIN)/vcu-gateway demo

test: tools  ## everything: lint, types, tests, the service, the real vcan0
	@RUN=$$(date +%s%N) scripts/suite whole

test-quick: tools  ## the tests that need neither CAN nor a browser
	@scripts/suite quick

test-bus: setup lab  ## the tests on a real vcan0, in the lab where the kernel has no CAN
	@scripts/suite bus

test-elsewhere: tools  ## the oracle, other Debians and Pythons from nothing, two CAN controllers (40 minutes)
	@scripts/suite elsewhere

tools: setup
	-@scripts/test-tools

lab: setup
	@$(LAB) install

# The steps of scripts/suite, which runs several at once; each runs alone, too.

test-core: setup
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -m 'not slow' tests/core $(addprefix --ignore=,$(EXHAUSTIVE))
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/core/*' --fail-under=100

# Not in `make test`: it takes 18 minutes. What tests start as a program of its own counts too,
# but for what a signal kills and for safe_stop.py, which -I -S keep coverage out of. Without CAN
# in the kernel bus/socketcan.py runs in the lab alone, where nothing is measured.
COVERED_SHELL := $(wildcard $(addprefix tests/,api app bus cli client config daemon doctor exporter \
	protocol recording server simulator strict_yaml watch web))
SHELL_COVERAGE := build/shell-coverage
coverage-shell: export COVERAGE_FILE = $(SHELL_COVERAGE)/data
coverage-shell: setup  ## branch coverage of everything outside the core (18 minutes)
	rm -rf $(SHELL_COVERAGE)
	mkdir -p build
	mkdir -m 1777 $(SHELL_COVERAGE)  # programs of other users write there, too
	$(BIN)/coverage run -m pytest -q -m 'not slow' $(COVERED_SHELL)
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/*' --omit='src/vcu_gateway/core/*' --fail-under=97

test-exhaustive: setup
	$(BIN)/pytest -q $(ORDINARY) $(EXHAUSTIVE)

SERVING := tests/api tests/server tests/client tests/app
test-serving: setup
	$(BIN)/pytest -q -m 'not slow' $(SERVING)

SHELL_TESTS := $(addprefix tests/,bus cli config daemon exporter recording)
test-shell: setup
	$(BIN)/pytest -q -m 'not slow' $(SHELL_TESTS)

# In real time, with a C library that has its disk fail.
test-recorder: setup
	$(BIN)/pytest -q -m 'not slow' tests/recorder

test-others: setup
	$(BIN)/pytest -q -m 'not slow' tests $(addprefix --ignore=,$(SERVING)) \
		$(addprefix --ignore=tests/,core faults golden packaging recorder) $(addprefix --ignore=,$(SHELL_TESTS)) $(NO_BUS)

IN_A_BROWSER := $(addprefix tests/web/,test_page.py test_recordings.py)
test-web: setup  ## the page, in a real Chromium beside a real gateway
	scripts/test-tools
	VCU_REQUIRE_BROWSER=1 $(BIN)/pytest -q $(ORDINARY) $(IN_A_BROWSER)

test-web-server: setup  ## the page's server, without a browser
	$(BIN)/pytest -q $(ORDINARY) tests/web $(addprefix --ignore=,$(IN_A_BROWSER) tests/web/vcan)

test-web-figures: setup  ## what the page costs and how fast it is, on a machine that does nothing else
	scripts/test-tools
	VCU_REQUIRE_BROWSER=1 $(BIN)/pytest -q -s tests/web/test_figures.py

test-web-fuzz: setup  ## 100 000 requests that nobody should send
	$(BIN)/python -m tests.web.fuzz 100000

# Chromium takes minutes in the lab.
test-web-vcan: setup lab
	scripts/test-tools
	$(IN_LAB) --mem 1500M --timeout 1500 --env VCU_REQUIRE_BROWSER=1 -- $(BIN)/pytest -q tests/web/vcan

test-faults-pure: setup
	$(BIN)/pytest -q -m 'not slow' tests/faults/pure

test-contents: setup test-guests  ## what is in the package
	VCU_DEB=$(CURDIR)/$(PACKAGES)/first.deb VCU_SUITE=$(SUITE) $(BIN)/pytest -q $(ORDINARY) tests/packaging

test-guests: setup
	@scripts/test-guests $(SUITE) $(BIN) $(PACKAGES) $(RUN)

test-service: setup test-guests  ## the installed service under a real systemd, in the lab
	@[ ! -f $(PACKAGES)/first.deb ] || $(IN_DEBIAN) --timeout 1500 --modules slcan --install $(PACKAGES)/first.deb -- \
		$(IN_GUEST) $(ORDINARY) tests/service --ignore=tests/service/test_package.py

test-package: setup test-guests  ## the package installed, upgraded and removed, in the lab
	@[ ! -f $(PACKAGES)/first.deb ] || $(IN_DEBIAN) --timeout 1500 \
		--env VCU_DEB=$(CURDIR)/$(PACKAGES)/first.deb --env VCU_DEB_NEXT=$(CURDIR)/$(PACKAGES)/next.deb -- \
		$(IN_GUEST) $(ORDINARY) tests/service/test_package.py

test-debian: setup  ## the package for one release wholly: contents, service, installing; SUITE=trixie
	@run=$$(date +%s%N); \
	$(MAKE) --no-print-directory RUN=$$run test-contents ORDINARY= && \
	$(MAKE) --no-print-directory RUN=$$run test-service test-package

test-controller: setup test-guests  ## on two emulated CAN controllers with a real networkd, in the lab
	$(LAB) install --qemu
	$(IN_QEMU) -- $(IN_GUEST) $(ORDINARY) tests/controller

test-lab-qemu: setup
	$(LAB) install --qemu
	$(BIN)/pytest -q $(LAB_QEMU)

# The service on a PREEMPT_RT kernel, where its package can be built.
test-realtime: setup test-guests
	$(LAB) install --qemu
	deb=$(PACKAGES)/first.deb; $(IN_QEMU) --kernel rt $$([ ! -f $$deb ] || echo --install $$deb) \
		--env VCU_REQUIRE_REALTIME=1 -- $(IN_GUEST) tests/controller/test_realtime.py

# The other releases wholly, and of this one what lintian and a second build say.
test-debians: setup
	@$(MAKE) --no-print-directory test-contents ORDINARY=
	@for suite in $(filter-out $(SUITE),$(SUITES)); do $(MAKE) --no-print-directory test-debian SUITE=$$suite || exit; done

test-lab: setup test-guests
	$(BIN)/pytest -q tests/lab --ignore=$(LAB_QEMU)

test-power-cut: setup test-guests  ## what a power cut leaves of a recording, in the lab
	$(BIN)/pytest -q tests/power_cut

# Every scenario and fault that a recording can hold, replayed to the byte by the core as it is.
test-golden: setup  ## recorded drives, replayed to the byte
	$(BIN)/pytest -q -m 'not slow' tests/golden

golden-accept: setup  ## take what the core does now as right: golden drives anew, and their report
	scripts/golden accept

golden-mutants: setup  ## change each safety rule on purpose: a golden drive must turn out otherwise
	$(BIN)/python -m tests.golden.mutants

# Real gateway and real recorder, on file systems that are made and mounted: in a guest everywhere.
IN_GUEST_LAB := LAB_WAY=$(or $(LAB_WAY),uml) $(LAB)
test-recorded: setup  ## recorded on vcan0: complete, replayed, killed, disk full and stalled
	$(IN_GUEST_LAB) install
	$(IN_GUEST_LAB) run --env VCU_REQUIRE_CAN=1 --modules loop --timeout 1200 -- $(BIN)/pytest -q tests/recorded

test-vcan: setup lab
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -m 'not slow' tests/vcan

# The specification against the program, by tests that share nothing with it.
test-oracle: setup lab  ## a second opinion on every frame, written from the specification alone
	$(IN_LAB) --timeout 1500 -- $(BIN)/pytest -q -m 'not slow' tests/oracle

test-faults-vcan: setup lab
	$(IN_LAB) --timeout 900 -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan

test-faults-slcan: setup lab
	$(IN_LAB) --timeout 450 $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan

test-faults-netem: setup lab
	$(IN_LAB) --timeout 450 $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem

nightly: setup lab  ## the long tests: deep invariants, ten minutes on vcan0
	scripts/test-tools
	$(MAKE) test-web-server test-web test-web-fuzz test-web-figures
	VCU_REQUIRE_PROMTOOL=1 HYPOTHESIS_PROFILE=nightly $(BIN)/pytest $(NO_BUS)
	$(IN_LAB) --timeout 3000 -- $(BIN)/pytest -s tests/vcan tests/oracle tests/faults/vcan
	$(IN_LAB) --timeout 900 $(WITH_SLCAN) -- $(BIN)/pytest tests/faults/slcan
	$(IN_LAB) --timeout 900 $(WITH_NETEM) -- $(BIN)/pytest tests/faults/netem
	for suite in $(SUITES); do $(MAKE) test-debian SUITE=$$suite ORDINARY= || exit; done
	$(MAKE) test-controller test-lab-qemu test-realtime
	$(BIN)/python -m tests.systems --whole bookworm trixie
	$(MAKE) soak MINUTES=60
	$(MAKE) recorded-soak golden-mutants

SYSTEMS :=
test-systems: setup  ## the README's commands in clean systems, or SYSTEMS="trixie"; with them, every Python
	@scripts/test-tools
	$(BIN)/python -m tests.systems $(if $(CI),--tested-here) $(SYSTEMS)

MINUTES := 10
soak: setup lab  ## nominal traffic with random faults for MINUTES=10, in the lab
	$(LAB) run --timeout $$(( $(MINUTES) * 60 + 180 )) -- $(BIN)/python -m tests.faults.soak --minutes $(MINUTES)

recorded-soak: setup  ## recorded for MINUTES=10 with random faults: complete, and replayed
	$(IN_GUEST_LAB) install
	$(IN_GUEST_LAB) run --modules loop --timeout $$(( $(MINUTES) * 180 + 1200 )) --env VCU_RECORDED_SOAK_S=$$(( $(MINUTES) * 60 )) \
		-- $(BIN)/pytest -q tests/recorded -k random_faults

FAULTS := build/faults
faults: setup lab  ## every fault that the gateway survives; writes docs/faults.md
	rm -rf $(FAULTS)
	-VCU_FAULT_RESULTS=$(FAULTS) $(BIN)/pytest -q -m 'not slow' tests/faults/pure
	-$(IN_LAB) --timeout 900 --env VCU_FAULT_RESULTS=$(FAULTS) -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem
	$(BIN)/python -m tests.faults.page $(FAULTS)

mutants: setup  ## change the safety core on purpose: every mistake must turn a test red
	scripts/mutants $(BIN)

oracle-mutants: setup lab  ## change what the program does on purpose: the oracle alone must see it
	$(BIN)/python -m tests.oracle.mutate

lint: setup  ## style, types, spelling, import contracts, generated files
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell
	$(BIN)/vcu-gateway dbc --check
	$(BIN)/vcu-gateway schema --yaml --check
	$(BIN)/python scripts/import-graph --check

AGAINST :=
bench: setup  ## compare with the naive way, and with AGAINST=TREE; writes docs/benchmarks.md
	$(BIN)/python -m bench $(if $(AGAINST),--against $(AGAINST))

lock: setup  ## resolve and hash the dependencies again
	scripts/lock $(BIN)

.PHONY: deb dist
deb: setup  ## the Debian package, in build/deb; SUITE=trixie: for another release
	scripts/deb $(if $(filter-out file default,$(origin SUITE)),--suite $(SUITE)) $(BIN)

dist: setup  ## wheel and sdist, in dist
	scripts/dist $(BIN)

clean:  ## remove what was built
	rm -rf $(VENV) build dist .coverage* .mypy_cache .ruff_cache .pytest_cache .hypothesis
