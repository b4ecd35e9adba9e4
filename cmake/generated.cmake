# Code made at build time from firmware/interface: parameter table, channel names, LCM types; and the MAVLink headers.
if(NOT EXISTS ${NOCTULE_PYTHON})
    message(FATAL_ERROR "${NOCTULE_PYTHON} is not there: run `make setup` first, or give -DNOCTULE_PYTHON=")
endif()
set(generated_dir ${CMAKE_BINARY_DIR}/generated)

file(GLOB lcm_files CONFIGURE_DEPENDS firmware/interface/lcm/*.lcm)
file(GLOB generator_files CONFIGURE_DEPENDS host/noctule/generate/*.py)
set(generated_headers ${generated_dir}/params.gen.hpp ${generated_dir}/metadata.gen.hpp ${generated_dir}/streams.gen.hpp ${generated_dir}/lcmtypes.gen.hpp)
foreach(lcm_file ${lcm_files})
    cmake_path(GET lcm_file STEM type)
    list(APPEND generated_headers ${generated_dir}/lcmtypes/noctule/${type}.hpp)
endforeach()
set(generated_checks ${generated_dir}/lcm_checks.gen.cpp)
add_custom_command(
    OUTPUT ${generated_dir}/interface.stamp
    BYPRODUCTS ${generated_headers} ${generated_checks}
    COMMAND ${CMAKE_COMMAND} -E env PYTHONPATH=${CMAKE_SOURCE_DIR}/host ${NOCTULE_PYTHON} -m noctule.generate cpp --out ${generated_dir}
    COMMAND ${CMAKE_COMMAND} -E touch ${generated_dir}/interface.stamp
    DEPENDS ${lcm_files} ${generator_files} firmware/interface/parameters.toml firmware/interface/streams.toml
    WORKING_DIRECTORY ${CMAKE_SOURCE_DIR}
    COMMENT "Generating parameters, streams and message types"
    VERBATIM)
add_custom_target(noctule_generate DEPENDS ${generated_dir}/interface.stamp)

# Parameters and channel names: our own text, compiled with our own warnings.
add_library(noctule_generated INTERFACE)
target_include_directories(noctule_generated INTERFACE ${generated_dir})
add_dependencies(noctule_generated noctule_generate)

if(NOCTULE_BARE)
    return()
endif()

# Message types of lcm-gen (SYSTEM: not our text). Its one source only holds static_asserts: lengths equal constants.
add_library(noctule_messages OBJECT ${generated_checks})
target_include_directories(noctule_messages SYSTEM PUBLIC ${generated_dir})
target_link_libraries(noctule_messages PUBLIC noctule_generated PkgConfig::LCM)
# LCM's inline coders read and write floats through int32_t*: with strict aliasing gcc drops the stores (floats decode as zero).
target_compile_options(noctule_messages PUBLIC -fno-strict-aliasing)
set_target_properties(noctule_messages PROPERTIES POSITION_INDEPENDENT_CODE ON)

# MAVLink 2 C headers of the common dialect, from the definitions inside the pinned pymavlink.
execute_process(
    COMMAND ${NOCTULE_PYTHON} -c "import pathlib, pymavlink; print(pathlib.Path(pymavlink.__file__).parent, end='')"
    OUTPUT_VARIABLE pymavlink_dir COMMAND_ERROR_IS_FATAL ANY)
set(mavlink_definitions ${pymavlink_dir}/dialects/v20/common.xml)
add_custom_command(
    OUTPUT ${generated_dir}/mavlink/common/mavlink.h
    COMMAND ${NOCTULE_PYTHON} -m pymavlink.tools.mavgen --lang=C --wire-protocol=2.0 -o ${generated_dir}/mavlink ${mavlink_definitions} > ${generated_dir}/mavgen.log
    DEPENDS ${mavlink_definitions}
    COMMENT "Generating the MAVLink headers"
    VERBATIM)
add_custom_target(noctule_generate_mavlink DEPENDS ${generated_dir}/mavlink/common/mavlink.h)
add_library(noctule_mavlink INTERFACE)
target_include_directories(noctule_mavlink SYSTEM INTERFACE ${generated_dir}/mavlink)
add_dependencies(noctule_mavlink noctule_generate_mavlink)
