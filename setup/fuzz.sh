#!/usr/bin/env bash
# Runs every fuzz test with libFuzzer: fuzz.sh JOBS SECONDS. What it learns is kept in build/fuzz/corpus. Stops at the first broken promise; the
# input is then in build/fuzz/crash-*, and `build/dev/tests/NAME FILE` runs it under gcc.
set -euo pipefail
cd "$(dirname "$0")/.."
jobs=$1 seconds=$2
for program in clang-14 clang++-14; do
    if ! command -v "$program" >/dev/null; then
        echo "fuzz: no $program found: apt-get install clang-14 libclang-rt-14-dev" >&2
        exit 2
    fi
done
setup/build.sh fuzz noctule_fuzz "$jobs"
setup/build.sh release noctule_fuzz "$jobs" # its driver writes the first inputs
for program in build/fuzz/tests/fuzz.*; do
    name=$(basename "$program")
    corpus=build/fuzz/corpus/$name
    mkdir -p "$corpus"
    "build/release/tests/$name" --corpus "$corpus"
    echo "fuzz: $name for $seconds s"
    "$program" -max_total_time="$seconds" -artifact_prefix=build/fuzz/ -print_final_stats=1 "$corpus" 2>&1 | grep -v -E '^#|NEW|REDUCE|pulse' || exit 1
done
