// Placement of a fleet's worth of components: multilevel, in near-linear time.
#pragma once

#include "stop.h"
#include "random.h"

namespace poise {

// Join connected units until few are left, place those by the greedy, and take the joins
// back level by level; on each level, units move to where their neighbours are, as long
// as F falls and every limit holds. Empty when the joined units cannot be placed.
Placement multilevel(const Problem& problem, Stop& stop, Random& random);

}  // namespace poise
