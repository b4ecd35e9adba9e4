# Everything above the Navigator: link, the processes, what Python loads.

# ---- link: MAVLink and LCM
file(GLOB_RECURSE link_sources CONFIGURE_DEPENDS firmware/link/*.cpp)
add_library(noctule_link STATIC ${link_sources})
target_link_libraries(noctule_link PUBLIC noctule_firmware noctule_messages noctule_mavlink PkgConfig::LCM PRIVATE noctule_options)
set_target_properties(noctule_link PROPERTIES POSITION_INDEPENDENT_CODE ON)

# ---- app: one small main a process; what the mains share is noctule_app
file(GLOB app_sources CONFIGURE_DEPENDS firmware/app/*.cpp)
list(FILTER app_sources EXCLUDE REGEX "(_main|_abi|/heap_count|/vision_node)\\.cpp$")
add_library(noctule_app STATIC ${app_sources})
target_link_libraries(noctule_app PUBLIC noctule_link PRIVATE noctule_options)
set_target_properties(noctule_app PROPERTIES POSITION_INDEPENDENT_CODE ON)

# ---- drivers: real sensors, each a process of its own
file(GLOB driver_sources CONFIGURE_DEPENDS firmware/drivers/*.cpp)
list(FILTER driver_sources EXCLUDE REGEX "/camera_[a-z_]*\\.cpp$")  # OpenCV: recognise.cmake
add_library(noctule_drivers STATIC ${driver_sources})
target_link_libraries(noctule_drivers PUBLIC noctule_app PRIVATE noctule_options)

foreach(process nav bridge profile video)
    add_executable(noctule-${process} firmware/app/${process}_main.cpp)
    target_link_libraries(noctule-${process} PRIVATE noctule_app noctule_options)
endforeach()
add_executable(noctule-lidar firmware/app/lidar_main.cpp)
target_link_libraries(noctule-lidar PRIVATE noctule_drivers noctule_options)
# The memory of the autonomy is fixed at link time: bss holds the Navigator (docs/memory.md).
find_program(SIZE_TOOL size)
if(SIZE_TOOL)
    add_custom_command(TARGET noctule-nav POST_BUILD COMMAND ${SIZE_TOOL} $<TARGET_FILE:noctule-nav> VERBATIM)
endif()

# ---- recognise: may allocate, a process of its own
file(GLOB_RECURSE recognise_sources CONFIGURE_DEPENDS firmware/recognise/*.cpp)
if(recognise_sources)
    include(cmake/recognise.cmake)
endif()

# ---- for Python: the same Navigator in-process; and the allocator count that is preloaded into noctule-nav.
# Neither goes together with the address sanitizer.
if(NOT NOCTULE_SANITIZE)
    add_library(noctule_sim_abi SHARED firmware/app/sim_abi.cpp firmware/app/altitude_abi.cpp firmware/app/replay_abi.cpp
                firmware/app/explore_abi.cpp)
    target_link_libraries(noctule_sim_abi PRIVATE noctule_link noctule_options)
    add_library(noctule_heap_count SHARED firmware/app/heap_count.cpp)
    target_include_directories(noctule_heap_count PRIVATE firmware)
    target_link_libraries(noctule_heap_count PRIVATE noctule_options ${CMAKE_DL_LIBS})
endif()
