/// The autonomy over recorded frames (frames.py), on a bare board by semihosting or on any other machine: reads frames.bin, prints the estimates.
///
/// Its static memory and stack are those of the firmware: the linker script of the board refuses a program over the RAM it is given.
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <type_traits>

#include <fcntl.h>
#include <unistd.h>

#include "navigator.hpp"
#include "params.gen.hpp"

namespace {

using namespace noctule;

/// Little-endian numbers of a file, one after the other.
class Reader {
public:
    explicit Reader(const char* const path) : file_(open(path, O_RDONLY)) {}

    [[nodiscard]] bool good() const { return good_ && file_ >= 0; }

    void bytes(void* const to, const std::size_t size) {
        auto* at = static_cast<std::uint8_t*>(to);
        for (std::size_t left = size; left > 0U && good();) {
            if (from_ == filled_) {
                const auto got = read(file_, buffer_.data(), buffer_.size());
                from_ = 0;
                filled_ = got > 0 ? static_cast<std::size_t>(got) : 0U;
                good_ = filled_ > 0U;
                continue;
            }
            const std::size_t take = left < filled_ - from_ ? left : filled_ - from_;
            std::memcpy(at, &buffer_[from_], take);
            at += take;
            from_ += take;
            left -= take;
        }
    }
    template <class T> [[nodiscard]] T next() {
        static_assert(std::is_arithmetic_v<T>);
        T value{};
        bytes(&value, sizeof value);
        return value;
    }

private:
    int file_;
    bool good_ = true;
    std::array<std::uint8_t, 4096> buffer_{};
    std::size_t from_ = 0;
    std::size_t filled_ = 0;
};

Reader reader{"frames.bin"};
const Parameters parameters{};
Navigator navigator{parameters};
SensorFrame frame;

template <class Queue, class Read> void samples(Queue& queue, Read&& read_one) {
    queue.clear();
    const auto count = reader.next<std::int32_t>();
    for (std::int32_t i = 0; i < count; ++i) { static_cast<void>(queue.push(read_one())); }
}

RangeSample range() {
    RangeSample s;
    s.t_us = reader.next<std::int64_t>();
    s.range_m = reader.next<float>();
    s.range_min_m = reader.next<float>();
    s.range_max_m = reader.next<float>();
    return s;
}

VehicleSample vehicle() {
    VehicleSample s;
    s.t_us = reader.next<std::int64_t>();
    s.armed = reader.next<std::int32_t>() != 0;
    s.offboard = reader.next<std::int32_t>() != 0;
    s.landed = static_cast<VehicleSample::Landed>(reader.next<std::int32_t>());
    s.mission_lost = reader.next<std::int32_t>() != 0;
    s.battery_remaining = reader.next<float>();
    s.local_position_valid = reader.next<std::int32_t>() != 0;
    for (float& x : s.local_map_m) { x = reader.next<float>(); }
    s.local_yaw_rad = reader.next<float>();
    return s;
}

/// False: the file ends, or holds a sweep that is too long.
bool read_frame() {
    samples(frame.imu, [] {
        ImuSample s;
        s.t_us = reader.next<std::int64_t>();
        for (float& x : s.accel_m_s2) { x = reader.next<float>(); }
        for (float& x : s.gyro_rad_s) { x = reader.next<float>(); }
        return s;
    });
    samples(frame.attitude, [] {
        AttitudeSample s;
        s.t_us = reader.next<std::int64_t>();
        s.roll_rad = reader.next<float>();
        s.pitch_rad = reader.next<float>();
        return s;
    });
    samples(frame.range_up, range);
    samples(frame.range_down, range);
    samples(frame.vehicle, vehicle);
    samples(frame.command, [] {
        CommandSample s;
        s.t_us = reader.next<std::int64_t>();
        s.order = static_cast<Order>(reader.next<std::int32_t>());
        return s;
    });
    Scan& scan = frame.scan;
    scan.t_us = reader.next<std::int64_t>();
    scan.seq = reader.next<std::int32_t>();
    scan.count = reader.next<std::int32_t>();
    for (float* const x : {&scan.time_increment_us, &scan.bearing_first_rad, &scan.bearing_increment_rad, &scan.range_min_m, &scan.range_max_m}) {
        *x = reader.next<float>();
    }
    if (scan.count < 0 || static_cast<std::size_t>(scan.count) > kMaxBeams) { return false; }
    reader.bytes(scan.range_m.data(), static_cast<std::size_t>(scan.count) * sizeof(float));
    return reader.good();
}

}  // namespace

int main() {
    const auto steps = reader.next<std::int32_t>();
    for (std::int32_t k = 0; k < steps; ++k) {
        if (!read_frame()) { return 2; }
        const NavOutput& out = navigator.step(frame);
        const Pose2<Map, Body>& pose = out.estimate.planar.pose_map_body;
        std::printf("%lld %.6f %.6f %.6f %.6f %d\n", static_cast<long long>(out.t_us), static_cast<double>(pose.x_m), static_cast<double>(pose.y_m),
                    static_cast<double>(pose.yaw_rad), static_cast<double>(out.estimate.altitude.z_m), static_cast<int>(out.state));
    }
    std::printf("tiles %d of %d, refused %u; Navigator %d bytes\n", static_cast<int>(navigator.grid().tile_count()), static_cast<int>(kMaxTiles),
                static_cast<unsigned>(navigator.grid().counters().tiles_refused), static_cast<int>(sizeof(Navigator)));
    return reader.good() && steps > 0 ? 0 : 2;
}
