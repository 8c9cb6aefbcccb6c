#include "problem.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>

namespace poise {
namespace {

constexpr std::int64_t kMostUnits = 1 << 28;
constexpr std::int64_t kMostEntries = std::int64_t{1} << 33;

void demand_that(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

void check_length(std::size_t length, std::int64_t expected, const char* name) {
  if (length == static_cast<std::size_t>(expected)) return;
  throw std::invalid_argument(std::string(name) + " has " + std::to_string(length) +
                              " entries, must have " + std::to_string(expected));
}

void check_finite(const std::vector<double>& values, double lowest, const char* name) {
  for (const double value : values) {
    if (value >= lowest && value <= 1e150) continue;
    throw std::invalid_argument(std::string(name) + " has the value " +
                                std::to_string(value));
  }
}

void check_indexes(const std::vector<std::int32_t>& values, std::int64_t end,
                   const char* name) {
  for (const std::int32_t value : values) {
    if (value >= 0 && value < end) continue;
    throw std::invalid_argument(std::string(name) + " has the index " +
                                std::to_string(value) + ", must be in [0, " +
                                std::to_string(end) + ")");
  }
}

void check_sizes(const Input& in) {
  demand_that(in.n >= 0 && in.n <= kMostUnits, "too many units");
  demand_that(in.m >= 0 && in.m <= (1 << 20), "too many computers");
  demand_that(in.r >= 0 && in.r <= 1024, "too many resources");
  demand_that(in.n == 0 || in.m > 0, "there are no computers");
  demand_that(in.n * in.r <= kMostEntries, "too many demands");
  check_length(in.demand.size(), in.n * in.r, "demand");
  check_length(in.capacity.size(), in.m * in.r, "capacity");
  check_length(in.limit.size(), in.m * in.r, "limit");
  check_length(in.size.size(), in.n, "size");
  check_length(in.spread.size(), in.r, "spread");
  check_length(in.second.size(), in.first.size(), "second");
  check_length(in.overhead.size(), in.first.size(), "overhead");
  check_length(in.traffic.size(), in.first.size(), "traffic");
  check_length(in.apart_second.size(), in.apart_first.size(), "apart");
  check_length(in.offsets.size(), in.restricted.size() + 1, "offsets");
  if (!in.distance.empty()) check_length(in.distance.size(), in.m * in.m, "distance");
  if (!in.bandwidth.empty()) check_length(in.bandwidth.size(), in.m * in.m, "bandwidth");
  if (!in.cost.empty()) check_length(in.cost.size(), in.n * in.m, "cost");
}

void check_values(const Input& in) {
  check_finite(in.demand, 0, "demand");
  check_finite(in.capacity, 0, "capacity");
  check_finite(in.limit, 0, "limit");
  check_finite(in.size, 0, "size");
  check_finite(in.overhead, 0, "overhead");
  check_finite(in.traffic, 0, "traffic");
  check_finite(in.distance, 0, "distance");
  check_finite(in.cost, -1e150, "cost");
  check_finite(in.spread, 0, "spread");
  check_finite({in.communication}, 0, "communication");
  for (const double value : in.bandwidth) demand_that(value >= 0, "bandwidth below 0");
  for (int a = 0; a < in.m && !in.distance.empty(); ++a) {
    demand_that(in.distance[a * in.m + a] == 0, "distance of a computer to itself is not 0");
    for (int b = 0; b < a; ++b) {
      demand_that(in.distance[a * in.m + b] == in.distance[b * in.m + a],
                  "distance is not symmetric");
    }
  }
  check_indexes(in.first, in.n, "first");
  check_indexes(in.second, in.n, "second");
  check_indexes(in.restricted, in.n, "restricted");
  check_indexes(in.allowed, in.m, "allowed");
  check_indexes(in.apart_first, in.n, "apart");
  check_indexes(in.apart_second, in.n, "apart");
  demand_that(in.offsets.front() == 0, "offsets must start at 0");
  demand_that(std::is_sorted(in.offsets.begin(), in.offsets.end()),
              "offsets must not fall");
  check_length(in.allowed.size(), in.offsets.back(), "allowed");
}

}  // namespace

Problem::Problem(Input in) {
  check_sizes(in);
  check_values(in);
  n = static_cast<int>(in.n);
  m = static_cast<int>(in.m);
  r = static_cast<int>(in.r);
  variance = in.variance;
  demand = std::move(in.demand);
  distance = std::move(in.distance);
  cost = std::move(in.cost);
  bandwidth = std::move(in.bandwidth);
  weight = std::move(in.spread);
  const std::size_t entries = static_cast<std::size_t>(m) * r;
  capacity.resize(entries);
  floor.resize(entries);
  scale.assign(entries, 1.0);
  counted.assign(r, m);
  for (int k = 0; k < r; ++k) {
    for (int h = 0; h < m; ++h) {
      const double has = in.capacity[h * r + k], limit = in.limit[h * r + k];
      capacity[k * m + h] = has;
      floor[k * m + h] = has - limit - kSlack * std::max(1.0, limit);
      if (!in.share) continue;
      scale[k * m + h] = has > 0 ? 1.0 / has : 0.0;
      if (has <= 0) --counted[k];
    }
    // Over one computer, or none, there is no spread.
    if (counted[k] <= 1) weight[k] = 0;
  }
  connect(in);
  restrict_units(in);
  part(in);
  sort_units(in.size);
}

void Problem::connect(const Input& in) {
  starts_.assign(n + 1, 0);
  for (std::size_t e = 0; e < in.first.size(); ++e) {
    if (in.first[e] == in.second[e]) continue;
    ++starts_[in.first[e] + 1];
    ++starts_[in.second[e] + 1];
  }
  std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
  adjacency_.resize(starts_.back());
  std::vector<std::int64_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t e = 0; e < in.first.size(); ++e) {
    if (in.first[e] == in.second[e]) continue;
    const double overhead = in.communication * in.overhead[e];
    adjacency_[next[in.first[e]]++] = {in.second[e], overhead, in.traffic[e]};
    adjacency_[next[in.second[e]]++] = {in.first[e], overhead, in.traffic[e]};
  }
}

void Problem::restrict_units(const Input& in) {
  if (in.restricted.empty()) return;
  words_ = (static_cast<std::size_t>(m) + 63) / 64;
  rows_.assign(n, -1);
  masks_.assign(in.restricted.size() * words_, 0);
  for (std::size_t i = 0; i < in.restricted.size(); ++i) {
    rows_[in.restricted[i]] = static_cast<std::int32_t>(i);
    for (std::int32_t e = in.offsets[i]; e < in.offsets[i + 1]; ++e) {
      masks_[i * words_ + in.allowed[e] / 64] |= std::uint64_t{1} << (in.allowed[e] % 64);
    }
  }
}

void Problem::part(const Input& in) {
  if (in.apart_first.empty()) return;
  apart_starts_.assign(n + 1, 0);
  for (std::size_t e = 0; e < in.apart_first.size(); ++e) {
    ++apart_starts_[in.apart_first[e] + 1];
    ++apart_starts_[in.apart_second[e] + 1];
  }
  std::partial_sum(apart_starts_.begin(), apart_starts_.end(), apart_starts_.begin());
  apart_.resize(apart_starts_.back());
  std::vector<std::int64_t> next(apart_starts_.begin(), apart_starts_.end() - 1);
  for (std::size_t e = 0; e < in.apart_first.size(); ++e) {
    apart_[next[in.apart_first[e]]++] = in.apart_second[e];
    apart_[next[in.apart_second[e]]++] = in.apart_first[e];
  }
}

void Problem::sort_units(const std::vector<double>& size) {
  std::vector<char> pinned(n, 0);
  for (int i = 0; i < n && !rows_.empty(); ++i) pinned[i] = restricted(i) && choices(i) == 1;
  order.resize(n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    if (pinned[a] != pinned[b]) return pinned[a] > pinned[b];
    return size[a] != size[b] ? size[a] > size[b] : a < b;
  });
}

void Problem::sort_by_demand() {
  std::vector<double> size(n, 0.0);
  for (int k = 0; k < r; ++k) {
    double limit = 0;
    for (int h = 0; h < m; ++h) limit += capacity[k * m + h] - floor[k * m + h];
    for (int i = 0; i < n && limit > 0; ++i) {
      size[i] += demand[static_cast<std::size_t>(i) * r + k] / limit;
    }
  }
  sort_units(size);
}

int Problem::choices(int unit) const {
  if (!restricted(unit)) return m;
  int count = 0;
  for (std::size_t w = 0; w < words_; ++w) {
    count += __builtin_popcountll(masks_[rows_[unit] * words_ + w]);
  }
  return count;
}

int Problem::only(int unit) const {
  for (std::size_t w = 0; w < words_; ++w) {
    const std::uint64_t mask = masks_[rows_[unit] * words_ + w];
    if (mask) return static_cast<int>(w * 64) + __builtin_ctzll(mask);
  }
  return -1;
}

std::size_t Problem::bytes() const {
  const auto held = [](const auto& v) { return v.capacity() * sizeof(v[0]); };
  return held(demand) + held(capacity) + held(floor) + held(scale) + held(distance) +
         held(cost) + held(bandwidth) + held(order) + held(starts_) + held(adjacency_) +
         held(apart_starts_) + held(apart_) + held(rows_) + held(masks_);
}

std::vector<double> residues(const Problem& p, const Placement& placed) {
  std::vector<double> left = p.capacity;
  for (int i = 0; i < p.n; ++i) {
    if (placed[i] < 0) continue;
    for (int k = 0; k < p.r; ++k) left[k * p.m + placed[i]] -= p.demand[i * p.r + k];
  }
  return left;
}

double spread_of(const Problem& p, const std::vector<double>& left) {
  double total = 0;
  for (int k = 0; k < p.r; ++k) {
    if (p.weight[k] <= 0) continue;
    double low = kInfinity, high = -kInfinity, sum = 0, squares = 0;
    for (int h = 0; h < p.m; ++h) {
      const double scale = p.scale[k * p.m + h];
      if (scale <= 0) continue;
      const double share = left[k * p.m + h] * scale;
      low = std::min(low, share);
      high = std::max(high, share);
      sum += share;
    }
    const double mean = sum / p.counted[k];
    for (int h = 0; h < p.m && p.variance; ++h) {
      const double scale = p.scale[k * p.m + h];
      if (scale <= 0) continue;
      const double off = left[k * p.m + h] * scale - mean;
      squares += off * off;
    }
    total += p.weight[k] * (p.variance ? squares / p.counted[k] : high - low);
  }
  return total;
}

Terms terms(const Problem& p, const Placement& placed) {
  Terms out;
  for (int i = 0; i < p.n; ++i) {
    if (placed[i] < 0) continue;
    out.linear += p.linear(i, placed[i]);
    for (const Neighbour& other : p.neighbours(i)) {
      if (other.unit < i || placed[other.unit] < 0) continue;
      out.communication += other.overhead * p.far(placed[i], placed[other.unit]);
    }
  }
  out.balance = spread_of(p, residues(p, placed));
  return out;
}

bool feasible(const Problem& p, const Placement& placed) {
  std::vector<double> traffic(p.bandwidth.size(), 0.0);
  for (int i = 0; i < p.n; ++i) {
    if (placed[i] < 0 || !p.allowed(i, placed[i])) return false;
  }
  for (int i = 0; i < p.n; ++i) {
    for (const std::int32_t other : p.apart(i)) {
      if (placed[other] == placed[i]) return false;
    }
    if (traffic.empty()) continue;
    for (const Neighbour& other : p.neighbours(i)) {
      traffic[placed[i] * p.m + placed[other.unit]] += other.traffic;
    }
  }
  for (int a = 0; a < p.m && !traffic.empty(); ++a) {
    for (int b = 0; b < a; ++b) {
      const double limit = p.bandwidth[a * p.m + b];
      if (traffic[a * p.m + b] > limit + kSlack * std::max(1.0, limit)) return false;
    }
  }
  const std::vector<double> left = residues(p, placed);
  for (std::size_t e = 0; e < left.size(); ++e) {
    // A computer that carries nothing breaks no limit.
    if (left[e] < p.floor[e] && left[e] < p.capacity[e]) return false;
  }
  return true;
}

}  // namespace poise
