#!/usr/bin/env bash
# What `make test-boards` runs: test_boards.sh JOBS [aarch64] [armhf] [cortex-m7] [flight] [package]. Each names its outcome; non-zero when one failed.
#
# Needs root the first time (cross compilers, sysroots, a chroot). An hour on two cores from nothing, mostly emulation.
set -uo pipefail
cd "$(dirname "$0")/.."
jobs=${1:-2}
shift || true
parts=("$@")
[ ${#parts[@]} -gt 0 ] || parts=(aarch64 armhf cortex-m7 flight package)
failed=()

mirror=$(awk '/^URIs:/{print $2; exit}' /etc/apt/sources.list.d/debian.sources 2>/dev/null || true)
for part in "${parts[@]}"; do
    echo "test-boards: $part"
    case $part in
        aarch64 | armhf)
            arch=armhf
            [ "$part" = armhf ] || arch=arm64
            setup/sysroot.sh "$arch" && setup/build.sh "$part" all "$jobs" &&
                ctest --preset "$part" --parallel "$jobs" ${BOARD_TESTS:+-R "$BOARD_TESTS"} || failed+=("$part")
            ;;
        cortex-m7)
            setup/sysroot.sh cortex-m7 && setup/build.sh cortex-m7 noctule_tests "$jobs" && setup/build.sh cortex-m7 frame_replay "$jobs" &&
                setup/build.sh micro frame_replay "$jobs" && ctest --preset cortex-m7 --parallel "$jobs" ${BOARD_TESTS:+-R "$BOARD_TESTS"} &&
                .venv/bin/python tests/boards/frames.py || failed+=(cortex-m7)
            ;;
        flight)
            setup/sysroot.sh arm64 && setup/build.sh aarch64 noctule-nav "$jobs" && setup/build.sh aarch64 noctule-bridge "$jobs" &&
                .venv/bin/python tests/boards/flight.py || failed+=(flight)
            ;;
        package)
            (cd build/release && cpack >cpack.log) || failed+=("package: cpack")
            .venv/bin/python tests/boards/package.py "$(ls -t build/release/noctule_*.deb | head -1)" "${mirror:-http://deb.debian.org/debian}" || failed+=(package)
            ;;
        *) failed+=("$part: no such part") ;;
    esac
done
[ ${#failed[@]} -eq 0 ] && echo "test-boards: all passed" && exit 0
echo "test-boards: failed: ${failed[*]}"
exit 1
