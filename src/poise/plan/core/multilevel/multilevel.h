// Placement of a fleet's worth of components: multilevel, in near-linear time.
#pragma once

#include "problem/outcome.h"
#include "problem/random.h"

namespace poise {

// Join connected units until few are left, place those by the greedy, and take the joins
// back level by level; on each level, units move to where their neighbours are, as long
// as F falls and every limit holds. Empty when the joined units cannot be placed.
Placement multilevel(const Problem& problem, Stop& stop, Random& random);

// Move units to their neighbours' computers, or to emptier ones, while F falls. `placed`
// must be feasible, and stays so.
void refine(const Problem& problem, Placement& placed, Stop& stop);

}  // namespace poise
