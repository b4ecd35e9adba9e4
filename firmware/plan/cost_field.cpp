#include "plan/cost_field.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kSteps[2] = {64.0F, 90.50967F};   ///< cost of a straight and of a diagonal step at full speed
constexpr float kTightFactor = 6.0F;              ///< slowness where the hull fits without its margin
constexpr float kSlowest = 20.0F;                 ///< keeps an edge below the ring of buckets
constexpr CellId kRimStep[8] = {0, 1, 2, 3, 4, 5, 6, 7};

}  // namespace

static_assert(CostField::kUnit == 64, "kSteps is in these units");

void OpenCells::clear() {
    head_.fill(-1);
    free_ = -1;
    used_ = 0;
    size_ = 0;
    base_ = 0;
}

bool OpenCells::push(const CellId id, const std::uint32_t cost) {
    std::int32_t node = free_;
    if (node >= 0) {
        free_ = nodes_[static_cast<std::size_t>(node)].next;
    } else if (used_ < static_cast<std::int32_t>(kMaxOpenCells)) {
        node = used_++;
    } else {
        ++refused_;
        return false;
    }
    std::int32_t& head = head_[cost % static_cast<std::uint32_t>(kBuckets)];
    nodes_[static_cast<std::size_t>(node)] = {id, head};
    head = node;
    ++size_;
    return true;
}

bool OpenCells::pop(CellId& id, std::uint32_t& cost) {
    if (size_ == 0) { return false; }
    while (head_[base_ % static_cast<std::uint32_t>(kBuckets)] < 0) { ++base_; }
    std::int32_t& head = head_[base_ % static_cast<std::uint32_t>(kBuckets)];
    const std::int32_t node = head;
    Node& n = nodes_[static_cast<std::size_t>(node)];
    id = n.id;
    cost = base_;
    head = n.next;
    n.next = free_;
    free_ = node;
    --size_;
    return true;
}

bool CostField::set(const CellId id, const std::uint16_t cost) {
    const std::size_t slot = slot_of(id);
    if (tile_run_[slot] != run_ && pages_ == kMaxFieldTiles) {
        ++refused_;
        return false;
    }
    if (tile_run_[slot] != run_) {
        tile_run_[slot] = run_;
        page_[slot] = static_cast<std::uint16_t>(pages_);
        cost_[pages_].fill(kPackedFar);
        ++pages_;
    }
    cost_[page_[slot]][in_tile(id)] = cost;
    return true;
}

void CostField::start(const OccupancyGrid& grid, const CellId root, const std::int32_t free_radius, OpenCells& open) {
    run_ = ++runs_;
    pages_ = 0;
    root_ = root;
    free_radius_ = free_radius;
    settled_ = 0;
    stop_at_ = kFar;
    done_ = root == kNoCell;
    open.clear();
    if (done_) { return; }
    root_cell_ = grid.cell(root);
    static_cast<void>(set(root, 0));
    static_cast<void>(open.push(root, 0));
}

void RootGraph::clear(const std::size_t roots) {
    size_ = roots;
    for (std::size_t a = 0; a < roots; ++a) {
        distance_[a].fill(CostField::kFar);
        distance_[a][a] = 0;
    }
}

void RootGraph::close() {
    for (std::size_t k = 0; k < size_; ++k) {
        for (std::size_t a = 0; a < size_; ++a) {
            const std::uint32_t first = distance_[a][k];
            if (first == CostField::kFar || a == k) { continue; }
            for (std::size_t b = 0; b < size_; ++b) {
                const std::uint32_t second = distance_[k][b];
                if (second != CostField::kFar && first + second < distance_[a][b]) { distance_[a][b] = first + second; }
            }
        }
    }
}

bool CostField::add_root(const CellId root, const std::uint8_t number, RootGraph& graph, OpenCells& open) {
    const bool first = cost(root) != 0U;
    if (first && !set(root, 0)) { return false; }
    graph.nearest_[page_[slot_of(root)]][in_tile(root)] = number;
    return !first || open.push(root, 0);
}

bool CostField::run(const OccupancyGrid& grid, const Traversability& where, OpenCells& open, const std::int32_t budget,
                    const CellId until, const std::uint32_t beyond, RootGraph* const graph) {
    if (done_) { return true; }
    // By the byte that Traversability keeps of a cell: what a straight and a diagonal step into it cost; 0: not entered.
    // A tight cell is left, or entered from its like or from a passable one, but never crossed to come back out.
    using Edges = std::array<std::array<std::uint16_t, 2>, 256>;
    Edges from_passable{};
    Edges from_tight{};
    for (std::int32_t v = 0; v < 256; ++v) {
        const bool crossed = where.passable_byte(v);
        if (!crossed && !Traversability::tight_byte(v)) { continue; }
        const float slow = crossed ? where.slowness_byte(v) : kTightFactor;
        for (std::size_t d = 0; d < 2; ++d) {
            const auto cost = static_cast<std::uint16_t>(kSteps[d] * std::min(slow, kSlowest));
            from_passable[static_cast<std::size_t>(v)][d] = cost;
            from_tight[static_cast<std::size_t>(v)][d] = crossed ? std::uint16_t{0} : cost;
        }
    }
    CellId id = kNoCell;
    std::uint32_t at = 0;
    for (std::int32_t k = 0; k < budget; ++k) {
        if (!open.pop(id, at)) {
            done_ = true;
            return true;
        }
        auto& page = cost_[page_[slot_of(id)]];   // an entry's cell has a cost
        const std::uint16_t here = page[in_tile(id)];
        if (unpack(here) != at) { continue; }  // a cheaper way was found after this entry was made
        if (at > stop_at_) {
            done_ = true;
            return true;
        }
        ++settled_;
        if (id == until) { stop_at_ = at + beyond; }
        const Edges& edges = where.passable(id) || near_root(grid.cell(id)) ? from_passable : from_tight;
        // What is known of the cells round it: read where it stands if they are in the same tile, else gathered.
        const bool inside = OccupancyGrid::inside_tile(id);
        Rim rim;
        if (!inside) { gather(grid, where, graph, id, rim); }
        const CellId* const step = inside ? kNeighbourStep : kRimStep;
        const std::uint16_t* const cost_at = inside ? &page[in_tile(id)] : rim.cost.data();
        const std::uint8_t* const byte_at = inside ? where.bytes(id) : rim.byte.data();
        const std::uint8_t* const own = graph == nullptr ? nullptr : &graph->nearest_[page_[slot_of(id)]][in_tile(id)];
        const std::uint8_t* const owner_at = inside ? own : rim.owner.data();
        for (std::size_t d = 0; d < 8; ++d) {
            const CellId s = step[d];
            const std::uint16_t known = cost_at[s];
            if (known <= here && (graph == nullptr || owner_at[s] == *own)) { continue; }  // costs keep their order when packed
            const std::uint32_t edge = edges[byte_at[s]][d & 1U];
            if (edge == 0U) { continue; }
            const std::uint16_t through = packed_sum(here, at + edge);
            if (through < known) {
                const CellId next = inside ? id + s : rim.id[d];
                if (!set(next, through)) { continue; }
                static_cast<void>(open.push(next, unpack(through)));
                if (graph != nullptr) { graph->nearest_[page_[slot_of(next)]][in_tile(next)] = *own; }
            } else if (graph != nullptr && known != kPackedFar && through != kPackedFar && owner_at[s] != *own) {
                graph->meet(owner_at[s], *own, unpack(through) + unpack(known));
            }
        }
    }
    return false;
}

void CostField::gather(const OccupancyGrid& grid, const Traversability& where, const RootGraph* const graph, const CellId id, Rim& rim) const {
    for (std::size_t d = 0; d < 8; ++d) {
        const CellId next = grid.neighbour(id, static_cast<std::int32_t>(d));
        rim.id[d] = next;
        rim.byte[d] = next == kNoCell ? std::uint8_t{0} : *where.bytes(next);
        rim.cost[d] = next == kNoCell ? kPackedFar : packed(next);
        if (graph != nullptr && rim.cost[d] != kPackedFar) { rim.owner[d] = graph->nearest_[page_[slot_of(next)]][in_tile(next)]; }
    }
}

}  // namespace noctule
