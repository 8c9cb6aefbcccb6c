// A smaller problem in the shape of a larger one: connected units become one.
#pragma once

#include "problem/problem.h"
#include "problem/random.h"

namespace poise {

struct Coarse {
  Problem problem;
  std::vector<std::int32_t> part_of;  // unit of the larger problem -> unit of this one
};

// Join pairs of units along their heaviest connectors, where limits allow it. No joined
// unit asks for more than `largest` of any mean limit.
Coarse coarsen(const Problem& fine, double largest, Random& random);

}  // namespace poise
