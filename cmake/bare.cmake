# A bare board: what every program of it is linked with, and the replay of a recorded flight in the RAM of a real one.
set(bare_dir ${CMAKE_SOURCE_DIR}/tests/boards/mps2_an500)
add_library(noctule_board OBJECT ${bare_dir}/start.cpp)
target_link_libraries(noctule_board PRIVATE noctule_options)

# ram and stack in bytes, together with the data.
function(noctule_bare_program name ram stack)
    target_link_libraries(${name} PRIVATE noctule_board)
    target_link_options(${name} PRIVATE -T ${bare_dir}/mps2-an500.ld -Wl,--defsym=noctule_ram_bytes=${ram} -Wl,--defsym=noctule_stack_bytes=${stack})
    target_compile_options(${name} PRIVATE -Wno-format)   # std::int32_t is a long here, and as wide as an int
    set_target_properties(${name} PROPERTIES LINK_DEPENDS ${bare_dir}/mps2-an500.ld)
endfunction()
