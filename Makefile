# Everything sets itself up: `make fly` and `make test` work in a fresh clone on Debian 12.
.DEFAULT_GOAL := help
.PHONY: help setup configure build fly test test-boards fuzz memory bench clean

JOBS  ?= $(shell nproc)
WORLD ?= maze_a
ARGS  ?=
BENCH ?= flight
PARTS ?=
LOG   ?= runs/maze_a-1/flight.lcm
TIME  ?= 60

help: ## this list
	@echo "Noctule: make TARGET"
	@sed -n 's/^\([a-z-]*\):.*## /  \1\t/p' Makefile | expand -t 12

setup: ## system packages, .venv, Unity, generated Python; quick when nothing changed
	@setup/setup.sh

build: setup ## the firmware and its processes (build/release)
	@setup/build.sh release all $(JOBS)

fly: build ## a simulated flight; WORLD=maze_b ARGS="--seed 2" choose another
	@.venv/bin/noctule fly $(WORLD) $(ARGS)

test: build ## every test: C++ twice (sanitizers, release), then Python
	@setup/build.sh dev noctule_tests $(JOBS)
	@setup/test.sh $(JOBS)

test-boards: build ## cross builds for ARM, their tests and a flight under qemu, the Debian package in a chroot; PARTS="aarch64 package"
	@setup/test_boards.sh $(JOBS) $(PARTS)

fuzz: setup ## libFuzzer on everything that reads bytes from outside (clang 14); TIME=600 seconds each
	@setup/fuzz.sh $(JOBS) $(TIME)

memory: build ## docs/memory.md and its history, from the built programs and a flight; LOG=runs/maze_a-1/flight.lcm
	@.venv/bin/python -m noctule.memory_report $(LOG)

bench: build ## a table of measurements; BENCH=flight
	@.venv/bin/noctule bench $(BENCH) $(ARGS)

clean: ## removes what was built; .venv and build/deps stay
	@rm -rf build/dev build/release build/generated
