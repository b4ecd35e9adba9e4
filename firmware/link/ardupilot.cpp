/// ArduCopter: GUIDED follows setpoints in the air only; on the ground it waits for MAV_CMD_NAV_TAKEOFF. Position with velocity lets its
/// own time-out act (position alone never times out). On getting its global origin it takes its present height for zero, and vision then adds that height
/// again, unless its field elevation was set before. Arming may be refused for long while its filter settles: it is asked again.
#include "link/flavour.hpp"
#include "link/mavlink.hpp"

namespace noctule {

namespace {

constexpr std::uint32_t kGuided = 4;
constexpr std::uint32_t kLand = 9;

constexpr FlightMode mode(const std::uint32_t number) { return {static_cast<float>(number), 0.0F, number}; }

const char* name(const std::uint32_t custom_mode) {
    switch (custom_mode) {
        case 0: return "STABILIZE";
        case 1: return "ACRO";
        case 2: return "ALT_HOLD";
        case 3: return "AUTO";
        case kGuided: return "GUIDED";
        case 5: return "LOITER";
        case 6: return "RTL";
        case kLand: return "LAND";
        case 16: return "POSHOLD";
        case 17: return "BRAKE";
        case 20: return "GUIDED_NOGPS";
        case 21: return "SMART_RTL";
        default: return "another mode";
    }
}

constexpr PreflightRow kPreflight[] = {
    {"VISO_TYPE", 1.0F, 3.0F, 0, "1: vision over MAVLink"},
    {"EK3_SRC1_POSXY", 6.0F, 6.0F, 0, "6: vision"},
    {"EK3_SRC1_VELXY", 6.0F, 6.0F, 0, "6: vision"},
    {"EK3_SRC1_POSZ", 6.0F, 6.0F, 0, "6: vision"},
    {"EK3_SRC1_VELZ", 6.0F, 6.0F, 0, "6: vision"},
    {"EK3_SRC1_YAW", 6.0F, 6.0F, 0, "6: vision"},
    {"COMPASS_ENABLE", 0.0F, 0.0F, 0, "0: no compass indoors"},
    {"WP_YAW_BEHAVIOR", 0.0F, 0.0F, 0, "0: yaw is ours"},
};

}  // namespace

const Flavour kArdupilot{"ArduPilot", mode(kGuided), mode(kLand), true, &name, true, kPreflight, "BARO_FIELD_ELV", true, true, MAV_ESTIMATOR_TYPE_LIDAR};

}  // namespace noctule
