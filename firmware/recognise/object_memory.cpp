#include "recognise/object_memory.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace noctule {
namespace {

constexpr double kTurn = 6.283185307179586;
constexpr double kSectorCap = 4.0;          // sightings from one direction count as so many: their errors are alike
constexpr double kOffset_m = 0.10;          // what two views of one thing may differ by beyond their covariance
constexpr double kSettled_m = 0.04;         // the same of an object that was seen well several times
constexpr double kGateFree_m = 0.25;        // gate: this, and half the width, and three sigmas
constexpr double kGateMost_m = 0.90;
constexpr double kGatePoor_m = 2.0;
constexpr float kUnlike = 0.35F;            // colours with less in common belong to two things
constexpr float kAlike = 0.60F;
constexpr std::int32_t kVerified = 8;       // matches that one similarity explains
constexpr std::int32_t kReunited = 10;
constexpr std::int32_t kConfirmSightings = 7;
constexpr double kConfirmWhole = 2.0;      // good sightings: whole, with a range of its own
constexpr std::int64_t kConfirmAge_us = 600000;
constexpr double kConfirmSigma_m = 0.35;
constexpr std::int32_t kConfirmPlaces = 2;   // places of the camera
constexpr std::int32_t kConfirmRanged = 2;   // sightings that the laser ranged; else the lines of sight must meet where the object is
constexpr double kMeetSigma_m = 0.40;
constexpr double kMeetOff_m = 0.30;
constexpr std::int32_t kMeetPlaces = 4;
constexpr double kMeetApart_rad = 0.04;      // lines that miss each other by more are not of one thing
constexpr double kRefuteOff_m = 0.60;
constexpr double kOpening_m = 1.5;           // from a place over or under an opening to what may still be in it
constexpr double kOverhead_m = 0.5;          // over the vehicle: what is seen through the ceiling shows above that only
constexpr double kGroundApart_m = 0.2;
constexpr double kAbsentStep_m = 0.15;
constexpr std::int32_t kAbsent = 5;          // places from which it was not to be seen, and more than those from which it was
constexpr std::int64_t kForget_us = 30000000;   // a candidate without laser ranges that was not seen for so long goes
constexpr double kWidthLeast_m = 0.12;
constexpr double kPatch = 0.5;              // a region narrower than this share of the object is a patch of it
constexpr double kOnSurface_m = 0.08;
constexpr double kWidthMost_m = 2.5;
constexpr double kOutlier_sigma = 3.0;
constexpr float kRatio = 0.85F;

std::size_t sector_of(const double direction_rad, const std::size_t sectors) {
    const double turns = direction_rad / kTurn + 1.0;
    return static_cast<std::size_t>((turns - std::floor(turns)) * static_cast<double>(sectors)) % sectors;
}

/// Information of one placement: 1 / along^2 along the bearing, 1 / across^2 across it, equation (24).
SectorInformation information_of(const Placement& p) {
    const double c = std::cos(p.bearing_rad);
    const double s = std::sin(p.bearing_rad);
    const double a = 1.0 / (p.along_sigma_m * p.along_sigma_m);
    const double b = 1.0 / (p.across_sigma_m * p.across_sigma_m);
    SectorInformation i;
    i.xx = a * c * c + b * s * s;
    i.xy = (a - b) * c * s;
    i.yy = a * s * s + b * c * c;
    i.x = i.xx * p.x_m + i.xy * p.y_m;
    i.y = i.xy * p.x_m + i.yy * p.y_m;
    i.count = 1.0;
    return i;
}

/// Squared distance of a placement from an object in sigmas, both covariances and the offset counted, equation (22).
double square_sigmas(const KnownObject& object, const Placement& p, const double offset_m = kOffset_m) {
    const double c = std::cos(p.bearing_rad);
    const double s = std::sin(p.bearing_rad);
    const double a = p.along_sigma_m * p.along_sigma_m;
    const double b = p.across_sigma_m * p.across_sigma_m;
    const double xx = object.xx_m2 + a * c * c + b * s * s + offset_m * offset_m;
    const double xy = object.xy_m2 + (a - b) * c * s;
    const double yy = object.yy_m2 + a * s * s + b * c * c + offset_m * offset_m;
    const double dx = p.x_m - object.x_m;
    const double dy = p.y_m - object.y_m;
    return (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / std::max(xx * yy - xy * xy, 1.0e-12);
}

void mean_into(double& mean, double& weight, const double value, const double w) {
    weight += w;
    mean += (value - mean) * w / weight;
}

/// Whether two heights can belong to one thing.
bool heights_meet(const double z_a, const double height_a, const double z_b, const double height_b) {
    return std::fabs(z_a - z_b) < 0.5 * (height_a + height_b) + 0.2;
}

double away_m(const Vec3& point_m, const KnownObject& object) {
    return std::hypot(point_m[0] - object.x_m, point_m[1] - object.y_m, point_m[2] - object.z_m);
}

/// Whether the first is a spot on the second: much smaller, not better known, inside its outline, on its surface. Its colour does not matter.
bool patch_of(const KnownObject& small, const KnownObject& large) {
    return small.strong <= large.strong && small.width_m < kPatch * large.width_m && small.height_m < kPatch * large.height_m &&
           std::fabs(small.z_m - large.z_m) < 0.5 * large.height_m &&
           std::hypot(small.x_m - large.x_m, small.y_m - large.y_m) < 0.5 * large.width_m + kOnSurface_m;
}

}  // namespace

double KnownObject::sigma_m() const {
    const double mean = 0.5 * (xx_m2 + yy_m2);
    const double spread = std::sqrt(std::max(0.0, 0.25 * (xx_m2 - yy_m2) * (xx_m2 - yy_m2) + xy_m2 * xy_m2));
    return std::sqrt(std::max(0.0, mean + spread));
}

std::int32_t ObjectMemory::confirmed() const {
    std::int32_t n = 0;
    for (const KnownObject& object : objects_) { n += object.confirmed ? 1 : 0; }
    return n;
}

std::int32_t ObjectMemory::verified_matches(const std::span<const SurfFeature> features, const KnownObject& object) {
    std::int32_t most = 0;
    for (const ObjectView& view : object.views) {
        if (!view.used || view.features.size() < static_cast<std::size_t>(kVerified)) { continue; }
        match_surf(features, {view.features.begin(), view.features.size()}, kRatio, true, matches_);
        if (matches_.size() < static_cast<std::size_t>(kVerified)) { continue; }
        pairs_.clear();
        for (const SurfMatch& m : matches_) {
            const SurfPoint& a = features[static_cast<std::size_t>(m.first)].point;
            const SurfPoint& b = view.features[static_cast<std::size_t>(m.second)].point;
            static_cast<void>(pairs_.push({a.x_px, a.y_px, b.x_px, b.y_px}));
        }
        PlaneFitSettings settings;
        settings.tolerance_px = 4.0F;
        settings.trials = 200;
        if (fit_similarity({pairs_.begin(), pairs_.size()}, settings, fit_)) { most = std::max(most, fit_.inliers); }
    }
    return most;
}

int ObjectMemory::find(const Observation& observation, bool& verified) {
    const Placement& p = observation.part.place;
    verified = false;
    int best = -1;
    double best_cost = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < objects_.size(); ++i) {
        const KnownObject& object = objects_[i];
        if (!object.placed || object.floor != observation.floor) { continue; }
        const double distance_m = std::hypot(p.x_m - object.x_m, p.y_m - object.y_m);
        const double squares = square_sigmas(object, p);
        const double reach_m = kGateFree_m + 0.5 * std::max(p.width_m, object.width_m);
        const double gate_m = std::min(kGateMost_m, reach_m + (p.whole ? 0.0 : 0.3));
        // Where the range is poor (or was, so far), along the line of sight it may be farther.
        const double most_m = std::max(p.along_sigma_m, object.sigma_m()) > 0.4 ? kGatePoor_m : kGateMost_m;
        if (distance_m > gate_m && !(squares < 9.0 && distance_m < most_m)) { continue; }
        const float likeness = colour_likeness(observation.signature, object.signature);
        const bool meet = heights_meet(p.z_m, p.height_m, object.z_m, object.height_m);
        if (likeness < kUnlike && (distance_m > 0.25 || !meet)) { continue; }
        if (!meet && likeness < kAlike) { continue; }
        // Position and looks decided together, equation (23).
        double cost = std::min(squares, 16.0) + 12.0 * static_cast<double>(1.0F - likeness);
        bool by_texture = false;
        if (object.textured() && observation.features.size() >= static_cast<std::size_t>(kVerified)) {
            by_texture = verified_matches(observation.features, object) >= kVerified;
            cost -= by_texture ? 6.0 : 0.0;
        }
        if (cost < best_cost) {
            best_cost = cost;
            best = static_cast<int>(i);
            verified = by_texture;
        }
    }
    return best;
}

int ObjectMemory::enter(const Observation& observation) {
    ++counters_.observations;
    const Placement& p = observation.part.place;
    if (p.source == RangeSource::none) {
        ++counters_.without_place;
        return -1;
    }
    bool verified = false;
    int index = find(observation, verified);
    if (index >= 0) {
        ++counters_.matched;
        counters_.verified += verified ? 1U : 0U;
    } else {
        // A new one begins with a good sight of it: a part of a thing makes a bad candidate.
        if (!p.whole || p.width_m < kWidthLeast_m || p.width_m > kWidthMost_m) { return -1; }
        if (objects_.full()) {
            std::size_t weakest = objects_.size();
            for (std::size_t i = 0; i < objects_.size(); ++i) {
                if (!objects_[i].confirmed && (weakest == objects_.size() || objects_[i].sightings < objects_[weakest].sightings)) { weakest = i; }
            }
            if (weakest == objects_.size()) {
                ++counters_.refused;
                return -1;
            }
            remove(weakest, 0);
            ++counters_.dropped;
        }
        static const KnownObject fresh{};
        static_cast<void>(objects_.push(fresh));
        index = static_cast<int>(objects_.size()) - 1;
        KnownObject& object = objects_.back();
        object.id = next_id++;
        object.placed = true;
        object.floor = observation.floor;
        object.first_seen_us = observation.t_us;
        ++counters_.created;
    }
    fuse(objects_[static_cast<std::size_t>(index)], observation);
    return index;
}

void ObjectMemory::fuse(KnownObject& object, const Observation& observation) {
    const Placement& p = observation.part.place;
    object.changed = true;
    object.last_seen_us = observation.t_us;
    ++object.sightings;
    object.whole += p.whole ? 1 : 0;
    // The wall behind is no range of the thing itself, and the floor far off a poor one: many such sightings are wanted.
    const bool own_range = p.source == RangeSource::laser || (p.source == RangeSource::floor && p.along_sigma_m < 0.3);
    object.strong += p.whole ? (own_range ? 1.0 : 0.15) : 0.0;
    object.ranged += p.whole && p.source == RangeSource::laser ? 1 : 0;
    if (p.whole && p.tall) { object.parallax.add(p.eye_m, p.bearing_rad, p.slope, p.distance_m); }
    mean_into(object.features_mean, object.signature_weight, static_cast<double>(observation.features.size()), 1.0);
    const float share = static_cast<float>(1.0 / std::min(object.signature_weight, 30.0));
    for (std::size_t i = 0; i < kColourBins; ++i) { object.signature.colour[i] += share * (observation.signature.colour[i] - object.signature.colour[i]); }
    if (p.whole && p.tall) {
        for (std::size_t i = 0; i < 7; ++i) { object.signature.moments[i] += share * (observation.signature.moments[i] - object.signature.moments[i]); }
    }
    const bool fresh = object.xx_m2 <= 0.0;
    if (!fresh && square_sigmas(object, p, object.strong > 4.0 ? kSettled_m : kOffset_m) > kOutlier_sigma * kOutlier_sigma) {
        ++counters_.outliers;
    } else if (fresh || p.whole) {
        SectorInformation& sector = object.sectors[sector_of(observation.direction_rad, kSectors)];
        const SectorInformation one = information_of(p);
        sector.xx += one.xx;
        sector.xy += one.xy;
        sector.yy += one.yy;
        sector.x += one.x;
        sector.y += one.y;
        sector.count += 1.0;
        const double near = 1.0 / (p.distance_m * p.distance_m);
        // A patch of the surface, seen from close by, says nothing of the size of the whole.
        const bool patch = object.width_weight > 0.0 && p.width_m < kPatch * object.width_m;
        if (p.tall && !patch) { mean_into(object.height_m, object.height_weight, p.height_m, near); }
        if (!patch) { mean_into(object.width_m, object.width_weight, p.width_m, near); }
        mean_into(object.z_m, object.z_weight, p.z_m, p.tall ? near : 0.1 * near);
        if (object.height_weight <= 0.0) { object.height_m = std::max(object.height_m, p.height_m); }
        solve(object);
    }
    keep_view(object, observation);
    if (!object.confirmed && sure(object)) { object.confirmed = true; }
}

const ObjectMemory::Ground* ObjectMemory::nearest(const Grounds& grounds, const std::int32_t floor, const double x_m, const double y_m, double& distance_m) {
    const Ground* found = nullptr;
    distance_m = std::numeric_limits<double>::infinity();
    for (const Ground& g : grounds) {
        if (g.floor != floor) { continue; }
        const double away = std::hypot(static_cast<double>(g.x_m) - x_m, static_cast<double>(g.y_m) - y_m);
        if (away < distance_m) {
            distance_m = away;
            found = &g;
        }
    }
    return found;
}

void ObjectMemory::note(Openings& openings, const std::int32_t floor, const double x_m, const double y_m, const double z_m, const bool open) {
    Grounds& grounds = open ? openings.open : openings.solid;
    double away = 0.0;
    static_cast<void>(nearest(grounds, floor, x_m, y_m, away));
    if (away < kGroundApart_m) { return; }
    if (grounds.full()) { grounds.drop_front(1); }
    static_cast<void>(grounds.push({floor, static_cast<float>(x_m), static_cast<float>(y_m), static_cast<float>(z_m)}));
}

const ObjectMemory::Ground* ObjectMemory::opening_at(const Openings& openings, const KnownObject& object) {
    double open_m = 0.0;
    double solid_m = 0.0;
    const Ground* const found = nearest(openings.open, object.floor, object.x_m, object.y_m, open_m);
    static_cast<void>(nearest(openings.solid, object.floor, object.x_m, object.y_m, solid_m));
    return open_m < kOpening_m && open_m < solid_m ? found : nullptr;
}

bool ObjectMemory::through_opening(const KnownObject& object) const {
    if (opening_at(ground_, object) != nullptr) { return true; }
    const Ground* const under = opening_at(ceiling_, object);
    return under != nullptr && object.z_m - 0.5 * object.height_m > static_cast<double>(under->z_m) + kOverhead_m;
}

bool ObjectMemory::sure(const KnownObject& object) const {
    const bool seen_enough = object.sightings >= kConfirmSightings && object.strong >= kConfirmWhole && object.parallax.places() >= kConfirmPlaces &&
                             object.last_seen_us - object.first_seen_us >= kConfirmAge_us;
    if (!seen_enough || object.sigma_m() >= kConfirmSigma_m || std::max(object.width_m, object.height_m) < kWidthLeast_m) { return false; }
    if (object.ranged >= kConfirmRanged) { return true; }
    // Its range rests on an assumption, that it stands on this floor or hangs on that wall: the lines of sight must agree, equation (28).
    Parallax::Meeting m;
    if (through_opening(object) || !object.parallax.meet(m) || object.parallax.places() < kMeetPlaces || m.sigma_m > kMeetSigma_m || m.apart_rad > kMeetApart_rad) { return false; }
    return away_m(m.point_m, object) < kMeetOff_m + m.sigma_m;
}

bool ObjectMemory::refuted(const KnownObject& object) const {
    if (object.ranged >= kConfirmRanged) { return false; }
    if (through_opening(object)) { return true; }
    if (object.absent >= kAbsent && object.absent > object.parallax.places()) { return true; }
    Parallax::Meeting m;
    if (!object.parallax.meet(m) || m.sigma_m > kMeetSigma_m) { return false; }
    return away_m(m.point_m, object) > kRefuteOff_m + 3.0 * m.sigma_m;
}

void ObjectMemory::note_absent(const std::size_t index, const Vec3& eye_m) {
    KnownObject& object = objects_[index];
    const Vec3& last = object.absent_m;
    if (object.absent > 0 && std::hypot(eye_m[0] - last[0], eye_m[1] - last[1], eye_m[2] - last[2]) < kAbsentStep_m) { return; }
    object.absent_m = eye_m;
    ++object.absent;
}

void ObjectMemory::solve(KnownObject& object) const {
    // Equation (25): the sectors' information, each at most kSectorCap sightings' worth.
    double xx = 0.0;
    double xy = 0.0;
    double yy = 0.0;
    double x = 0.0;
    double y = 0.0;
    for (const SectorInformation& s : object.sectors) {
        if (s.count <= 0.0) { continue; }
        const double scale = std::min(1.0, kSectorCap / s.count);
        xx += scale * s.xx;
        xy += scale * s.xy;
        yy += scale * s.yy;
        x += scale * s.x;
        y += scale * s.y;
    }
    const double det = xx * yy - xy * xy;
    if (!(det > 1.0e-12)) { return; }
    object.x_m = (yy * x - xy * y) / det;
    object.y_m = (xx * y - xy * x) / det;
    object.xx_m2 = yy / det;
    object.xy_m2 = -xy / det;
    object.yy_m2 = xx / det;
}

void ObjectMemory::keep_view(KnownObject& object, const Observation& observation) {
    const Placement& p = observation.part.place;
    const Region& r = observation.part.region;
    // A good picture is whole, large and sharp; one a sector, so that the object is known from all sides.
    const double quality = (p.whole ? 2.0 : 1.0) * (p.tall ? 1.5 : 1.0) * std::sqrt(static_cast<double>(r.area_px)) * (1.0 + observation.sharpness);
    ObjectView& view = object.views[sector_of(observation.direction_rad, kMaxObjectViews)];
    if (view.used && quality < 1.1 * view.quality) { return; }
    view.used = true;
    view.changed = true;
    view.quality = quality;
    view.direction_rad = observation.direction_rad;
    view.distance_m = p.distance_m;
    view.t_us = observation.t_us;
    view.region = r;
    view.features.clear();
    for (const SurfFeature& feature : observation.features) {
        if (!view.features.push(feature)) { break; }
    }
}

bool ObjectMemory::same(const KnownObject& a, const KnownObject& b) const {
    if (!a.placed || !b.placed || a.floor != b.floor) { return false; }
    if (patch_of(a, b) || patch_of(b, a)) { return true; }
    const double distance_m = std::hypot(a.x_m - b.x_m, a.y_m - b.y_m);
    const double reach_m = std::clamp(0.5 * std::max(a.width_m, b.width_m), 0.15, 0.45);
    // A candidate with a poor range may be a known one a little farther along its line of sight.
    const KnownObject& poor = a.sigma_m() > b.sigma_m() ? a : b;
    const KnownObject& good = a.sigma_m() > b.sigma_m() ? b : a;
    bool reached = distance_m <= reach_m;
    if (!reached && !poor.confirmed && distance_m < kGatePoor_m) {
        const double dx = a.x_m - b.x_m;
        const double dy = a.y_m - b.y_m;
        const double xx = poor.xx_m2 + good.xx_m2 + kOffset_m * kOffset_m;
        const double xy = poor.xy_m2 + good.xy_m2;
        const double yy = poor.yy_m2 + good.yy_m2 + kOffset_m * kOffset_m;
        reached = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / std::max(xx * yy - xy * xy, 1.0e-12) < 9.0 &&
                  colour_likeness(a.signature, b.signature) > 0.8F;
    }
    if (!reached) { return false; }
    if (!heights_meet(a.z_m, a.height_m, b.z_m, b.height_m)) { return false; }
    return colour_likeness(a.signature, b.signature) > kAlike || distance_m < 0.15;
}

void ObjectMemory::join(const std::size_t into, const std::size_t from) {
    KnownObject& a = objects_[into];
    const KnownObject& b = objects_[from];
    // A spot on the other says nothing of place, size and colours of the whole.
    if (patch_of(a, b)) {
        a.sectors = b.sectors;
        a.width_m = b.width_m;
        a.width_weight = b.width_weight;
        a.height_m = b.height_m;
        a.height_weight = b.height_weight;
        a.z_m = b.z_m;
        a.z_weight = b.z_weight;
        a.signature = b.signature;
        a.signature_weight = b.signature_weight;
        a.features_mean = b.features_mean;
    } else if (!patch_of(b, a)) {
        for (std::size_t i = 0; i < kSectors; ++i) {
            a.sectors[i].xx += b.sectors[i].xx;
            a.sectors[i].xy += b.sectors[i].xy;
            a.sectors[i].yy += b.sectors[i].yy;
            a.sectors[i].x += b.sectors[i].x;
            a.sectors[i].y += b.sectors[i].y;
            a.sectors[i].count += b.sectors[i].count;
        }
        if (b.width_weight > 0.0) { mean_into(a.width_m, a.width_weight, b.width_m, b.width_weight); }
        if (b.height_weight > 0.0) { mean_into(a.height_m, a.height_weight, b.height_m, b.height_weight); }
        if (b.z_weight > 0.0) { mean_into(a.z_m, a.z_weight, b.z_m, b.z_weight); }
    }
    for (std::size_t i = 0; i < kMaxObjectViews; ++i) {
        if (b.views[i].used && (!a.views[i].used || b.views[i].quality > a.views[i].quality)) {
            a.views[i] = b.views[i];
            a.views[i].changed = false;  // the store moves the row of the picture itself
        }
    }
    a.sightings += b.sightings;
    a.whole += b.whole;
    a.strong += b.strong;
    a.ranged += b.ranged;
    a.absent = std::min(a.absent, b.absent);
    a.parallax.add(b.parallax);
    a.first_seen_us = std::min(a.first_seen_us, b.first_seen_us);
    a.last_seen_us = std::max(a.last_seen_us, b.last_seen_us);
    a.confirmed = a.confirmed || b.confirmed;
    a.changed = true;
    solve(a);
}

void ObjectMemory::remove(const std::size_t index, const std::int64_t into) {
    static_cast<void>(removals_.push({objects_[index].id, into}));
    objects_.remove_unordered(index);
}

int ObjectMemory::reunite(const std::size_t candidate) {
    // An object of an earlier session is recognised by its looks alone, and only if no other looks the same.
    const KnownObject& c = objects_[candidate];
    int found = -1;
    int fitting = 0;
    for (std::size_t i = 0; i < objects_.size(); ++i) {
        const KnownObject& o = objects_[i];
        if (o.placed || !o.confirmed || o.textured() != c.textured()) { continue; }
        const bool sizes = o.width_m > 0.0 && std::fabs(std::log(c.width_m / o.width_m)) < 0.35;
        bool looks = sizes && colour_likeness(c.signature, o.signature) > 0.85F;
        if (looks && c.textured()) {
            looks = false;
            for (const ObjectView& view : c.views) {
                looks = looks || (view.used && verified_matches({view.features.begin(), view.features.size()}, o) >= kReunited);
            }
        }
        if (looks) {
            ++fitting;
            found = static_cast<int>(i);
        }
    }
    return fitting == 1 ? found : -1;
}

void ObjectMemory::tidy(const std::int64_t t_us) {
    for (std::size_t i = 0; i < objects_.size(); ++i) {
        for (std::size_t j = objects_.size(); j-- > i + 1;) {
            if (!same(objects_[i], objects_[j])) { continue; }
            // The older id stays.
            if (objects_[j].id < objects_[i].id) { std::swap(objects_[i], objects_[j]); }
            join(i, j);
            remove(j, objects_[i].id);
            ++counters_.merged;
        }
    }
    for (std::size_t i = objects_.size(); i-- > 0;) {
        KnownObject& object = objects_[i];
        if (!object.placed) { continue; }
        if (refuted(object)) {
            remove(i, 0);
            ++counters_.refuted;
        } else if (!object.confirmed && object.ranged < kConfirmRanged && t_us - object.last_seen_us > kForget_us) {
            remove(i, 0);
            ++counters_.dropped;
        }
    }
    for (std::size_t i = 0; i < objects_.size(); ++i) {
        if (!objects_[i].placed || !objects_[i].confirmed || !objects_[i].changed) { continue; }
        if (!std::has_single_bit(static_cast<std::uint32_t>(objects_[i].sightings))) { continue; }  // costly: at 4, 8, 16, ... sightings
        const int earlier = reunite(i);
        if (earlier < 0) { continue; }
        // The earlier id takes over what was learned now; its old place belonged to another Map.
        const std::size_t e = static_cast<std::size_t>(earlier);
        const std::int64_t id = objects_[e].id;
        const std::int64_t first_us = objects_[e].first_seen_us;
        const std::int32_t sightings = objects_[e].sightings;
        std::swap(objects_[i].id, objects_[e].id);
        objects_[i].first_seen_us = first_us;
        objects_[i].sightings += sightings;
        for (ObjectView& view : objects_[i].views) { view.changed = false; }
        ++counters_.reunited;
        remove(e, id);
        break;
    }
}

}  // namespace noctule
