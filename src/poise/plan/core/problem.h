// A problem in flat arrays, compiled once and solved many times.
//
// It is made from `Arrays` in ../problem/arrays.py: "unit" is one or more components that
// share a computer. Arrays by resource and computer are (r, m), one resource after the other,
// so that loops over computers run over consecutive memory.
#pragma once

#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <vector>

#include "time_limits.h"

namespace poise {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kSlack = 1e-9;

// One end of a connector, as seen from the other.
struct Neighbour {
  std::int32_t unit;
  double overhead;  // what F grows by when the two are at distance 1
  double traffic;   // [bytes/s]
};

class Problem {
 public:
  int n = 0, m = 0, r = 0;
  std::vector<double> demand;       // (n, r)
  std::vector<double> capacity;     // (r, m)
  std::vector<double> floor;        // (r, m): residue must stay at or above this
  std::vector<double> price;        // (r): what a unit of shortage adds to F; 0: limits are hard
  std::vector<double> goal;         // (r, m): residue below this is a shortage, where priced
  std::vector<double> scale;        // (r, m): residue -> unit of the spread; 0: not counted
  std::vector<double> weight;       // (r): what a unit of spread adds to F
  std::vector<double> size_weight;  // (r): by demand times this, units are sorted
  std::vector<int> counted;         // (r): number of computers that the spread is over
  std::vector<double> distance;     // (m, m), or empty: 1 between any two computers
  std::vector<double> cost;         // (n, m), or empty: 0
  std::vector<double> bandwidth;    // (m, m), or empty: unlimited
  std::vector<int> priced;          // the resources that have a price
  std::vector<std::int32_t> order;  // units in the order in which the greedy places them
  std::optional<TimeLimits> time_limits;
  bool variance = false;

  // Set up what computers have: `has` and `limit` are (m, r); a limit whose resource has a
  // price may be broken. Residues count as shares of what there is, or as they are.
  void set_rooms(const std::vector<double>& has, const std::vector<double>& limit, bool share);
  // `each` calls its argument with (unit, neighbour) for both ends of each connector.
  template <typename Each>
  void connect(Each each) {
    neighbours_.fill(n, each);
  }
  // `each` calls its argument with (unit, other) both ways for each pair to be apart.
  template <typename Each>
  void keep_apart(Each each) {
    apart_.fill(n, each);
  }
  // Some units -> the computers that each may run on.
  void restrict_units(const std::map<std::int32_t, std::vector<std::int32_t>>& allowed);
  // Set time limits, whose runs are at best where their units may run fastest.
  void limit_time(TimeLimits limits);
  // Put units with one choice first, then by size; to be called when demands change.
  void sort_units();

  Span<Neighbour> neighbours(int unit) const { return neighbours_.of(unit); }
  Span<std::int32_t> apart(int unit) const { return apart_.of(unit); }
  bool has_apart() const { return !apart_.empty(); }
  const double* need(int unit) const {
    return demand.data() + static_cast<std::size_t>(unit) * r;
  }
  double room(int resource, int computer) const {
    const std::size_t e = static_cast<std::size_t>(resource) * m + computer;
    return capacity[e] - (price[resource] > 0 ? goal[e] : floor[e]);
  }
  double mean_room(int resource) const {
    double total = 0;
    for (int h = 0; h < m; ++h) total += room(resource, h);
    return total / m;
  }
  // By how much a residue is below what it should be at least.
  double shortage(int resource, int computer, double left) const {
    const double short_by = goal[static_cast<std::size_t>(resource) * m + computer] - left;
    return short_by > 0 ? short_by : 0.0;
  }
  double far(int a, int b) const {
    if (distance.empty()) return a == b ? 0.0 : 1.0;
    return distance[static_cast<std::size_t>(a) * m + b];
  }
  double linear(int unit, int computer) const {
    return cost.empty() ? 0.0 : cost[static_cast<std::size_t>(unit) * m + computer];
  }
  bool allowed(int unit, int computer) const {
    const std::int32_t row = rows_.empty() ? -1 : rows_[unit];
    if (row < 0) return true;
    const std::size_t word = static_cast<std::size_t>(row) * words_ + computer / 64;
    return (masks_[word] >> (computer % 64)) & 1U;
  }
  bool restricted(int unit) const { return !rows_.empty() && rows_[unit] >= 0; }
  // How many computers a unit may run on.
  int choices(int unit) const;
  // Whether one of two units may run wherever the other may.
  bool may_join(int unit, int other) const;
  // The problem whose units are the `count` parts of this one's, unit -> part. The units
  // of a part must be allowed to share a computer.
  Problem joined(const std::vector<std::int32_t>& part, int count) const;

 private:
  Lists<Neighbour> neighbours_;
  Lists<std::int32_t> apart_;
  std::vector<std::int32_t> rows_;  // unit -> row of `masks_`, -1: may run anywhere
  std::vector<std::uint64_t> masks_;
  std::size_t words_ = 0;
};

using Placement = std::vector<std::int32_t>;  // unit -> computer, -1: none

struct Terms {
  double communication = 0, balance = 0, linear = 0, shortage = 0, time = 0;
  double total() const { return communication + balance + linear + shortage + time; }
};

// Recompute F from nothing: what every shortcut is held against.
Terms terms(const Problem& problem, const Placement& placed);

// Whether a complete placement keeps every limit.
bool feasible(const Problem& problem, const Placement& placed);

// Residues (r, m) of a placement; units without a computer use nothing.
std::vector<double> residues(const Problem& problem, const Placement& placed);

}  // namespace poise
