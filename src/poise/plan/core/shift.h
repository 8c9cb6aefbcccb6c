// Costs shifted between units and connectors so that cheap-looking choices show early
// what they will cost: a better bound on communication, found once before a search.
#pragma once

#include <cstdint>
#include <vector>

namespace poise {

// A pairwise cost model: minimise the sum of unary(i, x_i) over units and pair(e, x_i, x_j)
// over connectors. `shift` changes the tables but not the sum for any x. (Block
// coordinate ascent on the dual, as in Globerson and Jaakkola, NIPS 2007.)
struct PairCosts {
  struct Edge {
    std::int32_t first, second;  // first < second
  };
  int n, m;
  std::vector<Edge> edges;
  std::vector<double> unary;  // (n, m); infinite where not allowed
  std::vector<double> pair;   // (edges, m, m), by the computers of first and second

  // Shift costs by passes there and back until the bound, the sum of the smallest unary
  // costs, hardly rises. No entry of `pair` becomes negative.
  double shift(int most_passes);

  double bound() const;

 private:
  void meet(int edge, double share);
};

}  // namespace poise
