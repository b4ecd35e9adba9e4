/// One sweep as the scan match sees it: its hits, evened out.
///
/// Neighbouring beams on one surface become their mean, so that near surfaces do not outvote far ones and noise is averaged.
/// Frame Body (level), metres. Page: docs/maths/scan_match.md#shape. No heap.
#pragma once

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "sense/level_scan.hpp"

namespace noctule {

using ScanShape = Bounded<Point2<Body>, kMaxShapePoints>;

/// Fills out with at most kMaxShapePoints points of the sweep, in the order of the beams.
void shape_of(const LevelScan& scan, ScanShape& out);

}  // namespace noctule
