// A problem, compiled once into flat arrays and solved many times.
//
// It mirrors `Tables` in ../tables.py: "unit" is one or more components that share a
// computer. Tables by resource and computer are (r, m), one resource after the other, so
// that loops over computers run over consecutive memory.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

namespace poise {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kSlack = 1e-9;

// What the bindings hand over; everything is checked by `Problem`'s constructor.
struct Input {
  std::int64_t n = 0, m = 0, r = 0;
  std::vector<double> demand, capacity, limit, size;
  std::vector<std::int32_t> restricted;  // units that may not run everywhere
  std::vector<std::int32_t> offsets;     // where each one's computers start in `allowed`
  std::vector<std::int32_t> allowed;
  std::vector<std::int32_t> first, second;
  std::vector<double> overhead, traffic, distance, cost, bandwidth;
  std::vector<std::int32_t> apart_first, apart_second;
  double communication = 0;
  std::vector<double> spread;
  bool share = true, variance = false;
};

// One end of a connector, as seen from the other.
struct Neighbour {
  std::int32_t unit;
  double overhead;  // what F grows by when the two are at distance 1
  double traffic;   // [bytes/s]
};

// A range of consecutive elements.
template <typename T>
struct Span {
  const T* first;
  const T* last;
  const T* begin() const { return first; }
  const T* end() const { return last; }
  std::size_t size() const { return static_cast<std::size_t>(last - first); }
};

class Problem {
 public:
  // Throws std::invalid_argument when sizes, indexes or numbers are out of range.
  explicit Problem(Input input);

  int n, m, r;
  std::vector<double> demand;    // (n, r)
  std::vector<double> capacity;  // (r, m)
  std::vector<double> floor;     // (r, m): residue must stay at or above this
  std::vector<double> scale;     // (r, m): residue -> unit of the spread; 0: not counted
  std::vector<double> weight;    // (r): what a unit of spread adds to F
  std::vector<int> counted;      // (r): number of computers that the spread is over
  std::vector<double> distance;  // (m, m), or empty: 1 between any two computers
  std::vector<double> cost;      // (n, m), or empty: 0
  std::vector<double> bandwidth; // (m, m), or empty: unlimited
  std::vector<std::int32_t> order;  // units in the order in which the greedy places them
  bool variance;

  bool has_apart() const { return !apart_.empty(); }

  Span<Neighbour> neighbours(int unit) const {
    return {adjacency_.data() + starts_[unit], adjacency_.data() + starts_[unit + 1]};
  }
  // Have a unit brought nearer, which will be looked at soon.
  void prefetch(int unit) const {
    __builtin_prefetch(demand.data() + static_cast<std::size_t>(unit) * r);
    __builtin_prefetch(starts_.data() + unit);
  }
  Span<std::int32_t> apart(int unit) const {
    if (apart_.empty()) return {nullptr, nullptr};
    return {apart_.data() + apart_starts_[unit], apart_.data() + apart_starts_[unit + 1]};
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
  // How many computers a unit may run on, and which one when it is one.
  int choices(int unit) const;
  int only(int unit) const;
  // The problem whose units are the `count` parts of this one's, unit -> part. The units
  // of a part must be allowed to share a computer. It has no `order` before it is sorted.
  Problem joined(const std::vector<std::int32_t>& part, int count) const;
  void sort_by_demand();
  // Bytes that this problem holds.
  std::size_t bytes() const;

 private:
  Problem() = default;
  void connect(const Input& input);
  void restrict_units(const Input& input);
  void part(const Input& input);
  void sort_units(const std::vector<double>& size);

  std::vector<std::int64_t> starts_;
  std::vector<Neighbour> adjacency_;
  std::vector<std::int64_t> apart_starts_;
  std::vector<std::int32_t> apart_;
  std::vector<std::int32_t> rows_;  // unit -> row of `masks_`, -1: may run anywhere
  std::vector<std::uint64_t> masks_;
  std::size_t words_ = 0;
};

using Placement = std::vector<std::int32_t>;  // unit -> computer, -1: none

struct Terms {
  double communication = 0, balance = 0, linear = 0;
  double total() const { return communication + balance + linear; }
};

// Recompute F from nothing: what every shortcut is held against.
Terms terms(const Problem& problem, const Placement& placed);

// Whether a complete placement keeps every limit.
bool feasible(const Problem& problem, const Placement& placed);

// Weighted spread of residues (r, m) over all computers.
double spread_of(const Problem& problem, const std::vector<double>& left);

// Residues (r, m) of a placement; units without a computer use nothing.
std::vector<double> residues(const Problem& problem, const Placement& placed);

}  // namespace poise
