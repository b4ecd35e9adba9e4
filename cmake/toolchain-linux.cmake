# What the two Linux boards share; included by toolchain-aarch64.cmake and toolchain-armhf.cmake, which set board_*.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR ${board_processor})
set(CMAKE_C_COMPILER ${board_triple}-gcc)
set(CMAKE_CXX_COMPILER ${board_triple}-g++)

if(NOT NOCTULE_SYSROOT)
    set(NOCTULE_SYSROOT "${CMAKE_CURRENT_LIST_DIR}/../build/deps/sysroot-${board_debian}")
endif()
cmake_path(ABSOLUTE_PATH NOCTULE_SYSROOT NORMALIZE)
if(NOT EXISTS ${NOCTULE_SYSROOT}/noctule.stamp)
    message(FATAL_ERROR "${NOCTULE_SYSROOT} is not there: run setup/sysroot.sh ${board_debian} first, or give -DNOCTULE_SYSROOT=")
endif()
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES NOCTULE_SYSROOT)
set(CMAKE_SYSROOT ${NOCTULE_SYSROOT})
set(CMAKE_LIBRARY_ARCHITECTURE ${board_triple})
set(CMAKE_FIND_ROOT_PATH ${NOCTULE_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)  # generators run here
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(ENV{PKG_CONFIG_SYSROOT_DIR} ${NOCTULE_SYSROOT})
set(ENV{PKG_CONFIG_LIBDIR} ${NOCTULE_SYSROOT}/usr/lib/${board_triple}/pkgconfig:${NOCTULE_SYSROOT}/usr/share/pkgconfig)

# OpenCV wants BLAS and LAPACK from folders that the alternatives of an installed system would name.
set(board_libraries ${NOCTULE_SYSROOT}/usr/lib/${board_triple})
set(CMAKE_EXE_LINKER_FLAGS_INIT "-Wl,-rpath-link,${board_libraries}:${NOCTULE_SYSROOT}/lib/${board_triple}:${board_libraries}/blas:${board_libraries}/lapack:${board_libraries}/pulseaudio")
set(CMAKE_SHARED_LINKER_FLAGS_INIT ${CMAKE_EXE_LINKER_FLAGS_INIT})

# Tests run here: `ctest --preset ...` starts each under qemu-user.
set(CMAKE_CROSSCOMPILING_EMULATOR ${board_emulator} -L ${NOCTULE_SYSROOT}
    -E LD_LIBRARY_PATH=${board_libraries}/lapack:${board_libraries}/blas:${board_libraries}/pulseaudio)
