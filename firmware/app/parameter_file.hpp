/// Parameter files: TOML with `name = value` lines. Reading is for start-up and may allocate; writing does not.
#pragma once

#include <cstddef>

#include "params.gen.hpp"

namespace noctule {

/// Sets the parameters that the file names (row name or MAVLink id); the others keep their value.
/// False: the file cannot be read, is no TOML, names an unknown parameter, or a value is not a number, out of range or not
/// whole; `error` then holds one line with file and line number, and `parameters` is as it was.
[[nodiscard]] bool load_parameters(const char* path, Parameters& parameters, char* error, std::size_t error_size);

/// As above, but a file that does not exist is fine and changes nothing.
[[nodiscard]] bool load_stored_parameters(const char* path, Parameters& parameters, char* error, std::size_t error_size);

/// Writes the values that differ from `base`: into PATH.new, to the disk, then renamed, so that a loss of power leaves the old file or
/// the new one. False: errno says why; the old file is as it was. No heap.
[[nodiscard]] bool store_parameters(const char* path, const Parameters& parameters, const Parameters& base);

}  // namespace noctule
