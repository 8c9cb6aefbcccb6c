#include "cut.h"

#include <algorithm>
#include <cmath>

#include "evolve.h"

namespace poise::cut {
namespace {

constexpr int kFewestUnits = 400;
// Pairs of computers are numbered in 32 bits.
constexpr int kMostComputers = 1 << 15;
// What all edges weigh together at most: estimates of gains add up to four times that.
constexpr double kMostWeight = 1 << 28;

// What makes whole numbers of overheads: exactly, if they are multiples of the least.
double unit_of(const Problem& p) {
  double least = kInfinity, total = 0;
  for (int i = 0; i < p.n; ++i) {
    for (const Neighbour& other : p.neighbours(i)) {
      if (other.overhead > 0) least = std::min(least, other.overhead);
      total += other.overhead;
    }
  }
  if (total <= 0) return 1;
  bool whole = total / 2 / least <= kMostWeight;
  for (int i = 0; i < p.n && whole; ++i) {
    for (const Neighbour& other : p.neighbours(i)) {
      const double times = other.overhead / least;
      if (std::fabs(times - std::round(times)) > 1e-9 * (1 + times)) whole = false;
    }
  }
  return whole ? least : total / 2 / kMostWeight;
}

Graph graph_of(const Problem& p) {
  const double unit = unit_of(p);
  Graph out;
  out.weight = p.demand;
  for (int i = 0; i < p.n; ++i) {
    for (const Neighbour& other : p.neighbours(i)) {
      const auto weight = static_cast<std::int32_t>(std::lround(other.overhead / unit));
      if (weight > 0) out.edges.push_back({other.unit, weight});
    }
    out.start.push_back(static_cast<std::int32_t>(out.edges.size()));
  }
  return out;
}

}  // namespace

bool takes(const Problem& p) {
  if (p.n < kFewestUnits || p.m < 2 || p.m > kMostComputers || p.r != 1) return false;
  if (!p.distance.empty() || !p.cost.empty() || !p.bandwidth.empty()) return false;
  if (p.has_apart() || p.weight[0] > 0) return false;
  for (int i = 0; i < p.n; ++i) {
    if (p.restricted(i)) return false;
  }
  return true;
}

Placement solve(const Problem& p, const Placement& known, Stop& stop, Random& random) {
  if (stop.look()) return known;
  std::vector<double> limit(p.m);
  for (int h = 0; h < p.m; ++h) limit[h] = std::max(0.0, p.capacity[h] - p.floor[h]);
  Placement best = known;
  double least = known.empty() ? kInfinity : terms(p, known).total();
  evolve(graph_of(p), limit, known, stop, random, [&](const Blocks& block) {
    // Numbers were rounded: what counts is F and the limits as they are.
    const double total = terms(p, block).total();
    if (total >= least || !feasible(p, block)) return;
    best = block;
    least = total;
  });
  return best;
}

}  // namespace poise::cut
