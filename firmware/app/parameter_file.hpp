/// Reads a parameter file: TOML with `name = value` lines. Start-up only, may allocate.
#pragma once

#include <cstddef>

#include "params.gen.hpp"

namespace noctule {

/// Sets the parameters that the file names (row name or MAVLink id); the others keep their value.
/// False: the file cannot be read, is no TOML, names an unknown parameter, or a value is not a number, out of range or not
/// whole; `error` then holds one line with file and line number, and `parameters` is as it was.
[[nodiscard]] bool load_parameters(const char* path, Parameters& parameters, char* error, std::size_t error_size);

}  // namespace noctule
