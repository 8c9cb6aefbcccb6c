#include "greedy.h"

#include <algorithm>
#include <cmath>

namespace poise {

Greedy::Greedy(const Problem& problem)
    : p_(problem), first_share_(p_.capacity.size()), total_(p_.m), balance_(p_.r),
      first_balance_(p_.r) {
  if (p_.time_limits) times_.emplace(p_);
  for (int k = 0; k < p_.r; ++k) {
    Balance& b = first_balance_[k];
    b = {};
    for (int h = 0; h < p_.m; ++h) {
      const std::size_t e = static_cast<std::size_t>(k) * p_.m + h;
      // A computer without the resource must be neither the lowest nor the highest.
      first_share_[e] = p_.scale[e] > 0 ? p_.capacity[e] * p_.scale[e] : kInfinity;
      if (p_.scale[e] > 0) b.centre += first_share_[e] / p_.counted[k];
    }
    for (int h = 0; h < p_.m; ++h) {
      const std::size_t e = static_cast<std::size_t>(k) * p_.m + h;
      if (p_.scale[e] <= 0) continue;
      const double off = first_share_[e] - b.centre;
      b.sum += off;
      b.squares += off * off;
    }
    share_ = first_share_;
    find_extremes(k);
    b.low = balance_[k].low;
    b.high = balance_[k].high;
    b.second = balance_[k].second;
  }
}

bool Greedy::run(Placement& placed) {
  start();
  placed.assign(p_.n, -1);
  const bool timed = times_.has_value();
  if (timed) times_->reset(placed);
  for (const std::int32_t unit : p_.order) {
    pay_for_ties(unit, placed);
    for (int k = 0; k < p_.r; ++k) add_balance(k, p_.need(unit)[k]);
    for (const int k : p_.priced) add_shortage(k, p_.need(unit)[k]);
    shut(unit, placed);
    if (timed) add_times(unit);
    const int computer = best();
    if (computer < 0) return false;
    placed[unit] = computer;
    put(unit, computer);
    if (timed) times_->put(unit, computer);
  }
  return true;
}

void Greedy::start() {
  room_.resize(p_.capacity.size());
  for (std::size_t e = 0; e < room_.size(); ++e) room_[e] = p_.capacity[e] - p_.floor[e];
  share_ = first_share_;
  balance_ = first_balance_;
  if (!p_.priced.empty()) {
    over_goal_.resize(p_.capacity.size());
    for (std::size_t e = 0; e < room_.size(); ++e) over_goal_[e] = p_.capacity[e] - p_.goal[e];
  }
  traffic_.assign(p_.bandwidth.size(), 0.0);
  paid_ = 0;
}

// Begin `total_` with what has been paid, and what the unit pays for its connectors.
void Greedy::pay_for_ties(int unit, const Placement& placed) {
  const int m = p_.m;
  const auto neighbours = p_.neighbours(unit);
  if (ties_.size() < neighbours.size()) ties_.resize(neighbours.size());
  double all = paid_;
  int count = 0;
  // Without a branch, which would be guessed wrongly half of the time.
  for (const Neighbour& other : neighbours) {
    Tie& tie = ties_[count];
    tie.computer = placed[other.unit];
    tie.overhead = other.overhead;
    tie.traffic = other.traffic;
    const bool is_placed = tie.computer >= 0;
    all += is_placed ? other.overhead : 0.0;
    count += is_placed;
  }
  tie_count_ = count;
  if (p_.distance.empty()) {
    for (int h = 0; h < m; ++h) total_[h] = all;
    for (const Tie& tie : ties()) total_[tie.computer] -= tie.overhead;
  } else {
    for (int h = 0; h < m; ++h) total_[h] = paid_;
    for (const Tie& tie : ties()) {
      for (int h = 0; h < m; ++h) total_[h] += tie.overhead * p_.far(h, tie.computer);
    }
  }
  for (int h = 0; h < m && !p_.cost.empty(); ++h) total_[h] += p_.linear(unit, h);
}

// Add what a resource's spread comes to with `need` on each computer; infinite where
// there is no room for it.
void Greedy::add_balance(int k, double need) {
  const int m = p_.m;
  const Balance b = balance_[k];
  const std::size_t row = static_cast<std::size_t>(k) * m;
  const double *share = &share_[row], *room = &room_[row], *scale = &p_.scale[row];
  const double weight = p_.weight[k];
  double* total = total_.data();
  for (int h = 0; h < m; ++h) {
    if (room[h] < need) {
      total[h] = kInfinity;
    } else if (weight <= 0) {
      continue;
    } else if (p_.variance) {
      const double less = need * scale[h], now = scale[h] > 0 ? share[h] - b.centre : 0.0;
      const double mean = (b.sum - less) / p_.counted[k];
      const double squares = b.squares + less * (less - 2 * now);
      total[h] += weight * (squares / p_.counted[k] - mean * mean);
    } else {
      const double after = share[h] - need * scale[h];
      // Where the share is the largest, it may no longer be once the unit is there.
      const double high = share[h] == b.high ? std::max(after, b.second) : b.high;
      total[h] += weight * (high - std::min(after, b.low));
    }
  }
}

// Add by how much a shortage grows with `need` on each computer, at its price.
void Greedy::add_shortage(int k, double need) {
  const double* over = &over_goal_[static_cast<std::size_t>(k) * p_.m];
  for (int h = 0; h < p_.m; ++h) {
    total_[h] += p_.price[k] * (std::max(0.0, need - over[h]) - std::max(0.0, -over[h]));
  }
}

// Set F to infinity where something else than room keeps the unit out.
void Greedy::shut(int unit, const Placement& placed) {
  if (p_.restricted(unit)) {
    for (int h = 0; h < p_.m; ++h) {
      if (!p_.allowed(unit, h)) total_[h] = kInfinity;
    }
  }
  for (const std::int32_t other : p_.apart(unit)) {
    if (other == unit) std::fill(total_.begin(), total_.end(), kInfinity);
    else if (placed[other] >= 0) total_[placed[other]] = kInfinity;
  }
  if (!p_.bandwidth.empty()) shut_full_links();
}

void Greedy::shut_full_links() {
  std::vector<double> sent(p_.m, 0.0);
  for (const Tie& tie : ties()) sent[tie.computer] += tie.traffic;
  for (int h = 0; h < p_.m; ++h) {
    for (int c = 0; c < p_.m; ++c) {
      if (c == h || sent[c] <= 0) continue;
      const double limit = p_.bandwidth[h * p_.m + c];
      const double used = traffic_[h * p_.m + c] + sent[c];
      if (used > limit + kSlack * std::max(1.0, limit)) total_[h] = kInfinity;
    }
  }
}

// Add what is beyond time limits with the unit on each computer, all that has none taking
// the least it may; infinite where one breaks that must be kept.
void Greedy::add_times(int unit) {
  for (int h = 0; h < p_.m; ++h) {
    if (total_[h] == kInfinity) continue;
    TimeSum sum = times_->weigh(unit, h);
    sum.add(times_->sum(), 1);
    total_[h] = sum.broken > 0 ? kInfinity : total_[h] + sum.paid;
  }
}

// The first computer whose F is lowest, within rounding; -1 when none is finite.
int Greedy::best() const {
  const int m = p_.m;
  double lowest = kInfinity;
  for (int h = 0; h < m; ++h) lowest = total_[h] < lowest ? total_[h] : lowest;
  if (lowest == kInfinity) return -1;
  const double near = lowest + 1e-12 * std::max(1.0, std::fabs(lowest));
  int h = 0;
  while (h < m - 1 && !(total_[h] <= near)) ++h;
  return h;
}

void Greedy::put(int unit, int computer) {
  const int m = p_.m;
  paid_ += p_.linear(unit, computer);
  for (const Tie& tie : ties()) {
    paid_ += tie.overhead * p_.far(computer, tie.computer);
    if (p_.bandwidth.empty()) continue;
    traffic_[computer * m + tie.computer] += tie.traffic;
    traffic_[tie.computer * m + computer] += tie.traffic;
  }
  for (int k = 0; k < p_.r; ++k) {
    Balance& b = balance_[k];
    const double need = p_.need(unit)[k];
    const std::size_t e = static_cast<std::size_t>(k) * m + computer;
    const double less = need * p_.scale[e], before = share_[e];
    room_[e] -= need;
    if (!p_.priced.empty()) over_goal_[e] -= need;
    if (p_.scale[e] <= 0) continue;
    share_[e] -= less;
    b.sum -= less;
    b.squares += less * (less - 2 * (before - b.centre));
    b.low = std::min(b.low, share_[e]);
    if (before >= b.second) find_extremes(k);
  }
}

void Greedy::find_extremes(int k) {
  const int m = p_.m;
  double low = kInfinity, high = -kInfinity, second = -kInfinity;
  for (int h = 0; h < m; ++h) {
    const double share = share_[static_cast<std::size_t>(k) * m + h];
    if (share == kInfinity) continue;
    low = std::min(low, share);
    second = std::max(second, std::min(high, share));
    high = std::max(high, share);
  }
  balance_[k].low = low;
  balance_[k].high = high;
  balance_[k].second = second;
}

}  // namespace poise
