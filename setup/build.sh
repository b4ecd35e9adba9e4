#!/usr/bin/env bash
# Configures once and builds: build.sh PRESET TARGET JOBS. Quiet while there is nothing to say.
set -euo pipefail
cd "$(dirname "$0")/.."
preset=$1 target=$2 jobs=$3
if [ ! -f "build/$preset/build.ninja" ]; then
    echo "build: configuring build/$preset"
    mkdir -p "build/$preset"
    cmake --preset "$preset" ${UNITY_DIR:+-DUNITY_DIR="$UNITY_DIR"} >"build/$preset/configure.log" || { cat "build/$preset/configure.log"; exit 1; }
fi
cmake --build --preset "$preset" --target "$target" --parallel "$jobs"
