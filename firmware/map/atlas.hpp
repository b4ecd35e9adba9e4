/// The atlas: all floors of the building as one run of bytes. Format and version: docs/atlas.md.
///
/// Pure: encodes what it is given into memory that the caller owns; writing it down is app/atlas_writer. Frame Map, SI, little endian.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "estimate/level.hpp"
#include "estimate/wall_filter.hpp"
#include "map/occupancy_grid.hpp"

namespace noctule {

inline constexpr std::uint32_t kAtlasVersion = 1;
inline constexpr std::size_t kAtlasHeaderBytes = 48;

enum class AtlasSection : std::uint32_t { floor = 1, walls = 2, levels = 3, tiles = 4, passages = 5, refused = 6, objects = 7 };

struct AtlasFloor {
    std::int32_t layer = 0;       ///< of the grid
    std::int32_t name = 0;        ///< number of the floor, 0 is the start's
    float elevation_m = 0.0F;
};

struct AtlasPassage {
    std::int32_t low = 0;         ///< numbers of the floors it joins
    std::int32_t high = 0;
    float x_m = 0.0F;
    float y_m = 0.0F;
};

/// An opening that was not taken; why: values of FloorPlanner::Refusal.
struct AtlasRefusal {
    std::int32_t floor = 0;
    std::int32_t why = 0;
    float x_m = 0.0F;
    float y_m = 0.0F;
};

struct AtlasObject {
    std::int32_t id = 0;
    std::int32_t floor = 0;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float z_m = 0.0F;
};

/// All but the grid. About 70 kB.
struct AtlasContents {
    std::uint64_t sequence = 0;
    std::int64_t t_us = 0;
    Bounded<AtlasFloor, kFloorSlots> floors;
    std::array<Bounded<WallSegment, kMaxWalls>, kFloorSlots> walls;   ///< by layer
    Bounded<Level, kMaxLevels> levels;
    Bounded<AtlasPassage, kFloorSlots> passages;
    Bounded<AtlasRefusal, kMaxOpenings> refused;
    Bounded<AtlasObject, kMaxAtlasObjects> objects;
};

/// CRC-32 (IEEE 802.3, reflected) of bytes.
[[nodiscard]] std::uint32_t crc32(std::span<const std::uint8_t> bytes);

/// Bytes written; 0: they do not fit. Cost: a copy of every tile of the floors named, about 1 ms for a full pool.
[[nodiscard]] std::size_t encode_atlas(const AtlasContents& contents, const OccupancyGrid& grid, std::span<std::uint8_t> out);

}  // namespace noctule
