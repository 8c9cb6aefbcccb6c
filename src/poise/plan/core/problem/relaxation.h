// How even the residues could be at best, if demand flowed freely between computers.
#pragma once

#include "problem/problem.h"

namespace poise {

// The least spread of one resource. `share` holds the residues of `count` computers in
// units of the spread, largest first, `size` what a unit of share is of the resource, and
// `open` the demand that may still flow anywhere. `alike`: all sizes are equal.
double relaxed_spread(const double* share, const double* size, int count, double open,
                    bool variance, bool alike);

// Whether a resource's residue is measured alike on all computers.
bool all_alike(const Problem& problem, int resource);

// A number that no placement's F is below: no connector is paid, each unit has its
// cheapest computer, and demand flows freely.
double relaxation_bound(const Problem& problem);

}  // namespace poise
