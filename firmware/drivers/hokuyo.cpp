#include "drivers/hokuyo.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

namespace noctule {

namespace {

constexpr std::int64_t kPatience_us = 500000;       // for an answer that may not come (QT, SCIP2.0)
constexpr std::int64_t kAnswer_us = 1000000;        // for one that must
constexpr std::int64_t kSpinUp_us = 5000000;        // until the first scan
constexpr std::int64_t kScanSilence_us = 1000000;   // without a scan while measuring: the sensor or the line is gone
constexpr int kTries = 3;
constexpr std::size_t kEchoWithoutCount = 13;       // "MD" steps, cluster and interval: the scans that are left follow

constexpr float kTurn_rad = 2.0F * std::numbers::pi_v<float>;

}  // namespace

float Hokuyo::bearing_increment_rad() const { return kTurn_rad / static_cast<float>(parameters_.steps_per_turn); }

float Hokuyo::bearing_first_rad() const {
    return static_cast<float>(parameters_.first_step - parameters_.front_step) * bearing_increment_rad();
}

float Hokuyo::time_increment_us() const {
    return 60e6F / static_cast<float>(parameters_.turns_per_minute) / static_cast<float>(parameters_.steps_per_turn);
}

float Hokuyo::rate_hz() const {
    return static_cast<float>(parameters_.turns_per_minute) / 60.0F / static_cast<float>(1 + scans_between_);
}

Hokuyo::Counters Hokuyo::counters() const {
    Counters all = counters_;
    all.overlong = cutter_.overlong();
    return all;
}

void Hokuyo::connected(const std::int64_t now_us) {
    cutter_.reset();
    stamped_ = false;
    tries_ = 0;
    enter(Stage::quieting, now_us);
}

void Hokuyo::enter(const Stage stage, const std::int64_t now_us) {
    stage_ = stage;
    stage_since_us_ = now_us;
    switch (stage) {
        case Stage::quieting: sink_.send("QT\n"); break;         // a scan stream of an earlier connection may still run
        case Stage::switching: sink_.send("SCIP2.0\n"); break;   // old sensors wake up with SCIP 1.1; new ones answer with an error
        case Stage::describing: sink_.send("PP\n"); break;
        case Stage::lighting: sink_.send("BM\n"); break;
        case Stage::starting: sink_.send({command_.data(), command_size_}); break;
        case Stage::idle:
        case Stage::measuring:
        case Stage::failed: break;
    }
}

void Hokuyo::fail(const char* why) {
    stage_ = Stage::failed;
    why_ = why;
}

void Hokuyo::count(const scip::Fault fault) {
    if (fault == scip::Fault::sum) {
        ++counters_.bad_sum;
    } else if (fault != scip::Fault::none) {
        ++counters_.bad_form;
    }
}

void Hokuyo::tick(const std::int64_t now_us) {
    const std::int64_t waited_us = now_us - stage_since_us_;
    switch (stage_) {
        case Stage::quieting:
            if (waited_us > kPatience_us) { enter(Stage::switching, now_us); }
            break;
        case Stage::switching:
            if (waited_us > kPatience_us) { enter(Stage::describing, now_us); }
            break;
        case Stage::describing:
        case Stage::lighting:
            if (waited_us > kAnswer_us) {
                if (++tries_ < kTries) { enter(stage_, now_us); } else { fail("the sensor does not answer"); }
            }
            break;
        case Stage::starting:
            if (waited_us > kSpinUp_us) { fail("the sensor sends no scan"); }
            break;
        case Stage::measuring:
            if (waited_us > kScanSilence_us) { fail("no scan for a second"); }
            break;
        case Stage::idle:
        case Stage::failed: break;
    }
}

void Hokuyo::receive(const std::span<const std::uint8_t> bytes, const std::int64_t now_us) {
    cutter_.feed(bytes, [&](const std::string_view message) { on_message(message, now_us); });
}

void Hokuyo::on_message(const std::string_view message, const std::int64_t now_us) {
    if (stage_ == Stage::starting || stage_ == Stage::measuring) {
        on_measuring(message, now_us);
        return;
    }
    scip::Reply reply;
    if (const scip::Fault fault = scip::read_reply(message, reply); fault != scip::Fault::none) {
        count(fault);
        return;
    }
    if (stage_ == Stage::quieting && reply.echo == "QT") {
        enter(Stage::switching, now_us);
    } else if (stage_ == Stage::switching && reply.echo == "SCIP2.0") {
        enter(Stage::describing, now_us);
    } else if (stage_ == Stage::describing && reply.echo == "PP" && reply.status == scip::kOk) {
        const scip::Fault fault = scip::read_parameters(reply.rest, parameters_);
        count(fault);
        if (fault == scip::Fault::none) {
            tries_ = 0;
            enter(Stage::lighting, now_us);
        }
    } else if (stage_ == Stage::lighting && reply.echo == "BM") {
        if (reply.status == scip::kOk || reply.status == scip::Status{'0', '2'}) {  // 02: is on already
            begin_measuring(now_us);
        } else {
            ++counters_.sensor_errors;
            fail("the sensor cannot switch its laser on");
        }
    }
}

void Hokuyo::begin_measuring(const std::int64_t now_us) {
    last_step_ = std::min(parameters_.last_step, parameters_.first_step + static_cast<std::int32_t>(kMaxBeams) - 1);
    const float sensor_hz = static_cast<float>(parameters_.turns_per_minute) / 60.0F;
    scans_between_ = wish_.rate_hz > 0.0F ? std::clamp(static_cast<std::int32_t>(std::lround(sensor_hz / wish_.rate_hz)) - 1, 0, 9) : 0;
    const int size = std::snprintf(command_.data(), command_.size(), "MD%04d%04d01%01d00\n", static_cast<int>(parameters_.first_step),
                                   static_cast<int>(last_step_), static_cast<int>(scans_between_));
    command_size_ = static_cast<std::size_t>(size);
    enter(Stage::starting, now_us);
}

void Hokuyo::on_measuring(const std::string_view message, const std::int64_t now_us) {
    const std::string_view echo{command_.data(), kEchoWithoutCount};
    // Where bytes were lost the end of one message and the whole next one come as one: the last echo is where that begins.
    const std::size_t begin = message.rfind(echo);
    scip::Reply reply;
    if (begin == std::string_view::npos) {
        ++counters_.bad_form;
        return;
    }
    if (begin != 0) { ++counters_.bad_form; }
    if (const scip::Fault fault = scip::read_reply(message.substr(begin), reply); fault != scip::Fault::none) {
        count(fault);
        return;
    }
    if (reply.status == scip::kScan) {
        on_scan(reply.rest, now_us);
    } else if (reply.status != scip::kOk) {
        // 21 to 49: stopped to check an error; 98: goes on after that; 50 to 97: broken; others: the command was refused.
        ++counters_.sensor_errors;
        if (reply.status[0] >= '5' && reply.status != scip::Status{'9', '8'}) { fail("the sensor reports a hardware fault"); }
        if (reply.status[0] < '2') { fail("the sensor refuses to measure"); }
    }
}

void Hokuyo::on_scan(const std::string_view rest, const std::int64_t now_us) {
    const scip::Fault fault = scip::read_measurement(rest, beams(), measurement_);
    if (fault != scip::Fault::none) {
        count(fault);
        return;
    }
    stage_ = Stage::measuring;
    stage_since_us_ = now_us;
    const std::uint32_t advance_ms = (measurement_.clock_ms - last_clock_ms_) % scip::kClockWrap_ms;
    if (stamped_ && advance_ms == 0) {
        ++counters_.repeated;
        return;
    }
    clock_ms_ = stamped_ ? clock_ms_ + advance_ms : measurement_.clock_ms;
    stamped_ = true;
    last_clock_ms_ = measurement_.clock_ms;
    ++counters_.scans;
    // The stamp is taken as the mirror looks straight back; the last beam comes later by its angle from there.
    const float turn = 0.5F + static_cast<float>(last_step_ - parameters_.front_step) / static_cast<float>(parameters_.steps_per_turn);
    const auto after_us = static_cast<std::int64_t>(turn * 60e6F / static_cast<float>(parameters_.turns_per_minute));
    sink_.scan(measurement_, clock_ms_ * 1000 + after_us, now_us);
}

}  // namespace noctule
