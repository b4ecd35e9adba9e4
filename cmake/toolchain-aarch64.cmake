# Raspberry Pi 4 and 5 with a 64-bit system, Jetson class.
set(board_processor aarch64)
set(board_triple aarch64-linux-gnu)
set(board_debian arm64)
set(board_emulator qemu-aarch64)
include(${CMAKE_CURRENT_LIST_DIR}/toolchain-linux.cmake)
