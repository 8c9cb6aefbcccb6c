// Problems that are nothing but a graph to be cut: communication, and one limit for each
// computer.
#pragma once

#include "../problem.h"
#include "../random.h"
#include "../stop.h"

namespace poise::cut {

// One resource, no balance, and nothing that makes one computer unlike another but its
// limit; and so large that it is worth it.
bool takes(const Problem& problem);

// The best placement that is found in time, `known` or a better one; empty when none that
// keeps all limits was found, which ends it early.
Placement solve(const Problem& problem, const Placement& known, Stop& stop, Random& random);

}  // namespace poise::cut
