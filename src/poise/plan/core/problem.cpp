#include "problem.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "times.h"

namespace poise {

void Problem::set_rooms(const std::vector<double>& has, const std::vector<double>& limit,
                        bool share) {
  capacity.resize(has.size());
  floor.resize(has.size());
  goal.assign(has.size(), -kInfinity);
  scale.assign(has.size(), 1.0);
  counted.assign(r, m);
  for (int k = 0; k < r; ++k) {
    if (price[k] > 0) priced.push_back(k);
    for (int h = 0; h < m; ++h) {
      const std::size_t from = static_cast<std::size_t>(h) * r + k;
      const std::size_t to = static_cast<std::size_t>(k) * m + h;
      capacity[to] = has[from];
      floor[to] = has[from] - limit[from] - kSlack * std::max(1.0, limit[from]);
      if (price[k] > 0) {
        goal[to] = has[from] - limit[from];
        floor[to] = -kInfinity;
      }
      if (!share) continue;
      scale[to] = has[from] > 0 ? 1.0 / has[from] : 0.0;
      if (has[from] <= 0) --counted[k];
    }
    // Over one computer, or none, there is no spread.
    if (counted[k] <= 1) weight[k] = 0;
  }
}

void Problem::restrict_units(
    const std::map<std::int32_t, std::vector<std::int32_t>>& allowed) {
  if (allowed.empty()) return;
  words_ = (static_cast<std::size_t>(m) + 63) / 64;
  rows_.assign(n, -1);
  masks_.assign(allowed.size() * words_, 0);
  std::int32_t row = 0;
  for (const auto& [unit, computers] : allowed) {
    for (const std::int32_t h : computers) {
      masks_[row * words_ + h / 64] |= std::uint64_t{1} << (h % 64);
    }
    rows_[unit] = row++;
  }
}

void Problem::limit_time(TimeLimits limits) {
  limits.list_units(n);
  for (TimeLimits::Limit& each : limits.limits) {
    for (TimeLimits::Run& run : each.runs) {
      double fastest = 0;
      for (int h = 0; h < m; ++h) {
        if (allowed(run.unit, h)) fastest = std::max(fastest, limits.speed[h]);
      }
      run.least = fastest > 0 ? run.seconds / fastest : 0.0;
    }
  }
  time_limits = std::move(limits);
}

void Problem::sort_units() {
  std::vector<std::pair<bool, double>> sizes(n);  // whether it is pinned, and its size
  for (int i = 0; i < n; ++i) {
    double size = 0;
    for (int k = 0; k < r; ++k) size += size_weight[k] * need(i)[k];
    sizes[i] = {restricted(i) && choices(i) == 1, size};
  }
  order.resize(n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return sizes[a] != sizes[b] ? sizes[a] > sizes[b] : a < b;
  });
}

int Problem::choices(int unit) const {
  if (!restricted(unit)) return m;
  int count = 0;
  for (std::size_t w = 0; w < words_; ++w) {
    count += __builtin_popcountll(masks_[rows_[unit] * words_ + w]);
  }
  return count;
}

bool Problem::may_join(int unit, int other) const {
  if (!restricted(unit) || !restricted(other)) return true;
  const auto row = [&](int i) { return masks_.begin() + rows_[i] * words_; };
  return std::equal(row(unit), row(unit) + words_, row(other));
}

Problem Problem::joined(const std::vector<std::int32_t>& part, int count) const {
  Problem out;
  out.n = count;
  out.m = m;
  out.r = r;
  out.capacity = capacity;
  out.floor = floor;
  out.price = price;
  out.goal = goal;
  out.priced = priced;
  out.scale = scale;
  out.weight = weight;
  out.size_weight = size_weight;
  out.counted = counted;
  out.distance = distance;
  out.bandwidth = bandwidth;
  out.variance = variance;
  out.words_ = words_;
  out.masks_ = masks_;
  out.demand.assign(static_cast<std::size_t>(count) * r, 0.0);
  if (!cost.empty()) out.cost.assign(static_cast<std::size_t>(count) * m, 0.0);
  if (!rows_.empty()) out.rows_.assign(count, -1);
  Lists<std::int32_t> members;
  members.fill(count, [&](auto add) {
    for (int i = 0; i < n; ++i) add(part[i], i);
  });
  for (int i = 0; i < n; ++i) {
    const std::size_t c = part[i];
    for (int k = 0; k < r; ++k) out.demand[c * r + k] += need(i)[k];
    for (int h = 0; h < m && !cost.empty(); ++h) out.cost[c * m + h] += linear(i, h);
    if (restricted(i)) out.rows_[c] = rows_[i];
  }
  // Connectors between the same parts add up; those within a part are gone.
  std::vector<std::pair<std::int32_t, Neighbour>> ends;
  std::vector<std::int64_t> seen(count, -1);
  for (int c = 0; c < count; ++c) {
    const auto first = static_cast<std::int64_t>(ends.size());
    for (const std::int32_t i : members.of(c)) {
      for (const Neighbour& other : neighbours(i)) {
        const std::int32_t to = part[other.unit];
        if (to == c) continue;
        if (seen[to] < first) {
          seen[to] = static_cast<std::int64_t>(ends.size());
          ends.push_back({c, {to, 0.0, 0.0}});
        }
        ends[seen[to]].second.overhead += other.overhead;
        ends[seen[to]].second.traffic += other.traffic;
      }
    }
  }
  out.neighbours_.fill(count, [&](auto add) {
    for (const auto& [c, end] : ends) add(c, end);
  });
  out.apart_.fill(count, [&](auto add) {
    for (int i = 0; i < n; ++i) {
      for (const std::int32_t other : apart(i)) add(part[i], part[other]);
    }
  });
  out.sort_units();
  if (time_limits) out.limit_time(time_limits->joined(part));
  return out;
}

std::vector<double> residues(const Problem& p, const Placement& placed) {
  std::vector<double> left = p.capacity;
  for (int i = 0; i < p.n; ++i) {
    if (placed[i] < 0) continue;
    for (int k = 0; k < p.r; ++k) left[k * p.m + placed[i]] -= p.demand[i * p.r + k];
  }
  return left;
}

// Weighted spread of residues (r, m) over all computers.
static double spread_of(const Problem& p, const std::vector<double>& left) {
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
  const std::vector<double> left = residues(p, placed);
  out.balance = spread_of(p, left);
  for (const int k : p.priced) {
    for (int h = 0; h < p.m; ++h) {
      out.shortage += p.price[k] * p.shortage(k, h, left[k * p.m + h]);
    }
  }
  if (p.time_limits) out.time = time_sum(p, placed, left).paid;
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
  return !p.time_limits || time_sum(p, placed, left).broken == 0;
}

}  // namespace poise
