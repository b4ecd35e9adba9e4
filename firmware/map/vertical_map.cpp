#include "map/vertical_map.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kAgreesM = 0.30F;             ///< readings of a cell closer than this speak of one surface
constexpr std::int16_t kMostVotes = 10;
constexpr std::int8_t kForgotten = -2;        ///< keeps the chain of a hash together
constexpr std::size_t kMostCells = kMaxVerticalCells / 8U * 7U;

}  // namespace

static_assert((kMaxVerticalCells & (kMaxVerticalCells - 1U)) == 0U, "addressed by mask");

std::size_t VerticalMap::slot(const std::int8_t floor, const VerticalSide side, const Cell cell) {
    std::uint32_t h = static_cast<std::uint32_t>(cell.ix) * 0x9E3779B1U ^ static_cast<std::uint32_t>(cell.iy) * 0x85EBCA77U;
    h ^= (static_cast<std::uint32_t>(floor) * 2U + static_cast<std::uint32_t>(side)) * 0xC2B2AE3DU;
    return (h ^ (h >> 15U)) & (kMaxVerticalCells - 1U);
}

const VerticalCell* VerticalMap::find(const std::int8_t floor, const VerticalSide side, const Cell cell) const {
    for (std::size_t at = slot(floor, side, cell);; at = (at + 1U) & (kMaxVerticalCells - 1U)) {
        const VerticalCell& v = cells_[at];
        if (v.floor == -1) { return nullptr; }
        if (v.floor == floor && v.side == side && v.cell == cell) { return &v; }
    }
}

void VerticalMap::add(const std::int8_t floor, const VerticalSide side, const float x_m, const float y_m, const float z_m) {
    if (floor < 0 || !std::isfinite(x_m) || !std::isfinite(y_m) || !std::isfinite(z_m)) {
        ++refused_;
        return;
    }
    const Cell cell = geometry_.cell(x_m, y_m);
    std::size_t at = slot(floor, side, cell);
    while (cells_[at].floor != -1 && !(cells_[at].floor == floor && cells_[at].side == side && cells_[at].cell == cell)) {
        at = (at + 1U) & (kMaxVerticalCells - 1U);
    }
    VerticalCell& v = cells_[at];
    if (v.floor == -1) {
        if (size_ >= kMostCells) {
            ++refused_;
            return;
        }
        ++size_;
        v = {cell, floor, side, 1, z_m};
    } else if (std::fabs(v.z_m - z_m) < kAgreesM) {
        v.votes = std::min<std::int16_t>(static_cast<std::int16_t>(v.votes + 1), kMostVotes);
        v.z_m += (z_m - v.z_m) / static_cast<float>(v.votes);
    } else if (--v.votes <= 0) {
        v.votes = 1;
        v.z_m = z_m;
    }
}

void VerticalMap::forget(const std::int8_t floor) {
    for (VerticalCell& v : cells_) {
        if (v.floor == floor) { v.floor = kForgotten; }
    }
}

}  // namespace noctule
