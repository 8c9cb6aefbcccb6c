#include "shift.h"

#include <algorithm>
#include <limits>

namespace poise {
namespace {
constexpr double kInfinity = std::numeric_limits<double>::infinity();
}

double PairCosts::shift(int most_passes) {
  double now = bound();
  for (int pass = 0; pass < most_passes; ++pass) {
    const int count = static_cast<int>(edges.size());
    for (int e = 0; e < count; ++e) meet(e, 0.5);
    for (int e = count - 1; e >= 0; --e) meet(e, 0.5);
    const double before = now;
    now = bound();
    if (now <= before * 1.01) break;
  }
  return now;
}

double PairCosts::bound() const {
  double total = 0;
  for (int i = 0; i < n; ++i) {
    total += *std::min_element(unary.begin() + i * m, unary.begin() + (i + 1) * m);
  }
  return total;
}

// Collect all that a connector and its ends cost, and hand it back to the ends.
void PairCosts::meet(int e, double share) {
  double* a_costs = unary.data() + static_cast<std::size_t>(edges[e].first) * m;
  double* b_costs = unary.data() + static_cast<std::size_t>(edges[e].second) * m;
  double* table = pair.data() + static_cast<std::size_t>(e) * m * m;
  for (int a = 0; a < m; ++a) {
    for (int b = 0; b < m; ++b) table[a * m + b] += a_costs[a] + b_costs[b];
  }
  for (int a = 0; a < m; ++a) {
    const double least = *std::min_element(table + a * m, table + (a + 1) * m);
    a_costs[a] = share * least;
    if (least == kInfinity) continue;
    for (int b = 0; b < m; ++b) table[a * m + b] -= a_costs[a];
  }
  for (int b = 0; b < m; ++b) {
    double least = kInfinity;
    for (int a = 0; a < m; ++a) least = std::min(least, table[a * m + b]);
    b_costs[b] = least;
    if (least == kInfinity) continue;
    for (int a = 0; a < m; ++a) table[a * m + b] -= least;
  }
  // The first end takes what is still free, so that no cost hides in the connector.
  for (int a = 0; a < m; ++a) {
    if (a_costs[a] == kInfinity) continue;
    const double least = *std::min_element(table + a * m, table + (a + 1) * m);
    if (least == kInfinity) continue;
    a_costs[a] += least;
    for (int b = 0; b < m; ++b) table[a * m + b] -= least;
  }
}

}  // namespace poise
