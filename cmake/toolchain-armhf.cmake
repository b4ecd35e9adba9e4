# 32-bit boards with ARMv7 and VFPv3, as Debian's armhf.
set(board_processor armv7l)
set(board_triple arm-linux-gnueabihf)
set(board_debian armhf)
set(board_emulator qemu-arm)
include(${CMAKE_CURRENT_LIST_DIR}/toolchain-linux.cmake)
