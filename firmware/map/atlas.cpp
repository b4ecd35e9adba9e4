#include "map/atlas.hpp"

#include <bit>
#include <cstring>

namespace noctule {

namespace {

static_assert(std::endian::native == std::endian::little, "the atlas is little endian");

constexpr char kMagic[8] = {'N', 'O', 'C', 'T', 'A', 'T', 'L', 'S'};

constexpr std::array<std::uint32_t, 256> crc_table() {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t i = 0; i < 256U; ++i) {
        std::uint32_t c = i;
        for (int k = 0; k < 8; ++k) { c = (c & 1U) != 0U ? 0xEDB88320U ^ (c >> 1U) : c >> 1U; }
        table[i] = c;
    }
    return table;
}
constexpr std::array<std::uint32_t, 256> kCrcTable = crc_table();

/// Puts values one after the other; what does not fit makes `good` false and writes nothing.
class Pen {
public:
    explicit Pen(const std::span<std::uint8_t> out) : out_(out) {}
    template <class T>
    void put(const T value) {
        static_assert(std::is_arithmetic_v<T>);
        put_bytes(&value, sizeof value);
    }
    void put_bytes(const void* from, const std::size_t size) {
        if (size > out_.size() - at_) {
            good = false;
            return;
        }
        std::memcpy(out_.data() + at_, from, size);
        at_ += size;
    }
    /// Begins a section; its length is filled in by close().
    void open(const AtlasSection type, const std::int32_t floor, const std::size_t count) {
        put(static_cast<std::uint32_t>(type));
        put(floor);
        put(static_cast<std::uint32_t>(count));
        length_at_ = at_;
        put(std::uint32_t{0});
        ++sections;
    }
    void close() {
        if (!good) { return; }
        const auto length = static_cast<std::uint32_t>(at_ - length_at_ - sizeof(std::uint32_t));
        std::memcpy(out_.data() + length_at_, &length, sizeof length);
    }
    [[nodiscard]] std::size_t at() const { return at_; }

    bool good = true;
    std::uint32_t sections = 0;

private:
    std::span<std::uint8_t> out_;
    std::size_t at_ = 0;
    std::size_t length_at_ = 0;
};

void put_walls(Pen& pen, const std::int32_t floor, const Bounded<WallSegment, kMaxWalls>& walls) {
    pen.open(AtlasSection::walls, floor, walls.size());
    for (const WallSegment& w : walls) {
        for (const float v : {w.line.r_m, w.line.alpha_rad, w.end0.x_m, w.end0.y_m, w.end1.x_m, w.end1.y_m, w.r_var_m2, w.alpha_var_rad2}) { pen.put(v); }
        pen.put(static_cast<std::int32_t>(w.line.v));
        pen.put(static_cast<std::int32_t>(w.seen));
    }
    pen.close();
}

void put_tiles(Pen& pen, const AtlasFloor& floor, const OccupancyGrid& grid) {
    std::size_t count = 0;
    for (std::int32_t slot = 0; slot < grid.tile_count(); ++slot) { count += grid.tile(slot).floor == floor.layer ? 1U : 0U; }
    pen.open(AtlasSection::tiles, floor.name, count);
    pen.put(grid.geometry().cell_m());
    for (std::int32_t slot = 0; slot < grid.tile_count(); ++slot) {
        const GridTile& tile = grid.tile(slot);
        if (tile.floor != floor.layer) { continue; }
        pen.put(tile.tile_x);
        pen.put(tile.tile_y);
        pen.put_bytes(tile.log_odds.data(), tile.log_odds.size());
    }
    pen.close();
}

}  // namespace

std::uint32_t crc32(const std::span<const std::uint8_t> bytes) {
    std::uint32_t c = ~0U;
    for (const std::uint8_t b : bytes) { c = kCrcTable[(c ^ b) & 0xFFU] ^ (c >> 8U); }
    return ~c;
}

std::size_t encode_atlas(const AtlasContents& contents, const OccupancyGrid& grid, const std::span<std::uint8_t> out) {
    if (out.size() < kAtlasHeaderBytes) { return 0; }
    Pen pen(out.subspan(kAtlasHeaderBytes));
    for (const AtlasFloor& floor : contents.floors) {
        pen.open(AtlasSection::floor, floor.name, 1);
        pen.put(floor.elevation_m);
        pen.close();
        put_walls(pen, floor.name, contents.walls[static_cast<std::size_t>(floor.layer)]);
        put_tiles(pen, floor, grid);
    }
    pen.open(AtlasSection::levels, -1, contents.levels.size());
    for (const Level& l : contents.levels) {
        for (const float v : {l.z_m, l.z_var_m2, l.x_min_m, l.y_min_m, l.x_max_m, l.y_max_m}) { pen.put(v); }
        pen.put(static_cast<std::int32_t>(l.facing));
        pen.put(l.seen);
    }
    pen.close();
    pen.open(AtlasSection::passages, -1, contents.passages.size());
    for (const AtlasPassage& p : contents.passages) {
        pen.put(p.low);
        pen.put(p.high);
        pen.put(p.x_m);
        pen.put(p.y_m);
    }
    pen.close();
    pen.open(AtlasSection::refused, -1, contents.refused.size());
    for (const AtlasRefusal& r : contents.refused) {
        pen.put(r.floor);
        pen.put(r.why);
        pen.put(r.x_m);
        pen.put(r.y_m);
    }
    pen.close();
    pen.open(AtlasSection::objects, -1, contents.objects.size());
    for (const AtlasObject& o : contents.objects) {
        pen.put(o.id);
        pen.put(o.floor);
        for (const float v : {o.x_m, o.y_m, o.z_m}) { pen.put(v); }
    }
    pen.close();
    if (!pen.good) { return 0; }
    Pen head(out.first(kAtlasHeaderBytes));
    head.put_bytes(kMagic, sizeof kMagic);
    head.put(kAtlasVersion);
    head.put(pen.sections);
    head.put(contents.sequence);
    head.put(contents.t_us);
    head.put(static_cast<std::uint64_t>(pen.at()));
    head.put(crc32(out.subspan(kAtlasHeaderBytes, pen.at())));
    head.put(crc32(out.first(kAtlasHeaderBytes - sizeof(std::uint32_t))));
    return kAtlasHeaderBytes + pen.at();
}

}  // namespace noctule
