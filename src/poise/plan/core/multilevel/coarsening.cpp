#include "multilevel/coarsening.h"

#include <algorithm>
#include <numeric>

namespace poise {
namespace {

bool must_be_apart(const Problem& p, int i, int j) {
  const auto apart = p.apart(i);
  return std::find(apart.begin(), apart.end(), j) != apart.end();
}

// Heavy-edge matching: each unit, in random order, takes its heaviest free neighbour.
std::vector<std::int32_t> match(const Problem& p, double largest, Random& random,
                                int& count) {
  std::vector<double> limit(p.r);
  for (int k = 0; k < p.r; ++k) limit[k] = p.mean_room(k) * largest;
  std::vector<std::int32_t> part(p.n, -1), order(p.n);
  std::iota(order.begin(), order.end(), 0);
  for (int i = p.n; i > 1; --i) std::swap(order[i - 1], order[random.below(i)]);
  count = 0;
  for (const std::int32_t i : order) {
    if (part[i] >= 0) continue;
    int best = -1;
    double heaviest = 0;
    for (const Neighbour& other : p.neighbours(i)) {
      if (part[other.unit] >= 0 || other.overhead <= heaviest) continue;
      bool fits = p.may_join(i, other.unit) && !must_be_apart(p, i, other.unit);
      for (int k = 0; k < p.r; ++k) {
        fits &= p.need(i)[k] + p.need(other.unit)[k] <= limit[k];
      }
      if (!fits) continue;
      best = other.unit;
      heaviest = other.overhead;
    }
    part[i] = count;
    if (best >= 0) part[best] = count;
    ++count;
  }
  return part;
}

}  // namespace

Coarse coarsen(const Problem& fine, double largest, Random& random) {
  int count = 0;
  std::vector<std::int32_t> part = match(fine, largest, random, count);
  Problem coarse = fine.joined(part, count);
  return {std::move(coarse), std::move(part)};
}

}  // namespace poise
