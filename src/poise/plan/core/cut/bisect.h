// A first division into blocks, by halves of halves.
#pragma once

#include "refine.h"

namespace poise::cut {

// Divide a graph into as many blocks as there are limits, where each halving is the best
// of `tries` as long as that is quick. What it finds may break limits by a little, when
// weights are coarse.
Blocks bisect(const Graph& graph, const std::vector<double>& limit, int tries, Stop& stop,
              Random& random);

}  // namespace poise::cut
