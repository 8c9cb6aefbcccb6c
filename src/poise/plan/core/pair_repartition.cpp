#include "pair_repartition.h"

#include <algorithm>
#include <cmath>

namespace poise {
namespace {

// As in branch_and_bound.cpp: how much size counts against ties in the order of the units.
constexpr double kSizeOverTie = 0.6;
constexpr int kMostUnits = 200;

}  // namespace

PairRepartition::PairRepartition(const Problem& problem)
    : p_(problem), r_(problem.r), depth_of_(problem.n, -1), resources_(problem.r) {
  if (p_.time_limits) times_.emplace(p_);
}

bool PairRepartition::run(State& state, int a, int b, int most_nodes, Stop& stop) {
  if (!collect(state, a, b)) return false;
  weigh_resources(state, a, b);
  sides_[0] = a;
  sides_[1] = b;
  take_off(state);
  nodes_ = 0;
  most_nodes_ = most_nodes;
  improved_ = false;
  // What is now, in the same terms: then only something better is looked for.
  best_total_ = kInfinity;
  bool holds = true;
  int placed = 0;
  for (; placed < count_ && holds; ++placed) {
    holds = fits(placed, now_[placed]);
    place(placed, now_[placed]);
  }
  if (holds && in_time(0)) {
    const double total =
        base_[count_] - followed_ / 2 + imbalance(count_ - 1, -1) + time_.paid;
    best_total_ = total - 1e-10 * (1 + std::fabs(total));
  }
  while (placed > 0) {
    --placed;
    unplace(placed, now_[placed]);
  }
  weigh_pulls();
  open(0);
  stop.after(nodes_ / 4 + 1);
  for (const std::int32_t unit : units_) depth_of_[unit] = -1;
  if (!improved_) return false;
  Units out, back;
  for (int d = 0; d < count_; ++d) {
    if (best_[d] != now_[d]) (now_[d] == 0 ? out : back).push_back(units_[d]);
  }
  const double excess = state.excess();
  state.apply(out, back, a, b);
  // The tree knows nothing of links: what overfills one is taken back.
  if (p_.bandwidth.empty() || state.excess() <= excess) return true;
  state.apply(back, out, a, b);
  return false;
}

// Gather the units of both computers; false when there is nothing to share out.
bool PairRepartition::collect(const State& state, int a, int b) {
  units_.clear();
  for (const int h : {a, b}) {
    units_.insert(units_.end(), state.on(h).begin(), state.on(h).end());
  }
  count_ = static_cast<int>(units_.size());
  if (count_ < 2 || count_ > kMostUnits) return false;
  sort_units(a, b);
  connect(state, a, b);
  need_.resize(static_cast<std::size_t>(count_) * r_);
  open_.assign(static_cast<std::size_t>(count_ + 1) * r_, 0.0);
  for (int d = count_ - 1; d >= 0; --d) {
    for (int k = 0; k < r_; ++k) {
      need_[d * r_ + k] = p_.demand[units_[d] * r_ + k];
      open_[d * r_ + k] = open_[(d + 1) * r_ + k] + need_[d * r_ + k];
    }
  }
  return true;
}

// Set up how long things take without the units, where any of them has a part in that.
void PairRepartition::take_off(const State& state) {
  if (!times_) return;
  timed_ = false;
  Placement others = state.placed();
  for (const std::int32_t unit : units_) {
    timed_ |= p_.time_limits->of_unit.of(unit).size() > 0;
    others[unit] = -1;
  }
  time_ = timed_ ? times_->reset(others) : TimeSum{};
  late_ = time_.broken;
}

// Order the units as branch and bound does: those with one choice first, then by ties and size.
void PairRepartition::sort_units(int a, int b) {
  std::sort(units_.begin(), units_.end());
  value_.assign(static_cast<std::size_t>(count_), 0.0);
  for (int d = 0; d < count_; ++d) {
    depth_of_[units_[d]] = d;
    for (int k = 0; k < r_; ++k) {
      const double scale = (p_.scale[k * p_.m + a] + p_.scale[k * p_.m + b]) / 2;
      value_[d] += kSizeOverTie * p_.weight[k] * p_.demand[units_[d] * r_ + k] * scale;
    }
    if (!p_.allowed(units_[d], a) || !p_.allowed(units_[d], b)) value_[d] = kInfinity;
  }
  for (int d = 0; d < count_; ++d) {
    int next = d;
    for (int i = d + 1; i < count_; ++i) {
      if (value_[i] > value_[next]) next = i;
    }
    std::swap(units_[d], units_[next]);
    std::swap(value_[d], value_[next]);
    depth_of_[units_[d]] = d;
    depth_of_[units_[next]] = next;
    for (const Neighbour& other : p_.neighbours(units_[d])) {
      const int depth = depth_of_[other.unit];
      if (depth > d) value_[depth] += other.overhead;
    }
  }
}

// Set up ties between the units, and each one's pull towards everything else.
void PairRepartition::connect(const State& state, int a, int b) {
  const std::size_t count = static_cast<std::size_t>(count_);
  now_.resize(count);
  side_.resize(count);
  forced_.resize(count);
  pull_.resize(count);
  base_.assign(count + 1, 0.0);
  ties_.clear();
  tie_start_.assign(1, 0);
  const double far = p_.far(a, b);
  for (int d = 0; d < count_; ++d) {
    const int unit = units_[d];
    const bool at_a = p_.allowed(unit, a), at_b = p_.allowed(unit, b);
    now_[d] = state.at(unit) == a ? 0 : 1;
    forced_[d] = static_cast<signed char>(at_a && at_b ? -1 : at_a ? 0 : 1);
    double pays_a = state.pays(unit, a), pays_b = state.pays(unit, b);
    for (const Neighbour& other : p_.neighbours(unit)) {
      const int depth = depth_of_[other.unit];
      if (depth < 0) continue;
      (state.at(other.unit) == a ? pays_b : pays_a) -= other.overhead * far;
      if (depth > d) ties_.push_back({depth, other.overhead * far});
    }
    tie_start_.push_back(ties_.size());
    pull_[d] = pays_b - pays_a;
    base_[0] += (pays_a + pays_b) / 2;
  }
  saved_pull_.resize(ties_.size());
  for (int d = 0; d < count_; ++d) {
    base_[d + 1] = base_[d];
    for (std::size_t e = tie_start_[d]; e < tie_start_[d + 1]; ++e) {
      base_[d + 1] += ties_[e].overhead / 2;
    }
  }
}

void PairRepartition::weigh_resources(const State& state, int a, int b) {
  for (int k = 0; k < r_; ++k) {
    Resource& out = resources_[k];
    for (int side = 0; side < 2; ++side) {
      const int h = side == 0 ? a : b;
      const std::size_t e = static_cast<std::size_t>(k) * p_.m + h;
      out.left[side] = state.left(k, h);
      out.floor[side] = p_.floor[e];
      out.goal[side] = p_.goal[e];
      out.scale[side] = p_.scale[e];
      out.size[side] = p_.scale[e] > 0 ? 1 / p_.scale[e] : 0.0;
    }
    for (int d = 0; d < count_; ++d) out.left[now_[d]] += need_[d * r_ + k];
    out.weight = p_.weight[k];
    out.even = out.scale[0] > 0 && out.scale[1] > 0;
    const State::Others others = state.others(k, a, b);
    out.high = others.high;
    out.low = others.low;
    out.sum = others.sum;
    out.squares = others.squares;
    out.centre = others.centre;
  }
  weigh_pulls();
}

void PairRepartition::weigh_pulls() {
  followed_ = pulling_ = 0;
  for (int d = 0; d < count_; ++d) pulling_ += std::fabs(pull_[d]);
}

void PairRepartition::open(int depth) {
  if (depth == count_) {
    const double total =
        base_[depth] - followed_ / 2 + imbalance(depth - 1, -1) + time_.paid;
    if (total >= best_total_) return;
    best_total_ = total;
    best_ = side_;
    improved_ = true;
    return;
  }
  if (++nodes_ > most_nodes_) return;
  double bounds[2];
  for (const int side : {0, 1}) bounds[side] = bound(depth, side);
  if (timed_) add_times(depth, bounds);
  const int better = bounds[1] < bounds[0] ? 1 : 0;
  for (const int side : {better, 1 - better}) {
    if (bounds[side] >= best_total_ || nodes_ > most_nodes_) return;
    enter(depth, side);
  }
}

void PairRepartition::enter(int depth, int side) {
  const double followed = followed_, pulling = pulling_;
  place(depth, side);
  const double least = base_[depth + 1] - (followed_ + pulling_) / 2;
  if (least < best_total_ && (!timed_ || in_time(least))) open(depth + 1);
  unplace(depth, side);
  followed_ = followed;
  pulling_ = pulling;
}

double PairRepartition::bound(int depth, int side) const {
  if (!fits(depth, side)) return kInfinity;
  const double pull = pull_[depth];
  const double follows = side == 0 ? pull : -pull;
  return base_[depth] - (followed_ + follows + pulling_ - std::fabs(pull)) / 2 +
         imbalance(depth, side);
}

// Add to the bounds of both sides what is beyond time limits then.
void PairRepartition::add_times(int depth, double* bounds) {
  for (const int side : {0, 1}) {
    if (bounds[side] >= best_total_) continue;
    TimeSum sum = times_->weigh(units_[depth], sides_[side]);
    sum.add(time_, 1);
    bounds[side] = sum.broken > late_ ? kInfinity : bounds[side] + sum.paid;
  }
}

bool PairRepartition::fits(int depth, int side) const {
  if (forced_[depth] == 1 - side) return false;
  const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
  bool all = true;
  for (int k = 0; k < r_; ++k) {
    all &= resources_[k].left[side] - need[k] >= resources_[k].floor[side];
  }
  if (!all || !p_.has_apart()) return all;
  for (const std::int32_t other : p_.apart(units_[depth])) {
    const int d = depth_of_[other];
    if (d == depth || (d >= 0 && d < depth && side_[d] == side)) return false;
  }
  return true;
}

// What the spread of all computers and the shortages of these two come to at least, once
// the unit at `depth` is on `side` (-1: as things stand) and what is open after it flows
// freely between the two.
double PairRepartition::imbalance(int depth, int side) const {
  double total = 0;
  for (const int k : p_.priced) {
    const Resource& resource = resources_[k];
    double over[2];
    for (const int s : {0, 1}) {
      const double need = s == side ? need_[depth * r_ + k] : 0.0;
      over[s] = resource.left[s] - need - resource.goal[s];
    }
    const double open = open_[(depth + 1) * r_ + k];
    const double room = std::max(0.0, over[0]) + std::max(0.0, over[1]);
    total += p_.price[k] * (std::max(0.0, -over[0]) + std::max(0.0, -over[1]) +
                            std::max(0.0, open - room));
  }
  for (int k = 0; k < r_; ++k) {
    const Resource& resource = resources_[k];
    if (resource.weight <= 0) continue;
    double a = resource.left[0], b = resource.left[1];
    if (side == 0) a -= need_[depth * r_ + k];
    if (side == 1) b -= need_[depth * r_ + k];
    total += resource.weight * spread(resource, a, b, open_[(depth + 1) * r_ + k]);
  }
  return total;
}

double PairRepartition::spread(const Resource& res, double left_a, double left_b,
                       double open) const {
  double a = left_a * res.scale[0], b = left_b * res.scale[1];
  if (!res.even) return spread_of_one(res, res.scale[0] > 0 ? a : b, open);
  // Let the open demand flow to where more is left, then to both alike.
  const double flow_a = std::min(open, std::max(0.0, (a - b) * res.size[0]));
  const double flow_b = std::min(open, std::max(0.0, (b - a) * res.size[1]));
  a -= flow_a * res.scale[0];
  b -= flow_b * res.scale[1];
  const double rest = (open - flow_a - flow_b) / (res.size[0] + res.size[1]);
  a -= rest;
  b -= rest;
  if (!p_.variance) {
    const double high = std::max(res.high, std::max(a, b));
    return high - std::min(res.low, std::min(a, b));
  }
  const double oa = a - res.centre, ob = b - res.centre;
  const double count = res.high;  // the number of computers that are counted
  const double mean = (res.sum + oa + ob) / count;
  return (res.squares + oa * oa + ob * ob) / count - mean * mean;
}

// When only one of the two has the resource, or none: it may keep `share` or lose more.
double PairRepartition::spread_of_one(const Resource& res, double share, double open) const {
  const int side = res.scale[0] > 0 ? 0 : 1;
  if (res.scale[side] <= 0) share = res.high;  // whatever the others have
  const double least = share - open * res.scale[side];
  if (!p_.variance) return std::max(res.high, least) - std::min(res.low, share);
  if (open > 0 || res.scale[side] <= 0) return 0;
  const double off = share - res.centre, mean = (res.sum + off) / res.high;
  return (res.squares + off * off) / res.high - mean * mean;
}

void PairRepartition::place(int depth, int side) {
  const double x = side == 0 ? 1.0 : -1.0;
  side_[depth] = static_cast<signed char>(side);
  if (timed_) time_ = times_->put(units_[depth], sides_[side]);
  followed_ += x * pull_[depth];
  pulling_ -= std::fabs(pull_[depth]);
  const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
  for (int k = 0; k < r_; ++k) resources_[k].left[side] -= need[k];
  for (std::size_t e = tie_start_[depth]; e < tie_start_[depth + 1]; ++e) {
    double& pull = pull_[ties_[e].depth];
    saved_pull_[e] = pull;
    pulling_ -= std::fabs(pull);
    pull += x * ties_[e].overhead;
    pulling_ += std::fabs(pull);
  }
}

void PairRepartition::unplace(int depth, int side) {
  if (timed_) time_ = times_->take_back();
  const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
  for (int k = 0; k < r_; ++k) resources_[k].left[side] += need[k];
  for (std::size_t e = tie_start_[depth]; e < tie_start_[depth + 1]; ++e) {
    pull_[ties_[e].depth] = saved_pull_[e];
  }
}

}  // namespace poise
