/// PX4: OFFBOARD follows setpoints and takes off by them. It wants them flowing (2 Hz or more, for a second) before it accepts the
/// mode, fails safe COM_OF_LOSS_T after they stop, and answers an unknown mode with DENIED. It refuses ODOMETRY of the estimator type
/// LIDAR ("unsupported") and takes it as VISION. With a global origin but a heading of vision it says that its local position is global and yet
/// publishes no global position: AUTO.LAND, its failsafes' too, then flies to 0 N 0 E. So it gets no origin.
#include "link/flavour.hpp"
#include "link/mavlink.hpp"

namespace noctule {

namespace {

constexpr std::uint32_t kMainManual = 1;
constexpr std::uint32_t kMainAltitude = 2;
constexpr std::uint32_t kMainPosition = 3;
constexpr std::uint32_t kMainAuto = 4;
constexpr std::uint32_t kMainAcro = 5;
constexpr std::uint32_t kMainOffboard = 6;
constexpr std::uint32_t kMainStabilized = 7;
constexpr std::uint32_t kSubTakeoff = 2;
constexpr std::uint32_t kSubLoiter = 3;
constexpr std::uint32_t kSubMission = 4;
constexpr std::uint32_t kSubReturn = 5;
constexpr std::uint32_t kSubLand = 6;

constexpr FlightMode mode(const std::uint32_t main, const std::uint32_t sub) {
    return {static_cast<float>(main), static_cast<float>(sub), main << 16U | sub << 24U};
}

const char* auto_name(const std::uint32_t sub) {
    switch (sub) {
        case kSubTakeoff: return "TAKEOFF";
        case kSubLoiter: return "HOLD";
        case kSubMission: return "MISSION";
        case kSubReturn: return "RETURN";
        case kSubLand: return "LAND";
        default: return "AUTO";
    }
}

const char* name(const std::uint32_t custom_mode) {
    switch (custom_mode >> 16U & 0xFFU) {
        case kMainManual: return "MANUAL";
        case kMainAltitude: return "ALTITUDE";
        case kMainPosition: return "POSITION";
        case kMainAuto: return auto_name(custom_mode >> 24U);
        case kMainAcro: return "ACRO";
        case kMainOffboard: return "OFFBOARD";
        case kMainStabilized: return "STABILIZED";
        default: return "another mode";
    }
}

constexpr PreflightRow kPreflight[] = {
    {"EKF2_EV_CTRL", 0.0F, 0.0F, 15, "15: position, height, velocity, yaw"},
    {"EKF2_HGT_REF", 3.0F, 3.0F, 0, "3: height from vision"},
    {"EKF2_GPS_CTRL", 0.0F, 0.0F, 0, "0: no GPS"},
    {"EKF2_MAG_TYPE", 5.0F, 5.0F, 0, "5: no compass"},
    {"COM_OF_LOSS_T", 0.5F, 5.0F, 0, "0.5 to 5 s"},
};

}  // namespace

const Flavour kPx4{"PX4", mode(kMainOffboard, 0), mode(kMainAuto, kSubLand), false, &name, false, kPreflight, nullptr, false, false, MAV_ESTIMATOR_TYPE_VISION};

const Flavour* flavour_of(const std::uint8_t mav_autopilot) {
    switch (mav_autopilot) {
        case MAV_AUTOPILOT_PX4: return &kPx4;
        case MAV_AUTOPILOT_ARDUPILOTMEGA: return &kArdupilot;
        default: return nullptr;
    }
}

}  // namespace noctule
