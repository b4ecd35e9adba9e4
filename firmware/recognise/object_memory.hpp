/// The objects known so far: which one a sighting belongs to, where each stands, what each looks like.
///
/// Model: docs/maths/vision.md, "Association" and "Fusion", equations (22) to (26). Frame Map of the session. Fixed memory (about 16 MB), no
/// heap, not thread-safe. Nothing here writes to disk: what changed is marked for the store.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/parallax.hpp"
#include "recognise/place.hpp"
#include "recognise/plane_fit.hpp"
#include "recognise/signature.hpp"
#include "recognise/surf.hpp"
#include "recognise/surf_match.hpp"

namespace noctule {

inline constexpr std::size_t kSectors = 16;      ///< directions from which an object is seen, for the fusion

/// What the sightings from one direction say about the position, together: information, count.
struct SectorInformation {
    double xx = 0.0;
    double xy = 0.0;
    double yy = 0.0;
    double x = 0.0;                  ///< information times position
    double y = 0.0;
    double count = 0.0;
};

/// One picture of an object.
struct ObjectView {
    bool used = false;
    bool changed = false;            ///< not yet in the database
    double quality = 0.0;
    double direction_rad = 0.0;      ///< from the object to the camera, Map
    double distance_m = 0.0;
    std::int64_t t_us = 0;
    Region region;                   ///< in the frame that it was cut from
    Bounded<SurfFeature, kMaxViewFeatures> features;   ///< places in the whole frame
};

struct KnownObject {
    std::int64_t id = 0;             ///< in the database, never used again
    bool confirmed = false;
    bool placed = false;             ///< seen in this session; else its position is of another Map
    std::int32_t floor = 0;
    double x_m = 0.0;                ///< centre of the footprint
    double y_m = 0.0;
    double z_m = 0.0;                ///< middle of its height
    double xx_m2 = 0.0;              ///< covariance
    double xy_m2 = 0.0;
    double yy_m2 = 0.0;
    double z_weight = 0.0;           ///< sum of 1 / variance
    double width_m = 0.0;            ///< mean over whole sightings
    double height_m = 0.0;
    double width_weight = 0.0;
    double height_weight = 0.0;
    Signature signature;
    double signature_weight = 0.0;
    double features_mean = 0.0;      ///< SURF features a sighting: textured or plain
    std::int64_t first_seen_us = 0;
    std::int64_t last_seen_us = 0;
    std::int32_t sightings = 0;
    std::int32_t whole = 0;          ///< of them whole ones
    double strong = 0.0;             ///< whole ones with a range of their own; poorer ones count a part
    std::int32_t ranged = 0;         ///< whole ones that the laser ranged
    Parallax parallax;               ///< of the sightings of this session that showed it in full
    Vec3 absent_m{};                 ///< the last place from which it should have been seen and was not
    std::int32_t absent = 0;         ///< such places
    std::array<SectorInformation, kSectors> sectors{};
    std::array<ObjectView, kMaxObjectViews> views{};
    bool changed = false;            ///< not yet in the database

    [[nodiscard]] bool textured() const { return features_mean >= 8.0; }
    /// Greatest standard deviation of the position [m].
    [[nodiscard]] double sigma_m() const;
};

/// One part of a frame, measured and described, as it comes to the memory.
struct Observation {
    Part part;
    Signature signature;
    std::span<const SurfFeature> features;   ///< inside the part's box
    std::int64_t t_us = 0;
    std::int32_t floor = 0;
    double direction_rad = 0.0;              ///< from the object to the camera
    double sharpness = 0.0;                  ///< of the picture, any unit
};

struct MemoryCounters {
    std::uint32_t observations = 0;
    std::uint32_t without_place = 0;     ///< no range, not entered
    std::uint32_t matched = 0;           ///< belonged to a known object
    std::uint32_t verified = 0;          ///< of these by SURF with geometry
    std::uint32_t outliers = 0;          ///< matched, but too far off to be fused
    std::uint32_t created = 0;
    std::uint32_t merged = 0;
    std::uint32_t dropped = 0;           ///< candidates that were not seen again
    std::uint32_t refuted = 0;           ///< candidates that are not where they seemed to be
    std::uint32_t refused = 0;           ///< no room
    std::uint32_t reunited = 0;          ///< known from an earlier session
};

/// What has to go from the database.
struct Removal {
    std::int64_t id = 0;
    std::int64_t into = 0;               ///< its sightings go to this object; 0: they go as well
};

class ObjectMemory {
public:
    using Objects = Bounded<KnownObject, kMaxObjects>;

    /// Enters one observation. Returns the index of its object in objects(), or -1 (no place, or no room).
    int enter(const Observation& observation);

    /// The object with that index should have been seen from there, and was not.
    void note_absent(std::size_t index, const Vec3& eye_m);

    /// What lay under the vehicle there: that floor, or, through an opening in it, the storey below (open). What seems to stand where the nearest such place
    /// is open is a thing of that storey, unless the laser ranged it. More than kMaxGround places of a kind: the first are forgotten.
    void note_ground(std::int32_t floor, double x_m, double y_m, bool open) { note(ground_, floor, x_m, y_m, 0.0, open); }
    /// The same of what lay over the vehicle, at height z_m: what seems to hang wholly over it where the nearest such place is open is a thing of the storey above.
    void note_ceiling(std::int32_t floor, double x_m, double y_m, double z_m, bool open) { note(ceiling_, floor, x_m, y_m, z_m, open); }

    /// After the observations of a frame: joins what turned out to be one, drops candidates that stayed alone.
    /// The indices that enter() returned no longer hold.
    void tidy(std::int64_t t_us);

    [[nodiscard]] const Objects& objects() const { return objects_; }
    [[nodiscard]] Objects& objects() { return objects_; }

    /// The confirmed ones.
    [[nodiscard]] std::int32_t confirmed() const;

    /// Ids that are gone since the last clear_removals(), in order.
    [[nodiscard]] const Bounded<Removal, 2 * kMaxObjects>& removals() const { return removals_; }
    void clear_removals() { removals_.clear(); }

    /// Least id that was never given; the store sets it after loading.
    std::int64_t next_id = 1;

    [[nodiscard]] const MemoryCounters& counters() const { return counters_; }

    /// Matches of a picture with the views of an object that one similarity explains, the most of any view.
    [[nodiscard]] std::int32_t verified_matches(std::span<const SurfFeature> features, const KnownObject& object);

private:
    [[nodiscard]] int find(const Observation& observation, bool& verified);
    void fuse(KnownObject& object, const Observation& observation);
    void keep_view(KnownObject& object, const Observation& observation);
    void solve(KnownObject& object) const;
    /// True: it is seen through an opening in the floor or in the ceiling.
    [[nodiscard]] bool through_opening(const KnownObject& object) const;
    [[nodiscard]] bool sure(const KnownObject& object) const;
    [[nodiscard]] bool refuted(const KnownObject& object) const;
    [[nodiscard]] bool same(const KnownObject& a, const KnownObject& b) const;
    void join(std::size_t into, std::size_t from);
    void remove(std::size_t index, std::int64_t into);
    [[nodiscard]] int reunite(std::size_t candidate);

    /// A place of the vehicle.
    struct Ground {
        std::int32_t floor = 0;
        float x_m = 0.0F;
        float y_m = 0.0F;
        float z_m = 0.0F;
    };
    static constexpr std::size_t kMaxGround = 2048;
    using Grounds = Bounded<Ground, kMaxGround>;
    /// Places with an opening under (or over) them, and without.
    struct Openings {
        Grounds open;
        Grounds solid;
    };
    static void note(Openings& openings, std::int32_t floor, double x_m, double y_m, double z_m, bool open);
    /// Null: none on that floor.
    [[nodiscard]] static const Ground* nearest(const Grounds& grounds, std::int32_t floor, double x_m, double y_m, double& distance_m);
    /// The open place beside the object, if no place without opening is nearer; else null.
    [[nodiscard]] static const Ground* opening_at(const Openings& openings, const KnownObject& object);
    Objects objects_;
    Openings ground_;
    Openings ceiling_;
    Bounded<Removal, 2 * kMaxObjects> removals_;
    MemoryCounters counters_;
    SurfMatches matches_;
    Bounded<PointPair, kMaxSurfFeatures> pairs_;
    PlaneFit fit_;
};

}  // namespace noctule
