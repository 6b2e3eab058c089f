# `make demo` and `make test` do all their own set-up on a fresh Debian or Ubuntu machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# The layers of .venv: the program, and what tests, linters and the page's tests add, where used.
STAMP := $(VENV)/.set-up
TESTED := $(VENV)/.test
LINTED := $(VENV)/.lint
BROWSED := $(VENV)/.browser
LAYERS := $(TESTED) $(LINTED) $(BROWSED)
LAB := tests/lab/lab
# What needs a bus runs in the lab, the faults in a lab for each kind of bus.
BUS_ROOMS := vcan oracle controller lab power_cut recorded service faults/vcan faults/slcan faults/netem
NO_BUS := $(addprefix --ignore=tests/,$(BUS_ROOMS) web/vcan)
IN_A_BROWSER := $(addprefix tests/web/test_,actions.py live.py page.py recordings.py stop.py)
NO_BROWSER := $(addprefix --ignore=,$(IN_A_BROWSER))
NEEDS = @scripts/test-tools check --for $@
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
# How much a step runs: LEVEL=test, as `make test` does; ci, with what costs more; nightly, what is left.
LEVEL ?= test
SELECTED_test := not slow and not ci
SELECTED_ci := not slow
SELECTED_nightly := slow
SELECTED := $(SELECTED_$(LEVEL))
# Beside other work there is no clock to judge by: what does is in test-clock.
PYTEST = $(BIN)/pytest -q -m '$(SELECTED) and not clock'
IN_BUS_GUEST = $(BIN)/pytest -q -m '$(SELECTED)'
# Too slow under coverage's eyes, and the other tests cover the same lines.
EXHAUSTIVE := tests/core/test_exhaustive.py tests/core/test_invariants.py

.PHONY: help setup demo test test-changed test-quick test-bus test-smoke test-ci tools test-core coverage-shell test-exhaustive test-clock test-deep test-serving test-shell test-others test-recordings test-recorder test-web test-web-server test-web-vcan test-web-figures test-web-fuzz \
	test-faults-pure test-contents test-guests test-service test-debian test-debians test-lab test-power-cut test-golden test-recorded test-vcan test-oracle test-controller test-lab-qemu test-realtime test-faults-vcan \
	test-faults-slcan test-faults-netem test-systems lint nightly soak recorded-soak golden-accept golden-mutants faults mutants oracle-mutants bench lock clean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build .venv with the program

$(STAMP): pyproject.toml requirements.lock requirements-build.lock scripts/setup
	@scripts/setup $(PYTHON) $(VENV)

$(TESTED) $(LINTED) $(BROWSED): $(VENV)/.%: requirements-%.lock $(STAMP)
	@scripts/setup $(PYTHON) $(VENV) $*

demo: setup  ## gateway and simulated vehicle with a live table, without hardware
	@$(BIN)/vcu-gateway demo

test: $(LAYERS)  ## everything that a change may break: lint, types, tests, the service, the real vcan0
	@scripts/suite test

AGAINST :=
FILES :=
test-changed: $(TESTED) $(LINTED)  ## what the changed files reach; AGAINST=REV, FILES="..."
	@$(BIN)/python scripts/test-changed $(or $(FILES),$(if $(AGAINST),--base $(AGAINST)))

test-quick: $(TESTED) $(LINTED)  ## the tests that need neither CAN nor a guest
	@scripts/suite quick

test-smoke: $(TESTED) $(LINTED)  ## style, types and the core: the first minute of them
	@scripts/suite smoke

test-bus: $(TESTED)  ## the tests on a real vcan0, in the lab where the kernel has no CAN
	@scripts/suite bus

test-ci: $(LAYERS)  ## with the oracle, other Debians and Pythons from nothing, power cuts (30 minutes)
	@scripts/suite ci

nightly: $(LAYERS)  ## what is left: soak, mutants, every system wholly; goes on where it was ended
	@scripts/suite nightly

tools: $(LAYERS)  ## install what the tests need of the machine, with sudo
	@scripts/test-tools install

# The steps of scripts/suite, which runs several at once; each runs alone, too.

# Under the eyes of coverage it takes twice as long: 100 % is for CI.
test-core: $(TESTED)
ifeq ($(LEVEL),test)
	$(PYTEST) tests/core $(addprefix --ignore=,$(EXHAUSTIVE))
else
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -m '$(SELECTED)' tests/core $(addprefix --ignore=,$(EXHAUSTIVE))
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/core/*' --fail-under=100
endif

# Nightly: it takes 13 minutes. What tests start as a program of its own counts too,
# but for what a signal kills and for safe_stop.py, which -I -S keep coverage out of. Without CAN
# in the kernel bus/socketcan.py runs in the lab alone, where nothing is measured. test_imports.py
# asks what a process imports, and coverage imports more.
COVERED_SHELL := $(wildcard $(addprefix tests/,api app bus cli client config daemon doctor export exporter \
	judge pedals protocol recorder recording replay server simulator strict_yaml watch web test_*.py))
SHELL_COVERAGE := build/shell-coverage
coverage-shell: export COVERAGE_FILE = $(SHELL_COVERAGE)/data
coverage-shell: $(TESTED)  ## branch coverage of everything outside the core
	$(NEEDS) terminal compiler export
	rm -rf $(SHELL_COVERAGE)
	mkdir -p build
	mkdir -m 1777 $(SHELL_COVERAGE)  # programs of other users write there, too
	$(BIN)/coverage run -m pytest -q -n 4 --dist loadfile -m 'not slow and not clock' $(COVERED_SHELL) \
		--ignore=tests/app/test_imports.py
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --include='src/vcu_gateway/*' --omit='src/vcu_gateway/core/*' --fail-under=97

test-exhaustive: $(TESTED)
	$(PYTEST) $(EXHAUSTIVE)

# Where such tests are: to collect all others takes a processor's 15 s.
CLOCKED = $(filter-out $(IN_A_BROWSER) $(addprefix tests/,$(addsuffix /%,$(BUS_ROOMS) web/vcan packaging)), \
	$(sort $(shell grep -rl 'mark\.clock' tests --include='test_*.py')))
# What judges durations; at night, when it runs alone, each of ten stops in every attack.
ifeq ($(LEVEL),nightly)
test-clock: export VCU_PRESSES := 10
endif
test-clock: $(TESTED)
	$(NEEDS) compiler terminal
	$(BIN)/pytest -q -m '$(SELECTED) and clock' $(CLOCKED)
ifeq ($(LEVEL),nightly)
	$(BIN)/pytest -q -m 'not slow' tests/server/test_attacks.py tests/web/test_attacks.py
endif

SERVING := tests/api tests/server tests/client tests/app
test-serving: $(TESTED)
	$(PYTEST) $(SERVING)

SHELL_TESTS := $(addprefix tests/,bus cli config daemon exporter)
test-shell: $(TESTED)
	$(NEEDS) export
	$(PYTEST) $(SHELL_TESTS)

# In real time, with a C library that has its disk fail.
test-recorder: $(TESTED)
	$(NEEDS) compiler
	$(PYTEST) tests/recorder

RECORDED_DATA := $(addprefix tests/,judge recording replay export)
test-recordings: $(TESTED)  ## what reads, replays and exports recorded drives
	$(NEEDS) browser export
	$(PYTEST) $(RECORDED_DATA)

test-others: $(TESTED)
	$(NEEDS) terminal promtool compiler
	$(PYTEST) tests $(addprefix --ignore=,$(SERVING) $(SHELL_TESTS) $(RECORDED_DATA)) \
		$(addprefix --ignore=tests/,core faults golden packaging recorder web) $(NO_BUS)

test-web: $(TESTED) $(BROWSED)  ## the page, in a real Chromium beside a real gateway
	$(NEEDS) browser axe
	$(BIN)/pytest -q -m '$(SELECTED)' $(IN_A_BROWSER)

test-web-server: $(TESTED)  ## the page's server, without a browser
	$(PYTEST) tests/web $(NO_BROWSER) --ignore=tests/web/vcan

test-web-figures: $(TESTED) $(BROWSED)  ## what the page costs and how fast it is, on a machine that does nothing else
	$(NEEDS) browser
	$(BIN)/pytest -q -s tests/web/test_figures.py

ODD_REQUESTS := $(if $(filter nightly,$(LEVEL)),100000,10000)
test-web-fuzz: $(TESTED)  ## 10,000 requests that nobody should send; LEVEL=nightly: 100,000
	$(BIN)/python -m tests.web.fuzz $(ODD_REQUESTS)

# Chromium takes minutes in the lab.
test-web-vcan: $(TESTED) $(BROWSED)
	$(NEEDS) lab browser
	$(IN_LAB) --mem 1500M --timeout 2700 -- $(BIN)/pytest -q tests/web/vcan

test-faults-pure: $(TESTED)
	$(PYTEST) tests/faults/pure

# Ten times as many examples, and the slow tests.
test-deep: $(TESTED)
	$(NEEDS) promtool export browser terminal compiler
	HYPOTHESIS_PROFILE=nightly $(BIN)/pytest -q -m '(slow or hypothesis) and not clock' \
		tests $(NO_BUS) --ignore=tests/packaging --ignore=tests/web

test-contents: $(TESTED) test-guests  ## what is in the package
	VCU_DEB=$(CURDIR)/$(PACKAGES)/first.deb VCU_SUITE=$(SUITE) $(BIN)/pytest -q -m '$(SELECTED)' tests/packaging

test-guests: $(TESTED)
	$(NEEDS) guests
	@scripts/test-guests $(SUITE) $(BIN) $(PACKAGES)

test-service: $(TESTED) test-guests  ## the installed service under a real systemd, then the package, in the lab
	@$(IN_DEBIAN) --timeout 1800 --modules slcan --install $(PACKAGES)/first.deb \
		--env VCU_DEB=$(CURDIR)/$(PACKAGES)/first.deb --env VCU_DEB_NEXT=$(CURDIR)/$(PACKAGES)/next.deb -- \
		$(IN_GUEST) -m '$(SELECTED)' tests/service

test-debian: $(TESTED)  ## the package for one release wholly: contents, service, installing; SUITE=trixie
	@$(MAKE) --no-print-directory SELECTED='slow or not slow' test-contents
	@$(MAKE) --no-print-directory SELECTED='slow or not slow' test-service

# For the other release what `make test` runs for this one; at night both wholly, with lintian and a
# second build.
test-debians: $(TESTED)
ifeq ($(LEVEL),nightly)
	@for suite in $(SUITES); do $(MAKE) --no-print-directory test-debian SUITE=$$suite || exit; done
else
	@for suite in $(filter-out $(SUITE),$(SUITES)); do \
		$(MAKE) --no-print-directory LEVEL=test SUITE=$$suite test-contents test-service || exit; done
endif

test-lab: $(TESTED) test-guests
	$(NEEDS) guests
	$(BIN)/pytest -q tests/lab --ignore=$(LAB_QEMU)

test-power-cut: $(TESTED) test-guests  ## what a power cut leaves of a recording, in the lab
	$(NEEDS) guests
	$(BIN)/pytest -q tests/power_cut

# Every scenario and fault that a recording can hold, replayed to the byte by the core as it is.
test-golden: $(TESTED)  ## recorded drives, replayed to the byte
	$(PYTEST) tests/golden

golden-accept: $(TESTED)  ## take what the core does now as right: golden drives anew, and their report
	scripts/golden accept

# At night each rule until its first mutant is seen: that is the claim; all of them take 25 minutes.
golden-mutants: $(TESTED)  ## change each safety rule on purpose: a golden drive must turn out otherwise
	$(BIN)/python -m tests.golden.mutants $(if $(filter nightly,$(LEVEL)),--one)

# Real gateway and real recorder, on file systems that are made and mounted: in a guest everywhere.
IN_GUEST_LAB := LAB_WAY=$(or $(LAB_WAY),uml) $(LAB)
test-recorded: $(TESTED)  ## recorded on vcan0: complete, replayed, killed, disk full and stalled
	$(NEEDS) lab
	$(IN_GUEST_LAB) run --env VCU_REQUIRE_CAN=1 --modules loop --timeout 1200 -- $(IN_BUS_GUEST) tests/recorded

test-vcan: $(TESTED)
	$(NEEDS) lab
	$(IN_LAB) --timeout 3000 -- $(IN_BUS_GUEST) tests/vcan

# The specification against the program, by tests that share nothing with it.
test-oracle: $(TESTED)  ## a second opinion on every frame, written from the specification alone
	$(NEEDS) lab
	$(IN_LAB) --timeout 1500 -- $(IN_BUS_GUEST) tests/oracle

test-faults-vcan: $(TESTED)
	$(NEEDS) lab
	$(IN_LAB) --timeout 900 -- $(IN_BUS_GUEST) tests/faults/vcan

test-faults-slcan: $(TESTED)
	$(NEEDS) lab
	$(IN_LAB) --timeout 450 $(WITH_SLCAN) -- $(IN_BUS_GUEST) tests/faults/slcan

test-faults-netem: $(TESTED)
	$(NEEDS) lab
	$(IN_LAB) --timeout 450 $(WITH_NETEM) -- $(IN_BUS_GUEST) tests/faults/netem

JOYSTICK := tests/controller/test_pedals.py
test-controller: $(TESTED) test-guests  ## on two emulated CAN controllers with a real networkd, and a joystick, in the lab
	$(NEEDS) qemu
	$(IN_QEMU) -- $(IN_GUEST) -m 'not slow' --ignore=$(JOYSTICK) tests/controller
	$(IN_QEMU) --modules uinput --install $(PACKAGES)/first.deb -- $(IN_GUEST) $(JOYSTICK)

test-lab-qemu: $(TESTED)
	$(NEEDS) qemu
	$(BIN)/pytest -q $(LAB_QEMU)

# The service on a PREEMPT_RT kernel, where its package can be built.
test-realtime: $(TESTED) test-guests
	$(NEEDS) qemu
	deb=$(PACKAGES)/first.deb; $(IN_QEMU) --kernel rt $$([ ! -f $$deb ] || echo --install $$deb) \
		--env VCU_REQUIRE_REALTIME=1 -- $(IN_GUEST) tests/controller/test_realtime.py

# What each runs after the README's commands; together they prove every Python that is claimed.
SYSTEMS_ci := bookworm:smoke noble:smoke trixie:smoke forky:smoke
SYSTEMS_nightly := bookworm:whole noble:quick trixie:whole forky:quick
SYSTEMS := $(SYSTEMS_$(LEVEL))
test-systems: $(TESTED)  ## the README's commands in clean systems, or SYSTEMS="trixie:whole"; with them, every Python
	$(NEEDS) guests terminal
	$(BIN)/python -m tests.systems $(SYSTEMS)

MINUTES := 10
soak: MINUTES := $(if $(filter nightly,$(LEVEL)),60,10)
soak: $(TESTED)  ## nominal traffic with random faults for MINUTES=10, in the lab
	$(NEEDS) lab
	$(LAB) run --timeout $$(( $(MINUTES) * 60 + 180 )) -- $(BIN)/python -m tests.faults.soak --minutes $(MINUTES)

recorded-soak: $(TESTED)  ## recorded for MINUTES=10 with random faults: complete, and replayed
	$(NEEDS) lab
	$(IN_GUEST_LAB) run --modules loop --timeout $$(( $(MINUTES) * 180 + 1200 )) --env VCU_RECORDED_SOAK_S=$$(( $(MINUTES) * 60 )) \
		-- $(BIN)/pytest -q tests/recorded -k random_faults

FAULTS := build/faults
faults: $(TESTED)  ## every fault that the gateway survives; writes docs/faults.md
	$(NEEDS) lab
	rm -rf $(FAULTS)
	-VCU_FAULT_RESULTS=$(FAULTS) $(BIN)/pytest -q -m 'not slow' tests/faults/pure
	-$(IN_LAB) --timeout 900 --env VCU_FAULT_RESULTS=$(FAULTS) -- $(BIN)/pytest -q -m 'not slow' tests/faults/vcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_SLCAN) -- $(BIN)/pytest -q -m 'not slow' tests/faults/slcan
	-$(IN_LAB) --timeout 300 --env VCU_FAULT_RESULTS=$(FAULTS) $(WITH_NETEM) -- $(BIN)/pytest -q -m 'not slow' tests/faults/netem
	$(BIN)/python -m tests.faults.page $(FAULTS)

mutants: $(TESTED)  ## change the safety core on purpose: every mistake must turn a test red
	scripts/mutants $(BIN)

oracle-mutants: $(TESTED)  ## change what the program does on purpose: the oracle alone must see it
	$(NEEDS) lab
	$(BIN)/python -m tests.oracle.mutate

lint: $(TESTED) $(LINTED)  ## style, types, spelling, import contracts, generated files
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell
	$(BIN)/vcu-gateway dbc --check
	$(BIN)/python -m scripts.documents --check
	$(BIN)/python scripts/import-graph --check

bench: $(TESTED)  ## compare with the naive way, and with AGAINST=TREE; writes docs/benchmarks.md
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
