/// The MAVLink PARAM protocol over the whole parameter table: list, read, write with types and ranges.
///
/// Two tables: `live` is what the bridge flies, `stored` what a ground station sees and what the file holds. A write changes both, except for
/// rows that need a restart, which change `stored` alone. Whole numbers go as MAV_PARAM_TYPE_INT32, encoded as the vehicle's autopilot does it
/// (ground stations choose by it): ArduPilot casts to float, all others copy the bytes. No heap, no clock.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

#include "link/mavlink.hpp"
#include "params.gen.hpp"

namespace noctule {

enum class ParameterWrite : std::uint8_t { stored, unchanged, rejected_unknown, rejected_type, rejected_range, rejected_not_whole };

class ParameterServer {
public:
    /// Both tables outlive the server; `stored` starts as a copy of `live`.
    explicit ParameterServer(Parameters& live) : live_(live), stored_(live) {}

    /// ArduPilot's encoding of whole numbers (cast to float) from now on.
    void cast_integers(const bool cast) { cast_ = cast; }
    /// The caller changed the live table before anything was written.
    void reload() { stored_ = live_; }

    /// A list is wanted. One under way goes on and then begins anew up to where it stands, so that a second ground station's wish
    /// costs the first nothing.
    void list() { left_ = kParameterTable.size(); }
    /// Rows of a list are still to be sent.
    [[nodiscard]] bool listing() const { return left_ > 0; }
    /// The next row of the list under way.
    [[nodiscard]] mavlink_param_value_t next();

    [[nodiscard]] mavlink_param_value_t value(std::size_t row) const;
    /// The row that a read or a write means: by index where that is 0 or more, else by id. kParameterTable.size(): none.
    [[nodiscard]] static std::size_t find(const char (&id)[16], std::int16_t index);

    /// A write. `row` gets the row, or the table's size.
    ParameterWrite write(const mavlink_param_set_t& in, std::size_t& row);

    [[nodiscard]] const Parameters& stored() const { return stored_; }
    /// A write since the last clear_dirty().
    [[nodiscard]] bool dirty() const { return dirty_; }
    void clear_dirty() { dirty_ = false; }

private:

    Parameters& live_;
    Parameters stored_;
    bool cast_ = false;
    bool dirty_ = false;
    std::size_t next_ = 0;
    std::size_t left_ = 0;
};

/// The id of a PARAM message, which has no end mark when it is 16 characters long.
[[nodiscard]] std::string_view parameter_id(const char (&id)[16]);

/// A whole number in the four bytes of a PARAM value, and back.
[[nodiscard]] float integer_to_wire(std::int32_t value, bool cast);
/// False for a type that is no number of 32 bits or less.
[[nodiscard]] bool value_from_wire(float wire, std::uint8_t type, bool cast, float& value);

}  // namespace noctule
