/// Every capacity of the firmware, in one place; docs/memory.md says what happens when each is full.
///
/// Three profiles, chosen when the build is configured (-DNOCTULE_CAPACITY=full | small | micro): full holds 30 000 m2 over eight
/// floors, small 10 000 m2 over four, micro one flat of 400 m2 in 1 MiB. Where they differ the line says by_profile(full, small, micro).
#pragma once

#include <cstddef>
#include <cstdint>

namespace noctule {

#if defined(NOCTULE_CAPACITY_MICRO)
inline constexpr std::size_t kCapacityProfile = 2;
#elif defined(NOCTULE_CAPACITY_SMALL)
inline constexpr std::size_t kCapacityProfile = 1;
#else
inline constexpr std::size_t kCapacityProfile = 0;
#endif

[[nodiscard]] constexpr std::size_t by_profile(const std::size_t full, const std::size_t small, const std::size_t micro) {
    return kCapacityProfile == 2U ? micro : (kCapacityProfile == 1U ? small : full);
}

// One step's input.
inline constexpr std::size_t kMaxBeams = 1200;           ///< beams of one sweep; a longer one is refused
inline constexpr std::size_t kMaxImuPerStep = 128;       ///< inertial samples between two scans; the newest are refused
inline constexpr std::size_t kMaxAttitudePerStep = 32;   ///< attitude samples between two scans; the newest are refused
inline constexpr std::size_t kMaxRangePerStep = 16;      ///< range samples of one direction between two scans; the newest are refused
inline constexpr std::size_t kMaxBaroPerStep = 16;       ///< barometer samples between two scans; the newest are refused
inline constexpr std::size_t kMaxVehiclePerStep = 16;    ///< vehicle messages between two scans; the newest are refused
inline constexpr std::size_t kMaxParametersPerStep = 4;  ///< parameter tables between two scans; the newest are refused
inline constexpr std::size_t kMaxGoalPerStep = 8;        ///< answers of a policy outside between two scans; the newest are refused
inline constexpr std::size_t kMaxCommandPerStep = 8;     ///< commands between two scans; the newest are refused

// Link.
inline constexpr std::size_t kMaxLcmBytes = 61440;       ///< encoded LCM message; a larger one is not sent (LCM would allocate)
inline constexpr int kMaxLcmQueue = 1024;                ///< messages that wait on one subscription; the newest are refused
inline constexpr std::size_t kMaxLcmSubscriptions = 16;  ///< channels one process listens to; more are refused at start-up

// Altitude.
inline constexpr std::size_t kMaxLevels = by_profile(64, 64, 16);  ///< surfaces known at once; the least useful gives way
inline constexpr std::size_t kMaxSurfaces = 32;          ///< floors and ceilings of a building handed out at once; more are left out
inline constexpr std::size_t kMaxPaperLevels = by_profile(256, 128, 32);  ///< level entries of the paper's form; the oldest gives way

// Map and plan.
inline constexpr std::size_t kMaxTiles = by_profile(768, 256, 10);  ///< tiles of 64 x 64 cells (41 m2 at 0.10 m); a further one is refused
inline constexpr std::size_t kFloorSlots = by_profile(8, 4, 2);  ///< floors that share the tiles; an opening to a further one is refused
inline constexpr std::int32_t kMaxFloors = static_cast<std::int32_t>(kFloorSlots);
inline constexpr std::size_t kMaxTouchedTiles = by_profile(128, 64, 10);  ///< tiles that one sweep can touch; beyond, its beams count one by one
inline constexpr std::size_t kMaxFieldTiles = by_profile(320, 128, 8);  ///< tiles of one floor with costs of the way; what lies beyond is not reachable
inline constexpr std::size_t kTileDirectory = by_profile(2048, 1024, 32);  ///< entries of the tile directory, a power of two over twice kMaxTiles
inline constexpr std::size_t kMaxOpenCells = by_profile(65536, 32768, 2048);  ///< open entries of one search over the grid; a further one is dropped
inline constexpr std::size_t kMaxFrontierCells = by_profile(32768, 8192, 512);  ///< cells at the edge of the unknown in one pass; later ones wait for the next
inline constexpr std::size_t kMaxFrontiers = by_profile(128, 64, 32);  ///< groups of them in one pass; the smallest gives way
inline constexpr std::size_t kMaxStops = by_profile(64, 64, 24);  ///< stops of the explorer's tour, the vehicle is one; the farthest are left for later
inline constexpr std::size_t kMaxTriedPlaces = by_profile(256, 128, 64);  ///< places that could not be looked into; the oldest gives way
inline constexpr std::size_t kMaxTrailNodes = by_profile(2048, 1024, 256);  ///< places flown, 0.7 m apart, with the way home; further ones are left out
inline constexpr std::size_t kMaxPathPoints = 64;        ///< points of the path ahead, about 3 m; a longer one is cut
inline constexpr std::size_t kMaxDirtyBlocks = by_profile(49152, 16384, 640);  ///< blocks of 8 x 8 cells waiting for new clearances; 64 a tile: all of them fit
inline constexpr std::size_t kMaxPaperSide = by_profile(320, 320, 32);  ///< cells along a side of the area of the paper's policy, 32 m; it does not see what lies beyond
inline constexpr std::size_t kPotentialWindow = by_profile(64, 64, 32);  ///< cells along a side of the potential's ring, a power of two; a wider window is cut to it

// Floors.
inline constexpr std::size_t kMaxVerticalCells = by_profile(32768, 8192, 1024);  ///< places in which something over or under was seen, a power of two; at 7/8 of it a new one is refused
inline constexpr std::size_t kMaxOpenings = by_profile(64, 32, 16);  ///< openings judged (taken, refused, without a floor behind); the oldest that was refused gives way
inline constexpr std::size_t kMaxElevationBins = 512;    ///< bins of 5 cm in the distribution of elevations; what lies beyond is left out
inline constexpr std::size_t kMaxAtlasObjects = 128;     ///< objects in the atlas; more are left out
inline constexpr std::size_t kMaxAtlasBytes = 4194304;   ///< encoded atlas: every tile of the pool and the rest

// Planar estimation.
inline constexpr std::size_t kMaxMotionNodes = kMaxImuPerStep + 8;  ///< poses of one sweep; the newest are refused
inline constexpr std::size_t kMaxWallsPerScan = 48;      ///< walls of one sweep; the shortest give way
inline constexpr std::size_t kMaxWalls = 192;            ///< walls handed out at once (walls_t); more are refused
inline constexpr std::size_t kMaxParticles = by_profile(100, 100, 16);  ///< hypotheses of the wall filter; a parameter sets how many are used
inline constexpr std::size_t kMaxLandmarks = by_profile(160, 120, 48);  ///< walls of one particle; the one seen least gives way
inline constexpr std::size_t kMaxPointCells = by_profile(32768, 16384, 2048);  ///< cells of the point map, all floors, a power of two; the one with fewest points gives way
inline constexpr std::size_t kMaxPredictorSamples = 128; ///< inertial samples since the last scan; the oldest give way
inline constexpr std::size_t kMaxMatchPoints = by_profile(240, 240, 120);  ///< points of one sweep matched with the point map; thinned out beyond
inline constexpr std::size_t kMaxShapePoints = 180;  ///< points of one sweep in the scan match; thinned out beyond
inline constexpr std::size_t kMaxScanSide = by_profile(320, 320, 96);  ///< cells along a side of that map, 0.15 m each; what lies outside is left out
inline constexpr std::size_t kMaxScanCells = by_profile(5120, 4096, 768);  ///< cells of the map around the vehicle; a further one is refused
inline constexpr std::size_t kMaxKeyframes = by_profile(1536, 512, 24);  ///< sweeps kept for the scan match; the most crowded gives way; with micro's no place is ever looked for
inline constexpr std::size_t kMaxPlaceCentres = by_profile(512, 256, 32);  ///< places that one sweep is looked for at; further ones are left out

// Recognition.
inline constexpr std::size_t kMaxSurfPixels = 786432;    ///< pixels of an image for SURF (1024 x 768); a larger one is refused
inline constexpr std::size_t kMaxSurfSide = 1280;        ///< width and height; a longer one is refused
inline constexpr std::size_t kMaxSurfFeatures = 2048;    ///< features of one image; the strongest stay
inline constexpr std::size_t kMaxRegions = 32;           ///< regions of one frame, as in objects_t; the largest stay
inline constexpr std::size_t kMaxObjects = 128;          ///< objects known at once; the candidate seen least gives way, then the newest is refused
inline constexpr std::size_t kMaxObjectViews = 8;        ///< pictures of one object, one a sector of viewpoint; the better one stays
inline constexpr std::size_t kMaxViewFeatures = 48;      ///< SURF features of one picture; the strongest stay
inline constexpr std::size_t kMaxObjectSightings = 256;  ///< sightings of one object kept in the database; the oldest give way

}  // namespace noctule
