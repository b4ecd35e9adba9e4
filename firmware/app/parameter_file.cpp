#include "app/parameter_file.hpp"

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

}  // namespace noctule
