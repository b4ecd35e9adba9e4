#include "app/parameter_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <limits>
#include <string_view>

#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

namespace noctule {

namespace {

/// Empty: stored. Otherwise what is wrong with the entry.
std::string_view store(Parameters& parameters, const std::string_view name, const toml::node& node) {
    const ParameterRow* row = find_parameter(name);
    if (row == nullptr) { return "is no parameter"; }
    if (!node.is_number()) { return "must be a number"; }
    const double value = node.value<double>().value_or(std::numeric_limits<double>::quiet_NaN());
    switch (set_parameter(parameters, *row, static_cast<float>(value))) {
        case ParameterSet::stored: return {};
        case ParameterSet::rejected_range: return "is out of range";
        case ParameterSet::rejected_not_whole: return "must be a whole number";
    }
    return "cannot be set";
}

}  // namespace

bool load_parameters(const char* path, Parameters& parameters, char* error, const std::size_t error_size) {
    const toml::parse_result parsed = toml::parse_file(path);
    if (!parsed) {
        const std::string_view what = parsed.error().description();
        std::snprintf(error, error_size, "%s:%u: %.*s", path, static_cast<unsigned>(parsed.error().source().begin.line), static_cast<int>(what.size()), what.data());
        return false;
    }
    Parameters changed = parameters;
    for (const auto& [key, node] : parsed.table()) {
        const std::string_view name = key.str();
        const std::string_view problem = store(changed, name, node);
        if (problem.empty()) { continue; }
        const ParameterRow* row = find_parameter(name);
        const int name_length = static_cast<int>(name.size());
        const int problem_length = static_cast<int>(problem.size());
        const auto line = static_cast<unsigned>(node.source().begin.line);
        if (row != nullptr) {
            std::snprintf(error, error_size, "%s:%u: %.*s %.*s (%g to %g)", path, line, name_length, name.data(), problem_length, problem.data(),
                          static_cast<double>(row->min), static_cast<double>(row->max));
        } else {
            std::snprintf(error, error_size, "%s:%u: %.*s %.*s", path, line, name_length, name.data(), problem_length, problem.data());
        }
        return false;
    }
    parameters = changed;
    return true;
}

bool load_stored_parameters(const char* path, Parameters& parameters, char* error, const std::size_t error_size) {
    if (::access(path, F_OK) != 0 && errno == ENOENT) { return true; }
    return load_parameters(path, parameters, error, error_size);
}

bool store_parameters(const char* path, const Parameters& parameters, const Parameters& base) {
    static std::array<char, 32768> text;
    static std::array<char, 4096> beside;
    const int named = std::snprintf(beside.data(), beside.size(), "%s.new", path);
    if (named < 0 || static_cast<std::size_t>(named) >= beside.size()) {
        errno = ENAMETOOLONG;
        return false;
    }
    std::size_t used = static_cast<std::size_t>(std::snprintf(text.data(), text.size(), "# Written by noctule-bridge: what ground stations changed.\n"));
    for (const ParameterRow& row : kParameterTable) {
        const float value = parameter_value(parameters, row);
        if (value == parameter_value(base, row)) { continue; }
        const int length = std::snprintf(text.data() + used, text.size() - used, row.as_int != nullptr ? "%.*s = %.0f\n" : "%.*s = %.9g\n",
                                         static_cast<int>(row.name.size()), row.name.data(), static_cast<double>(value));
        if (length < 0 || used + static_cast<std::size_t>(length) >= text.size()) {
            errno = ENOSPC;
            return false;
        }
        used += static_cast<std::size_t>(length);
    }
    const int file = ::open(beside.data(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (file < 0) { return false; }
    const bool written = ::write(file, text.data(), used) == static_cast<ssize_t>(used) && ::fsync(file) == 0;
    const bool closed = ::close(file) == 0;
    return written && closed && ::rename(beside.data(), path) == 0;
}

}  // namespace noctule
