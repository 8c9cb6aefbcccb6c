#include "frontier.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace poise {
namespace {

// By trial on random robots: 24 units on 2 computers have a few hundred states, and
// making the tables for them takes no longer than the search that they save.
constexpr double kSizeOverTie = 1.5;
constexpr int kWide = 6;  // what the frontier should keep to
constexpr int kLevels[] = {1, 8, 4, 3};  // prices for a resource, by how many are weighed
constexpr double kReach = 3.0;  // prices of variance go as far as this many units

}  // namespace

bool FrontierTree::takes(const Problem& p) {
  int weighed = 0;
  for (int k = 0; k < p.r; ++k) weighed += p.weight[k] > 0;
  return p.m == 2 && p.r > 0 && weighed <= kMostWeighed && p.bandwidth.empty() &&
         !p.has_apart() && p.priced.empty() && !p.time_limits;
}

FrontierTree::FrontierTree(const Problem& problem) : Tree(problem) {
  if (!possible_) return;
  narrow_ = sort_units() && count_states();
  if (!narrow_) return;
  settle_forced();
  set_prices();
  fill_tables();
}

// Units with one choice come first and are no part of the frontier. Of the others always
// the one with most to say, by ties and by size, that keeps the frontier narrow.
bool FrontierTree::sort_units() {
  std::vector<double> value(n_, 0.0);
  for (int k = 0; k < r_; ++k) {
    const double scale = (p_.scale[k * 2] + p_.scale[k * 2 + 1]) / 2;
    for (int i = 0; i < n_; ++i) {
      value[i] += kSizeOverTie * p_.weight[k] * p_.demand[i * r_ + k] * scale;
    }
  }
  std::vector<std::int32_t> open;
  for (const std::int32_t unit : p_.order) {
    if (p_.choices(unit) == 1) order_.push_back(unit);
    else open.push_back(unit);
  }
  forced_ = static_cast<int>(order_.size());
  free_ = static_cast<int>(open.size());
  depth_of_.assign(n_, -1);
  std::vector<int> open_ties(n_, 0);  // connectors to units that are open
  for (const std::int32_t unit : open) {
    for (const Neighbour& other : p_.neighbours(unit)) ++open_ties[other.unit];
  }
  int width = 0;
  while (!open.empty()) {
    if (width > 30 || std::uint32_t{1} << width > most_states()) return false;
    std::size_t best = 0;
    int least = std::numeric_limits<int>::max(), best_width = 0;
    for (std::size_t i = 0; i < open.size(); ++i) {
      int next = width + (open_ties[open[i]] > 0);
      for (const Neighbour& other : p_.neighbours(open[i])) {
        next -= depth_of_[other.unit] >= 0 && open_ties[other.unit] == 1;
      }
      const int excess = std::max(next, kWide);
      if (excess > least) continue;
      if (excess == least && value[open[i]] <= value[open[best]]) continue;
      best = i;
      least = excess;
      best_width = next;
    }
    const std::int32_t unit = open[best];
    width = best_width;
    depth_of_[unit] = static_cast<std::int32_t>(order_.size()) - forced_;
    order_.push_back(unit);
    open.erase(open.begin() + static_cast<std::ptrdiff_t>(best));
    for (const Neighbour& other : p_.neighbours(unit)) {
      --open_ties[other.unit];
      value[other.unit] += other.overhead;
    }
  }
  return true;
}

// Give every unit a bit of the frontier's placement for as long as it has open
// neighbours, and every depth its states.
bool FrontierTree::count_states() {
  std::vector<int> last(free_, -1);  // depth of the last neighbour
  for (int d = 0; d < free_; ++d) {
    for (const Neighbour& other : p_.neighbours(order_[forced_ + d])) {
      last[d] = std::max(last[d], depth_of_[other.unit]);
    }
  }
  depths_.resize(free_ + 1);
  std::uint32_t used = 0, states = 0;
  for (int d = 0; d < free_; ++d) {
    depths_[d].start = states;
    std::uint32_t count = 1;
    while (count <= used) count *= 2;
    states += count;
    for (int e = 0; e < d; ++e) {
      if (last[e] == d) used &= ~depths_[e].bit;
    }
    depths_[d].bit = last[d] > d ? ~used & (used + 1) : 0;
    used |= depths_[d].bit;
    depths_[d].keep = used;
    if (states + used >= most_states()) return false;
  }
  depths_[free_] = {states, 0, 0};
  states_.resize(states);
  return true;
}

void FrontierTree::settle_forced() {
  left_.resize(static_cast<std::size_t>(free_ + 1) * r_ * 2);
  std::copy(p_.capacity.begin(), p_.capacity.end(), left_.begin());
  for (int d = 0; d < forced_; ++d) {
    const int unit = order_[d], side = p_.allowed(unit, 0) ? 0 : 1;
    at_[d] = side;
    forced_cost_ += p_.linear(unit, side);
    for (int e = 0; e < d; ++e) {
      if (at_[e] == side) continue;
      for (const Neighbour& other : p_.neighbours(unit)) {
        if (other.unit == order_[e]) forced_cost_ += other.overhead * p_.far(0, 1);
      }
    }
    for (int k = 0; k < r_; ++k) {
      double& left = left_[k * 2 + side];
      left -= p_.demand[unit * r_ + k];
      holds_ &= left >= p_.floor[k * 2 + side];
    }
  }
  twins_ = forced_ == 0 && p_.cost.empty();
  for (int k = 0; k < r_; ++k) {
    twins_ &= p_.capacity[k * 2] == p_.capacity[k * 2 + 1] &&
              p_.floor[k * 2] == p_.floor[k * 2 + 1];
  }
  for (int d = 0; d < free_; ++d) {
    for (int k = 0; k < r_; ++k) {
      need_.push_back(p_.demand[order_[forced_ + d] * r_ + k]);
    }
  }
}

// A price is the slope of a line that is below what imbalance costs: the constant is how
// far below, where the line would cut the axis.
void FrontierTree::set_prices() {
  for (int k = 0; k < r_; ++k) {
    if (p_.weight[k] > 0) weighed_.push_back({k, p_.weight[k], 0});
  }
  const int count = static_cast<int>(weighed_.size()), levels = kLevels[count];
  int all = 1;
  for (int w = 0; w < count; ++w) all *= levels;
  prices_ = (all + 3) / 4 * 4;
  price_.resize(static_cast<std::size_t>(count) * prices_);
  constant_.assign(prices_, 0.0);
  int repeat = 1;
  for (int w = 0; w < count; ++w, repeat *= levels) {
    const int k = weighed_[w].resource;
    const double* scale = p_.scale.data() + k * 2;
    double sum = 0;
    weighed_[w].first = left_[k * 2] * scale[0] - left_[k * 2 + 1] * scale[1];
    for (int d = 0; d < free_; ++d) {
      const double need = need_[d * r_ + k];
      sum += need * (scale[0] + scale[1]) / 2;
      weighed_[w].first += need * (scale[1] - scale[0]) / 2;
    }
    // The variance of two residues is a quarter of their difference squared: its slope
    // is half of the difference, which ends at less than a few units' worth.
    const double reach = p_.variance ? kReach * sum / std::max(free_, 1) : 1.0;
    for (int l = 0; l < prices_; ++l) {
      const double slope = reach * (2.0 * (l / repeat % levels) / (levels - 1) - 1);
      price_[w * prices_ + l] = weighed_[w].weight * slope;
      if (p_.variance) constant_[l] -= weighed_[w].weight * slope * slope;
    }
  }
  for (int d = 0; d < free_; ++d) {
    for (const Weighed& one : weighed_) {
      const double* scale = p_.scale.data() + one.resource * 2;
      half_.push_back(need_[d * r_ + one.resource] * (scale[0] + scale[1]) / 2);
    }
  }
  tilt_.assign(static_cast<std::size_t>(free_) * prices_, 0.0);
  for (int d = 0; d < free_; ++d) {
    for (int w = 0; w < count; ++w) {
      for (int l = 0; l < prices_; ++l) {
        tilt_[d * prices_ + l] += half_[d * count + w] * price_[w * prices_ + l];
      }
    }
  }
  off_.resize(static_cast<std::size_t>(free_ + 1) * count);
  for (int w = 0; w < count; ++w) off_[w] = weighed_[w].first;
}

void FrontierTree::fill_tables() {
  least_.resize((states_.size() + 1) * static_cast<std::size_t>(prices_));
  std::copy(constant_.begin(), constant_.end(), least_.end() - prices_);
  for (int d = free_ - 1; d >= 0; --d) {
    const std::uint32_t start = depths_[d].start, count = depths_[d + 1].start - start;
    fill_costs(d, count);
    for (std::uint32_t placed = 0; placed < count; ++placed) {
      fill_least(d, states_[start + placed],
                 &least_[(start + placed) * static_cast<std::size_t>(prices_)]);
    }
  }
}

// What the unit at a depth costs on either side, for each placement of the frontier.
void FrontierTree::fill_costs(int d, std::uint32_t count) {
  const Depth& depth = depths_[d];
  const int unit = order_[forced_ + d];
  double cost[2] = {p_.linear(unit, 0), p_.linear(unit, 1)};
  // Overhead to all whose bit is set; those with one bit first, then sums of two.
  apart_.assign(count, 0.0);
  for (const Neighbour& other : p_.neighbours(unit)) {
    const int e = depth_of_[other.unit];
    const double overhead = other.overhead * p_.far(0, 1);
    if (e < 0) cost[p_.allowed(other.unit, 0) ? 1 : 0] += overhead;
    else if (e < d) apart_[depths_[e].bit] += overhead;
  }
  for (std::uint32_t placed = 0; placed < count; ++placed) {
    const std::uint32_t rest = placed & (placed - 1);
    if (rest) apart_[placed] = apart_[rest] + apart_[placed ^ rest];
  }
  for (std::uint32_t placed = 0; placed < count; ++placed) {
    State& state = states_[depth.start + placed];
    state.cost[0] = cost[0] + apart_[placed];
    state.cost[1] = cost[1] + apart_[~placed & (count - 1)];
    const std::uint32_t after = depths_[d + 1].start;
    state.next[0] = after + (placed & ~depth.bit & depth.keep);
    state.next[1] = after + ((placed | depth.bit) & depth.keep);
  }
}

void FrontierTree::fill_least(int d, const State& state, double* least) const {
  const double* after0 = &least_[state.next[0] * static_cast<std::size_t>(prices_)];
  const double* after1 = &least_[state.next[1] * static_cast<std::size_t>(prices_)];
  const double* tilt = &tilt_[static_cast<std::size_t>(d) * prices_];
  for (int l = 0; l < prices_; ++l) {
    const double at0 = state.cost[0] + after0[l] - tilt[l];
    const double at1 = state.cost[1] + after1[l] + tilt[l];
    least[l] = at0 < at1 ? at0 : at1;
  }
}

void FrontierTree::descend() {
  if (!holds_) return;
  switch (weighed_.size()) {
    case 0: return open<0>(0, 0, forced_cost_);
    case 1: return open<1>(0, 0, forced_cost_);
    case 2: return open<2>(0, 0, forced_cost_);
    default: return open<3>(0, 0, forced_cost_);
  }
}

template <int R>
void FrontierTree::open(int depth, std::uint32_t index, double paid) {
  if (depth == free_) return found();
  stop_->after(1);
  const State& state = states_[index];
  double bounds[2];
  for (const int side : {0, 1}) {
    bounds[side] = paid + state.cost[side] + bound<R>(depth, state.next[side], side);
  }
  // The computers are alike until the first unit is on one of them.
  if (depth == 0 && twins_) bounds[1] = kInfinity;
  const int better = bounds[1] < bounds[0] ? 1 : 0;
  for (const int side : {better, 1 - better}) {
    if (bounds[side] >= threshold_) return;
    if (!fits(depth, side)) continue;
    if (stop_->stopped()) {
      open_bound_ = std::min(open_bound_, bounds[side]);
      return;
    }
    place(depth, side);
    open<R>(depth + 1, state.next[side], paid + state.cost[side]);
  }
}

// What is still to be paid at least once the unit at `depth` is on `side`.
template <int R>
double FrontierTree::bound(int depth, std::uint32_t next, int side) const {
  double off[R > 0 ? R : 1];
  for (int w = 0; w < R; ++w) {
    const double half = half_[depth * R + w];
    off[w] = off_[depth * R + w] + (side == 0 ? -half : half);
  }
  // Four at a time, as each comparison waits for the one before it.
  double high[4] = {-kInfinity, -kInfinity, -kInfinity, -kInfinity};
  const double* least = &least_[next * static_cast<std::size_t>(prices_)];
  for (int l = 0; l < prices_; l += 4) {
    for (int i = 0; i < 4; ++i) {
      double value = least[l + i];
      for (int w = 0; w < R; ++w) value += price_[w * prices_ + l + i] * off[w];
      high[i] = value > high[i] ? value : high[i];
    }
  }
  return std::max(std::max(high[0], high[1]), std::max(high[2], high[3]));
}

bool FrontierTree::fits(int depth, int side) const {
  const double* left = &left_[static_cast<std::size_t>(depth) * r_ * 2];
  bool all = true;
  for (int k = 0; k < r_; ++k) {
    all &= left[k * 2 + side] - need_[depth * r_ + k] >= p_.floor[k * 2 + side];
  }
  return all;
}

void FrontierTree::place(int depth, int side) {
  at_[forced_ + depth] = side;
  const std::size_t count = weighed_.size();
  for (std::size_t w = 0; w < count; ++w) {
    const double half = half_[depth * count + w];
    off_[(depth + 1) * count + w] = off_[depth * count + w] + (side == 0 ? -half : half);
  }
  double* left = &left_[static_cast<std::size_t>(depth) * r_ * 2];
  for (int k = 0; k < r_; ++k) {
    left[(r_ + k) * 2] = left[k * 2];
    left[(r_ + k) * 2 + 1] = left[k * 2 + 1];
    left[(r_ + k) * 2 + side] -= need_[depth * r_ + k];
  }
}

}  // namespace poise
