#!/usr/bin/env bash
# Runs every test: test.sh JOBS. All stages run even when an early one fails; the exit code is non-zero then.
# The last line is a runner's closing line: of pytest, or of the C++ stage that failed.
set -uo pipefail
cd "$(dirname "$0")/.."
jobs=$1
failed=()

for preset in dev release; do
    echo "test: C++ tests, preset $preset"
    log=build/$preset/ctest.log
    ctest --preset "$preset" --parallel "$jobs" | tee "$log"
    [ "${PIPESTATUS[0]}" = 0 ] || failed+=("$preset: $(grep -m1 'tests passed' "$log" || tail -1 "$log")")
done

echo "test: Python tests"
.venv/bin/python -m pytest
status=$?
for line in "${failed[@]}"; do
    echo "C++ tests, preset $line"
    status=1
done
exit $status
