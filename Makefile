# One verb per target; CI calls `make test` and nothing else (.ci/run).
# Needs Rust, Python >= 3.11, make and a C linker. uv is used where it is installed, pip otherwise.

SHELL := /bin/sh
.SHELLFLAGS := -eu -c
.DEFAULT_GOAL := help
# Cargo and pytest use every core by themselves. Only `make test` runs two parts side by side.
ifndef SIDE_BY_SIDE
.NOTPARALLEL:
endif
.DELETE_ON_ERROR:

# An emptied environment has no HOME and no PATH to cargo.
ifeq ($(strip $(HOME)),)
export HOME := $(shell getent passwd "$$(id -u)" | cut -d: -f6)
endif
export PATH := $(or $(CARGO_HOME),$(HOME)/.cargo)/bin:$(or $(PATH),/usr/local/bin:/usr/bin:/bin)

VENV := .venv
BIN := $(VENV)/bin
# Absolute, so that cargo's build scripts find it from any folder.
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python
# Pictures are drawn without a display; one thread per process, because the processes share the cores.
export MUJOCO_GL ?= egl
export MPLBACKEND ?= Agg
export OMP_NUM_THREADS ?= 1
# Hundreds of programs start Python: without stored bytecode each would compile the package again.
unexport PYTHONDONTWRITEBYTECODE
export PIP_ROOT_USER_ACTION := ignore
export PIP_DISABLE_PIP_VERSION_CHECK := 1

UV := $(shell command -v uv 2>/dev/null)
# uv shall trust what the machine trusts, as pip does.
export UV_SYSTEM_CERTS ?= 1
# pip starts maturin by name: ours comes first, not one that happens to be on the machine.
PIP_INSTALL = PATH="$(CURDIR)/$(BIN):$$PATH" $(if $(UV),$(UV) pip install --quiet --python $(BIN)/python,$(BIN)/python -m pip install --quiet)
# CI must not change the lock file, and keeps no incremental state.
ifneq ($(strip $(CI)),)
LOCKED := --locked
NEXTEST_PROFILE := --profile ci
export CARGO_INCREMENTAL := 0
# A wheel for others names no folder of its builder. Where the linker can, it has equal functions and texts once only.
FOLD := -Clink-arg=-Wl,--icf=all,-O2
CAN_FOLD := $(shell file=$$(mktemp); echo 'fn main() {}' | rustc $(FOLD) -o "$$file" - 2>/dev/null && echo yes; rm -f "$$file")
export CARGO_BUILD_RUSTFLAGS := --remap-path-prefix=$(or $(CARGO_HOME),$(HOME)/.cargo)/registry/src= --remap-path-prefix=$(CURDIR)= $(if $(CAN_FOLD),$(FOLD))
endif

WHEELS := build/wheels
RUST := $(shell find rust -name '*.rs') Cargo.toml .cargo/config.toml $(wildcard Cargo.lock) $(wildcard rust/*/Cargo.toml) python/pliant/_core.pyi
PY_SOURCES := $(shell find python -type f ! -name '*.so' ! -path '*/__pycache__/*')
# An editable install keeps the compiled module beside the sources: `git clean` can take it away.
MISSING_CORE := $(if $(wildcard python/pliant/_core*.so),,FORCE)

ifndef START
export START := $(shell date +%s)
endif
say = @printf '\n== %s  (%s s)\n' '$(1)' "$$(($$(date +%s) - $(START)))"
skip = printf '\n!! SKIPPED: %s\n' '$(1)'

.PHONY: help setup setup-demo demo campaign check test test-full test-rust test-py test-lerobot lint lint-rust lint-py stubs deny docs gallery bench tick bench-stages browser counts counts-check aarch64 fuzz miri asan mutants peers soak wheel wheels release-check windows pythons notices fmt clean FORCE

help: ## Say what there is
	@grep -E '^[a-z0-9-]+:.*## ' Makefile | sed -E 's/:[^#]*## /\t/' | awk -F '\t' '{ printf "  make %-12s %s\n", $$1, $$2 }'

# --- environment ---------------------------------------------------------------------------------------------------

$(BIN)/python:
	$(call say,virtual environment)
	@command -v cargo >/dev/null || { echo "error: cargo not found; install Rust with rustup"; exit 1; }
	@./tools/make_venv.sh $(VENV)
	@# Without build isolation the vendor's drivers, which come as sources, need their builder here.
	@$(PIP_INSTALL) 'maturin>=1.9.4,<2' setuptools wheel

# Installs what the extras name and builds the module, editable: a change of a Python file needs nothing here.
define install
	$(call say,install pliant[$(1)] and build its module in release mode)
	@$(PIP_INSTALL) --no-build-isolation --editable '.[$(1)]'
	@touch $@
endef

$(VENV)/.with-test: $(BIN)/python pyproject.toml $(RUST) $(MISSING_CORE)
	$(call install,test$(comma)lint$(comma)docs)

$(VENV)/.with-demo: $(BIN)/python pyproject.toml $(RUST) $(MISSING_CORE)
	$(call install,experiments$(comma)servo$(comma)log$(comma)view)

comma := ,

setup: $(VENV)/.with-test ## Make .venv with everything for development
setup-demo: $(VENV)/.with-demo

demo: setup-demo ## Run the paper's experiments on the simulator and leave a report
	@$(BIN)/python -m experiments.demo $(ARGS)

campaign: setup ## Every promised cap against the measured push-back, in random poses; ARGS='--poses 20'
	@$(BIN)/python -m experiments.campaign $(ARGS)

# --- tests ---------------------------------------------------------------------------------------------------------

check: setup lint ## Lints and unit tests, under two minutes once built
	$(call say,unit tests)
	@cargo test $(LOCKED) --quiet -p pliant-core --lib
	@$(BIN)/python -m pytest -m 'not slow and not full' $(ARGS)

# Linking the module, checking types and building pages leave a core idle, and cargo locks the folders of tests and of
# releases each for itself: lints and tests of the core run beside them, each chain in its order. pytest comes last,
# alone, because emulated buses run in real time; its closing line is the one that counts.
test: $(BIN)/python ## Everything that CI runs
	@$(MAKE) --no-print-directory --jobs=2 $(if $(filter output-sync,$(.FEATURES)),--output-sync=target) SIDE_BY_SIDE=1 test-rust wheel deny docs
	@$(MAKE) --no-print-directory test-py

ifdef SIDE_BY_SIDE
test-rust: | lint-rust
lint-py: | stubs
counts-check: | lint-py
$(WHEELS)/.built: | counts-check
docs: | test-rust
endif

# The packages whose targets are tested: none that links Python. All steps name both, because cargo unites the features
# that they need, and builds crates again for other features.
TESTED := --package pliant-core --package pliant-benches

test-rust: $(BIN)/python ## Tests of the Rust core, its doc tests and its pages
	$(call say,tests of the Rust core$(comma) benches once each)
	@if command -v cargo-nextest >/dev/null; then \
	  cargo nextest run $(LOCKED) $(NEXTEST_PROFILE) $(TESTED) --all-targets; \
	else \
	  $(call skip,cargo-nextest is not installed: using cargo test); \
	  cargo test $(LOCKED) --quiet --no-fail-fast $(TESTED) --all-targets; \
	fi
	$(call say,programs of the Rust core)
	@cargo build $(LOCKED) --quiet --profile test --examples $(TESTED)
	@for program in rust/core/examples/*.rs; do \
	  "$${CARGO_TARGET_DIR:-target}/debug/examples/$$(basename "$$program" .rs)" >/dev/null; done
	$(call say,doc tests)
	@cargo test $(LOCKED) --quiet --doc $(TESTED)
	$(call say,pages of the Rust core)
	@RUSTDOCFLAGS='-D warnings' cargo doc $(LOCKED) --quiet --no-deps

# Emulated buses, pages and programs run in real time: on a busy machine one may answer too late. A test
# that fails is run once more, and the summary names it; what fails for a cause fails twice.
RERUN := --reruns=1 -rR

test-py: setup ## Tests from Python; ARGS='-k door' picks
	$(call say,pytest)
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || $(call skip,no browser: the page of pliant view is not tested in one (apt-get install -y chromium))
	@$(BIN)/python -m pytest $(RERUN) $(ARGS)

test-full: setup ## All tests, the long forms of `make test`'s included
	$(call say,pytest$(comma) long forms included)
	@$(BIN)/python -m pytest $(RERUN) -m '' $(ARGS)

# LeRobot's dynamixel-sdk is not the one of the other tests, so it gets an environment of its own.
LEROBOT := build/lerobot
test-lerobot: wheel ## The plugin with LeRobot itself (6 GB, Python >= 3.12); LEROBOT_CHECKOUT=a clone of it runs its own test too
	$(call say,LeRobot in $(LEROBOT))
	@test -x $(LEROBOT)/bin/python || ./tools/make_venv.sh $(LEROBOT) 3.12
	@$(LEROBOT)/bin/python -m pip install --quiet 'lerobot[core-scripts,feetech,dynamixel,evaluation]==0.6.1' \
	  'pytest>=8' "$$(ls $(WHEELS)/*.whl)[servo,sim,gym]" --editable integrations/lerobot \
	  --editable integrations/lerobot_env
	@$(LEROBOT)/bin/python -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/*.whl
	$(call say,contract of the plugin with LeRobot)
	@$(LEROBOT)/bin/python -m pytest -o addopts=--import-mode=importlib tests/lerobot_plugin $(ARGS)
	$(call say,programs of LeRobot$(comma) stock arms$(comma) units)
	@$(LEROBOT)/bin/python -m pytest integrations/lerobot/tests $(ARGS)
	@$(LEROBOT)/bin/python -m pytest integrations/lerobot_env/tests $(ARGS)

lint: lint-rust lint-py stubs ## Formats, clippy, ruff, import contracts, mypy, stubs against the binary

lint-rust: $(BIN)/python
	$(call say,rustfmt$(comma) clippy)
	@cargo fmt --all --check
	@cargo clippy $(LOCKED) --quiet --workspace --all-targets -- -D warnings

lint-py: setup
	$(call say,ruff$(comma) import-linter$(comma) mypy)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache --no-logo
	@$(BIN)/mypy

stubs: setup ## Compare python/pliant/_core.pyi with the compiled module
	$(call say,stubtest)
	@$(BIN)/python -m mypy.stubtest --mypy-config-file pyproject.toml pliant._core

# Licences, sources and duplicates; advisories need a network that CI does not have.
deny:
	$(call say,cargo-deny)
	@if command -v cargo-deny >/dev/null; then cargo deny --workspace check bans licenses sources; \
	else $(call skip,cargo-deny is not installed (cargo install --locked cargo-deny)); fi

docs: setup ## Build docs/_build/html; a warning is an error
	$(call say,pages)
	@$(BIN)/python -m sphinx -W --keep-going --quiet -b html docs docs/_build/html

gallery: setup ## Run the examples that changed, keep pictures and texts for the pages; ARGS=--all, ARGS=07
	$(call say,gallery)
	@$(BIN)/python tools/gallery.py $(ARGS)

fuzz: ## Every fuzz target for MINUTES=1, or TARGETS='urdf step'; needs nightly and cargo-fuzz
	$(call say,fuzz targets)
	@tools/fuzz.sh $(or $(MINUTES),1) $(TARGETS)

miri: ## Unit tests of the core's unsafe code under Miri; needs nightly with miri
	$(call say,Miri)
	@tools/miri.sh

asan: setup ## Tests of arrays, batches, pool and serial ports with AddressSanitizer; needs nightly
	$(call say,AddressSanitizer)
	@tools/asan.sh $(CURDIR)/$(BIN)/python

mutants: ## Mutation tests of the laws; slow: SHARD=0/40 picks a part; needs cargo-mutants
	$(call say,mutants)
	@tools/mutants.sh $(or $(SHARD),0/1)

# --- the rest ------------------------------------------------------------------------------------------------------

browser: setup ## All tests of the page in a real browser, of which `make test` runs two
	$(call say,pages in a browser)
	@$(BIN)/python -m pytest --numprocesses=0 -m '' tests/view/test_browser.py $(ARGS)

soak: setup ## Ten minutes of emulated bus with faults on each family; ARGS='--family x --minutes 1'
	@$(BIN)/python -m experiments.soak $(ARGS)

bench: setup ## Latency of a step on this machine; ARGS='--robot so101'
	@$(BIN)/python benches/latency.py $(ARGS)

tick: setup ## Cost of a control cycle by stage, beside rustypot alone; ARGS='--rigs null,so101'
	@$(BIN)/python benches/tick.py $(ARGS)

bench-stages: setup ## Criterion benches per stage; ARGS='-- step' picks
	@cargo bench $(LOCKED) --package pliant-benches $(ARGS)

counts-check: setup ## Instructions of every stage against the stored ones; 5 % more is an error
	$(call say,instruction counts)
	@$(BIN)/python benches/counts.py

counts: setup ## Store the instructions of every stage for this compiler
	@$(BIN)/python benches/counts.py --update

aarch64: setup ## Slow: build the aarch64 wheel, run core tests and the wheel under emulation
	$(call say,aarch64)
	@tools/aarch64.sh $(CURDIR)/$(BIN)/python

peers: setup ## The same work by NumPy, Numba, Pinocchio, ... and C++ beside ours; ARGS='--rounds 60'
	$(call say,peers side by side)
	@$(BIN)/python benches/peers.py $(ARGS)

wheel: $(WHEELS)/.built ## Build wheel and source distribution into build/wheels

$(WHEELS)/.built: $(RUST) $(PY_SOURCES) pyproject.toml README.md LICENSE THIRD_PARTY_LICENSES | setup
	$(call say,wheel)
	@rm -rf $(WHEELS)
	@$(BIN)/maturin build --release $(LOCKED) --quiet --interpreter $(BIN)/python --out $(WHEELS) \
	  --compression-level 9
	@$(BIN)/python tools/recompress_wheel.py $(WHEELS)/*.whl
	@$(BIN)/maturin sdist --out $(WHEELS)
	@touch $@

windows: $(BIN)/python ## Slow: tests of core, configuration and simulator on the Windows wheel under wine; ARGS=tests/sim
	$(call say,Windows)
	@tools/windows.sh $(CURDIR)/$(BIN)/python $(ARGS)

pythons: wheel ## Unit tests on the wheel with every CPython from 3.11 to 3.14 on this machine
	$(call say,CPython 3.11 to 3.14)
	@tools/pythons.sh $(ARGS)

wheels: $(BIN)/python ## Slow: build and check the wheels of all platforms; TARGETS='x86_64-pc-windows-gnu' picks
	@tools/wheels.sh $(CURDIR)/$(BIN)/python $(TARGETS)

release-check: setup ## Slow: rehearse a release without the upload; TARGETS='x86_64-pc-windows-gnu' picks
	@$(BIN)/python tools/release_check.py $(TARGETS)

notices: setup ## Write THIRD_PARTY_LICENSES for the crates of Cargo.lock
	@$(BIN)/python tools/notices.py

fmt: setup ## Format all sources
	@cargo fmt --all
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

clean: ## Remove everything that make made
	rm -rf $(VENV) build docs/_build target .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find python experiments benches tests -name __pycache__ -type d -prune -exec rm -rf {} +
	rm -f python/pliant/_core*.so
