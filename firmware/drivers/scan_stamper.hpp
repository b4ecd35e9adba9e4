/// From a sensor's measurement to the message on SCAN: bearings, metres, and the time of the last beam on the autopilot's clock.
///
/// Time: sensor's clock -> this machine's, where the least delay of the last seconds is taken for none (sensor_clock.hpp),
/// -> autopilot's clock, by the same means from the stamps of IMU. What both cannot see is the least delay itself: that of
/// the laser minus that of the inertial samples; the tunable lidar_stamp_offset_s is added for it. Only data time and passed-in host times.
#pragma once

#include <cstdint>

#include "drivers/hokuyo.hpp"
#include "drivers/sensor_clock.hpp"
#include "lcmtypes/noctule/scan_t.hpp"
#include "params.gen.hpp"

namespace noctule {

class ScanStamper {
public:
    struct Counters {
        std::uint32_t published = 0;
        std::uint32_t without_clock = 0;   ///< no IMU was heard lately: not published
        std::uint32_t backwards = 0;       ///< would not be later than the scan before: not published
        std::uint32_t clock_restarts = 0;  ///< of the autopilot
    };

    explicit ScanStamper(const Parameters& parameters) : parameters_(parameters) {}

    /// An inertial sample of autopilot time t_us arrived.
    void add_imu(const std::int64_t t_us, const std::int64_t host_us) { autopilot_.add(t_us, host_us); }

    /// The sensor was connected anew: its clock may have begun anew, too.
    void sensor_restarted() { laser_.forget(); }

    /// Fills a message. sensor_us: last beam, on the sensor's clock. False: not to be published, counted.
    /// Distances under the sensor's least are its error codes: NaN, nothing known. Those beyond range_max_m, and 65533 mm and more,
    /// are no return: infinity. range_max_m 0: as the sensor says.
    [[nodiscard]] bool fill(const Hokuyo& sensor, const scip::Measurement& measurement, std::int64_t sensor_us, std::int64_t arrival_us, float range_max_m,
                            scan_t& message);

    [[nodiscard]] Counters counters() const;

private:
    const Parameters& parameters_;
    SensorClock autopilot_;
    SensorClock laser_;
    std::int64_t last_us_ = 0;
    bool published_ = false;
    std::uint32_t restarts_seen_ = 0;
    std::int32_t seq_ = 0;
    Counters counters_;
};

}  // namespace noctule
