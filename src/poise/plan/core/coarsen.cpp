#include "coarsen.h"

#include <algorithm>
#include <numeric>

namespace poise {
namespace {

// Whether two units may share a computer, wherever one of them may run.
bool may_join(const Problem& p, int i, int j) {
  if (p.restricted(i) && p.restricted(j)) {
    const bool one = p.choices(i) == 1 && p.choices(j) == 1 && p.only(i) == p.only(j);
    if (!one) return false;
  }
  for (const std::int32_t other : p.apart(i)) {
    if (other == j) return false;
  }
  return true;
}

std::vector<double> most(const Problem& p, double largest) {
  std::vector<double> out(p.r, 0.0);
  for (int k = 0; k < p.r; ++k) {
    for (int h = 0; h < p.m; ++h) {
      out[k] += (p.capacity[k * p.m + h] - p.floor[k * p.m + h]) / p.m * largest;
    }
  }
  return out;
}

// Heavy-edge matching: each unit, in random order, takes its heaviest free neighbour.
std::vector<std::int32_t> match(const Problem& p, double largest, Random& random,
                                int& count) {
  const std::vector<double> limit = most(p, largest);
  std::vector<std::int32_t> part(p.n, -1);
  count = 0;
  // Blocks of consecutive units in random order: nearly as random, and far fewer cache
  // misses than a full shuffle.
  constexpr int kBlock = 64;
  std::vector<std::int32_t> blocks((p.n + kBlock - 1) / kBlock);
  std::iota(blocks.begin(), blocks.end(), 0);
  for (std::size_t i = blocks.size(); i > 1; --i) {
    std::swap(blocks[i - 1], blocks[random.below(static_cast<int>(i))]);
  }
  for (const std::int32_t block : blocks) {
    const int end = std::min(p.n, (block + 1) * kBlock);
    for (int i = block * kBlock; i < end; ++i) {
      if (part[i] >= 0) continue;
      int best = -1;
      double heaviest = 0;
      for (const Neighbour& other : p.neighbours(i)) {
        if (part[other.unit] >= 0 || other.overhead <= heaviest) continue;
        bool fits = true;
        for (int k = 0; k < p.r; ++k) {
          const std::size_t a = static_cast<std::size_t>(i) * p.r + k;
          const std::size_t b = static_cast<std::size_t>(other.unit) * p.r + k;
          fits &= p.demand[a] + p.demand[b] <= limit[k];
        }
        if (!fits || !may_join(p, i, other.unit)) continue;
        best = other.unit;
        heaviest = other.overhead;
      }
      part[i] = count;
      if (best >= 0) part[best] = count;
      ++count;
    }
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

Problem Problem::joined(const std::vector<std::int32_t>& part, int count) const {
  Problem out;
  out.n = count;
  out.m = m;
  out.r = r;
  out.capacity = capacity;
  out.floor = floor;
  out.scale = scale;
  out.weight = weight;
  out.counted = counted;
  out.distance = distance;
  out.bandwidth = bandwidth;
  out.variance = variance;
  out.words_ = words_;
  out.demand.assign(static_cast<std::size_t>(count) * r, 0.0);
  if (!cost.empty()) out.cost.assign(static_cast<std::size_t>(count) * m, 0.0);
  if (!rows_.empty()) out.rows_.assign(count, -1);
  // The units of each part, one part after the other.
  std::vector<std::int32_t> starts(count + 1, 0), members(n);
  for (int i = 0; i < n; ++i) ++starts[part[i] + 1];
  std::partial_sum(starts.begin(), starts.end(), starts.begin());
  std::vector<std::int32_t> next(starts.begin(), starts.end() - 1);
  for (int i = 0; i < n; ++i) members[next[part[i]]++] = i;
  for (int i = 0; i < n; ++i) {
    const std::size_t c = part[i];
    for (int k = 0; k < r; ++k) {
      out.demand[c * r + k] += demand[static_cast<std::size_t>(i) * r + k];
    }
    for (int h = 0; h < m && !cost.empty(); ++h) out.cost[c * m + h] += linear(i, h);
    if (!restricted(i) || out.rows_[c] >= 0) continue;
    out.rows_[c] = static_cast<std::int32_t>(out.masks_.size() / words_);
    const std::uint64_t* row = masks_.data() + rows_[i] * words_;
    out.masks_.insert(out.masks_.end(), row, row + words_);
  }
  // Connectors between the same parts add up; those within a part are gone.
  out.starts_.assign(1, 0);
  out.starts_.reserve(count + 1);
  out.adjacency_.reserve(adjacency_.size() / 2);
  std::vector<std::int64_t> seen(count, -1);
  for (int c = 0; c < count; ++c) {
    const auto first = static_cast<std::int64_t>(out.adjacency_.size());
    for (int s = starts[c]; s < starts[c + 1]; ++s) {
      for (const Neighbour& other : neighbours(members[s])) {
        const std::int32_t to = part[other.unit];
        if (to == c) continue;
        if (seen[to] >= first) {
          out.adjacency_[seen[to]].overhead += other.overhead;
          out.adjacency_[seen[to]].traffic += other.traffic;
        } else {
          seen[to] = static_cast<std::int64_t>(out.adjacency_.size());
          out.adjacency_.push_back({to, other.overhead, other.traffic});
        }
      }
    }
    out.starts_.push_back(static_cast<std::int64_t>(out.adjacency_.size()));
  }
  if (!apart_.empty()) {
    out.apart_starts_.assign(1, 0);
    for (int c = 0; c < count; ++c) {
      for (int s = starts[c]; s < starts[c + 1]; ++s) {
        for (const std::int32_t other : apart(members[s])) {
          out.apart_.push_back(part[other]);
        }
      }
      out.apart_starts_.push_back(static_cast<std::int64_t>(out.apart_.size()));
    }
  }
  return out;
}

}  // namespace poise
