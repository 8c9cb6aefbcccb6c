// Cutting a graph into blocks of limited weight, better and better.
#pragma once

#include <functional>

#include "refine.h"

namespace poise::cut {

// Divide `graph` into one block for each limit, so that the edges between blocks weigh
// little, until it is time to stop. `offer` gets every division that keeps all limits and
// cuts less than those before it; `known` is one to begin with, or empty.
void evolve(const Graph& graph, const std::vector<double>& limit, const Blocks& known,
            Stop& stop, Random& random, const std::function<void(const Blocks&)>& offer);

}  // namespace poise::cut
