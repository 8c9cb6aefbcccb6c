#include "state.h"

#include <algorithm>
#include <cmath>

namespace poise {
namespace {

// Up to here what each unit pays on each computer is kept. Beyond, where any two computers
// are equally far, going through a unit's connectors each time takes no longer, and memory
// grows with units and connectors alone.
constexpr std::int64_t kLargestTable = 1 << 16;

}  // namespace

State::State(const Problem& problem)
    : p_(problem), placed_(p_.n, 0), on_(p_.m), spot_(p_.n), share_of_limit_(p_.r),
      high_(p_.r), low_(p_.r), sum_(p_.r), squares_(p_.r), centre_(p_.r), need_(p_.r),
      mark_(p_.n, 0) {
  if (p_.time_limits) times_.emplace(p_);
  for (int k = 0; k < p_.r; ++k) {
    double counted = 0;
    for (int h = 0; h < p_.m; ++h) {
      counted += p_.capacity[k * p_.m + h] * p_.scale[k * p_.m + h];
    }
    share_of_limit_[k] = p_.mean_room(k) > 0 ? 1 / p_.mean_room(k) : 1.0;
    centre_[k] = p_.counted[k] > 0 ? counted / p_.counted[k] : 0.0;
  }
}

void State::reset(const Placement& placed) {
  placed_ = placed;
  for (auto& units : on_) units.clear();
  const std::int64_t entries = static_cast<std::int64_t>(p_.n) * p_.m;
  if (entries <= kLargestTable || !p_.cost.empty() || !p_.distance.empty()) reset_table();
  paid_ = conflicts_ = 0;
  for (int i = 0; i < p_.n; ++i) {
    spot_[i] = static_cast<std::int32_t>(on_[placed_[i]].size());
    on_[placed_[i]].push_back(i);
    paid_ += p_.linear(i, placed_[i]);
    for (const Neighbour& other : p_.neighbours(i)) {
      if (other.unit < i) continue;
      paid_ += other.overhead * p_.far(placed_[i], placed_[other.unit]);
    }
    for (const std::int32_t other : p_.apart(i)) {
      conflicts_ += other >= i && placed_[other] == placed_[i];
    }
  }
  left_ = residues(p_, placed_);
  excess_ = shortage_ = 0;
  for (int h = 0; h < p_.m; ++h) {
    excess_ += over(h);
    shortage_ += shortage(h);
  }
  for (int k = 0; k < p_.r; ++k) {
    find_extremes(k);
    sum_[k] = squares_[k] = 0;
    for (int h = 0; h < p_.m; ++h) {
      if (p_.scale[k * p_.m + h] <= 0) continue;
      const double off = left_[k * p_.m + h] * p_.scale[k * p_.m + h] - centre_[k];
      sum_[k] += off;
      squares_[k] += off * off;
    }
  }
  balance_ = balance_now();
  if (times_) time_ = times_->reset(placed_);
  over_links_ = overfull_ = 0;
  traffic_.assign(p_.bandwidth.size(), 0.0);
  if (p_.bandwidth.empty()) return;
  for (int i = 0; i < p_.n; ++i) {
    for (const Neighbour& other : p_.neighbours(i)) {
      traffic_[placed_[i] * p_.m + placed_[other.unit]] += other.traffic;
    }
  }
  for (int a = 0; a < p_.m; ++a) {
    for (int b = 0; b < a; ++b) {
      const double limit = p_.bandwidth[a * p_.m + b] + kSlack;
      const double used = traffic_[a * p_.m + b];
      if (used <= limit * (1 + kSlack)) continue;
      over_links_ += std::log(used / limit);
      ++overfull_;
    }
  }
}

void State::reset_table() {
  table_.assign(static_cast<std::size_t>(p_.n) * p_.m, 0.0);
  if (!p_.cost.empty()) table_ = p_.cost;
  for (int i = 0; i < p_.n; ++i) {
    double* row = table_.data() + static_cast<std::size_t>(i) * p_.m;
    for (const Neighbour& other : p_.neighbours(i)) {
      const int there = placed_[other.unit];
      if (p_.distance.empty()) {
        for (int h = 0; h < p_.m; ++h) row[h] += other.overhead;
        row[there] -= other.overhead;
      } else {
        const double* far = p_.distance.data() + static_cast<std::size_t>(there) * p_.m;
        for (int h = 0; h < p_.m; ++h) row[h] += other.overhead * far[h];
      }
    }
  }
}

double State::over(int h) const {
  double total = 0;
  for (int k = 0; k < p_.r; ++k) {
    const double short_by = p_.floor[k * p_.m + h] - left_[k * p_.m + h];
    if (short_by > 0) total += short_by * share_of_limit_[k];
  }
  return total;
}

double State::shortage(int h) const {
  double total = 0;
  for (const int k : p_.priced) {
    total += p_.price[k] * p_.shortage(k, h, left_[k * p_.m + h]);
  }
  return total;
}

void State::find_extremes(int k) {
  Extremes high{{-kInfinity, -kInfinity, -kInfinity}, {-1, -1, -1}};
  Extremes low{{kInfinity, kInfinity, kInfinity}, {-1, -1, -1}};
  const auto insert = [](Extremes& e, int h, double x, bool up) {
    const auto beats = [up](double x1, double x2) { return up ? x1 > x2 : x1 < x2; };
    if (!beats(x, e.value[2])) return;
    int i = 2;
    for (; i > 0 && beats(x, e.value[i - 1]); --i) {
      e.value[i] = e.value[i - 1];
      e.computer[i] = e.computer[i - 1];
    }
    e.value[i] = x;
    e.computer[i] = h;
  };
  for (int h = 0; h < p_.m && p_.weight[k] > 0; ++h) {
    const double scale = p_.scale[k * p_.m + h];
    if (scale <= 0) continue;
    const double share = left_[k * p_.m + h] * scale;
    insert(high, h, share, true);
    insert(low, h, share, false);
  }
  high_[k] = high;
  low_[k] = low;
}

double State::balance_now() const {
  double total = 0;
  for (int k = 0; k < p_.r; ++k) {
    if (p_.weight[k] <= 0) continue;
    if (p_.variance) {
      const double mean = sum_[k] / p_.counted[k];
      total += p_.weight[k] * (squares_[k] / p_.counted[k] - mean * mean);
    } else {
      total += p_.weight[k] * (high_[k].value[0] - low_[k].value[0]);
    }
  }
  return total;
}

// `need_` leaves a for b: what that does to balance and limits.
Change State::weigh_loads(int a, int b) {
  Change change;
  double balance = 0;
  for (int k = 0; k < p_.r; ++k) {
    const std::size_t ea = static_cast<std::size_t>(k) * p_.m + a;
    const std::size_t eb = static_cast<std::size_t>(k) * p_.m + b;
    const double la = left_[ea], lb = left_[eb], need = need_[k];
    const double limit = share_of_limit_[k];
    const auto excess = [&](double left, std::size_t e) {
      return left < p_.floor[e] ? (p_.floor[e] - left) * limit : 0.0;
    };
    change.excess += excess(la + need, ea) - excess(la, ea) + excess(lb - need, eb) -
                     excess(lb, eb);
    if (p_.weight[k] <= 0) continue;
    const double sa = p_.scale[ea], sb = p_.scale[eb];
    if (p_.variance) {
      const double da = need * sa, db = -need * sb;
      const double oa = sa > 0 ? la * sa - centre_[k] : 0.0;
      const double ob = sb > 0 ? lb * sb - centre_[k] : 0.0;
      const double mean = (sum_[k] + da + db) / p_.counted[k];
      const double squares = squares_[k] + da * (da + 2 * oa) + db * (db + 2 * ob);
      balance += p_.weight[k] * (squares / p_.counted[k] - mean * mean);
    } else {
      double high = high_[k].without(a, b), low = low_[k].without(a, b);
      if (sa > 0) {
        const double share = (la + need) * sa;
        high = std::max(high, share);
        low = std::min(low, share);
      }
      if (sb > 0) {
        const double share = (lb - need) * sb;
        high = std::max(high, share);
        low = std::min(low, share);
      }
      balance += p_.weight[k] * (high - low);
    }
  }
  change.objective = balance - balance_;
  for (const int k : p_.priced) {
    const double la = left_[k * p_.m + a], lb = left_[k * p_.m + b], need = need_[k];
    change.objective += p_.price[k] * (p_.shortage(k, a, la + need) - p_.shortage(k, a, la) +
                                       p_.shortage(k, b, lb - need) - p_.shortage(k, b, lb));
  }
  return change;
}

Change State::weigh(const Units& out, const Units& back, int a, int b) {
  Change change = weigh_rest(out, back, a, b);
  change.objective += weigh_paid(out, back, a, b);
  return change;
}

double State::weigh_paid(const Units& out, const Units& back, int a, int b) {
  double paid = 0;
  for (const std::int32_t unit : out) paid += pays(unit, b) - pays(unit, a);
  for (const std::int32_t unit : back) paid += pays(unit, a) - pays(unit, b);
  const std::size_t count = out.size() + back.size();
  if (count == 1) return paid;
  // Each was weighed as if it moved alone. Two that move together stay together, and two
  // that change places stay apart: undo what was counted for them, for each of the pair.
  const double far = p_.far(a, b);
  if (out.size() == 1 && back.size() == 1) {
    for (const Neighbour& other : p_.neighbours(out[0])) {
      if (other.unit == back[0]) paid += 2 * far * other.overhead;
    }
    return paid;
  }
  for (const std::int32_t unit : out) mark_[unit] = 1;
  for (const std::int32_t unit : back) mark_[unit] = 2;
  for (const Units* units : {&out, &back}) {
    for (const std::int32_t unit : *units) {
      const char mine = mark_[unit];
      for (const Neighbour& other : p_.neighbours(unit)) {
        const char theirs = mark_[other.unit];
        if (theirs) paid += (theirs == mine ? -far : far) * other.overhead;
      }
    }
  }
  for (const std::int32_t unit : out) mark_[unit] = 0;
  for (const std::int32_t unit : back) mark_[unit] = 0;
  return paid;
}

Change State::weigh_rest(const Units& out, const Units& back, int a, int b) {
  std::fill(need_.begin(), need_.end(), 0.0);
  for (const std::int32_t unit : out) {
    for (int k = 0; k < p_.r; ++k) need_[k] += p_.need(unit)[k];
  }
  for (const std::int32_t unit : back) {
    for (int k = 0; k < p_.r; ++k) need_[k] -= p_.need(unit)[k];
  }
  Change change = weigh_loads(a, b);
  if (p_.has_apart()) change.excess += conflicts_with(out, back, a, b);
  if (!p_.bandwidth.empty()) change.excess += link_excess(out, back, a, b);
  if (!times_) return change;
  const TimeSum times = times_->weigh({all_of(out), all_of(back), a, b});
  change.objective += times.paid;
  change.excess += times.excess;
  return change;
}

// How many more pairs that must be apart would share a computer.
int State::conflicts_with(const Units& out, const Units& back, int a, int b) {
  for (const std::int32_t unit : out) mark_[unit] = 1;
  for (const std::int32_t unit : back) mark_[unit] = 2;
  int change = 0;
  for (const Units* units : {&out, &back}) {
    for (const std::int32_t unit : *units) {
      const int from = mark_[unit] == 1 ? a : b, to = a + b - from;
      for (const std::int32_t other : p_.apart(unit)) {
        if (mark_[other]) continue;
        change += (placed_[other] == to) - (placed_[other] == from);
      }
    }
  }
  for (const std::int32_t unit : out) mark_[unit] = 0;
  for (const std::int32_t unit : back) mark_[unit] = 0;
  return change;
}

// Move the traffic of one unit; the change of what exceeds the links' bandwidth.
double State::shift_traffic(int unit, int to) {
  const int from = placed_[unit], m = p_.m;
  double change = 0;
  const auto add = [&](int a, int b, double traffic) {
    if (a == b) return;
    const double limit = p_.bandwidth[a * m + b] + kSlack, last = limit * (1 + kSlack);
    double& used = traffic_[a * m + b];
    const bool was_over = used > last;
    const double before = was_over ? std::log(used / limit) : 0.0;
    used += traffic;
    traffic_[b * m + a] = used;
    change += (used > last ? std::log(used / limit) : 0.0) - before;
    overfull_ += (used > last) - was_over;
  };
  for (const Neighbour& other : p_.neighbours(unit)) {
    if (other.traffic <= 0) continue;
    add(from, placed_[other.unit], -other.traffic);
    add(to, placed_[other.unit], other.traffic);
  }
  placed_[unit] = to;
  return change;
}

double State::link_excess(const Units& out, const Units& back, int a, int b) {
  double change = 0;
  for (const std::int32_t unit : out) change += shift_traffic(unit, b);
  for (const std::int32_t unit : back) change += shift_traffic(unit, a);
  for (const std::int32_t unit : out) shift_traffic(unit, a);
  for (const std::int32_t unit : back) shift_traffic(unit, b);
  return change;
}

State::Others State::others(int k, int a, int b) const {
  if (!p_.variance) return {high_[k].without(a, b), low_[k].without(a, b), 0, 0, 0};
  Others out{static_cast<double>(p_.counted[k]), 0, sum_[k], squares_[k], centre_[k]};
  for (const int h : {a, b}) {
    const double scale = p_.scale[k * p_.m + h];
    if (scale <= 0) continue;
    const double off = left_[k * p_.m + h] * scale - centre_[k];
    out.sum -= off;
    out.squares -= off * off;
  }
  return out;
}

void State::apply(const Units& out, const Units& back, int a, int b) {
  for (const std::int32_t unit : out) shift(unit, b);
  for (const std::int32_t unit : back) shift(unit, a);
  if (times_) time_ = times_->apply({all_of(out), all_of(back), a, b});
  settle(a, b);
}

// Move one unit in all tables but those that `settle` brings up to date.
void State::shift(int unit, int to) {
  const int from = placed_[unit], m = p_.m;
  paid_ += pays(unit, to) - pays(unit, from);
  for (const std::int32_t other : p_.apart(unit)) {
    if (other != unit) conflicts_ += (placed_[other] == to) - (placed_[other] == from);
  }
  for (const Neighbour& other : p_.neighbours(unit)) {
    if (table_.empty()) break;
    double* row = table_.data() + static_cast<std::size_t>(other.unit) * m;
    if (p_.distance.empty()) {
      row[from] += other.overhead;
      row[to] -= other.overhead;
    } else {
      const double* then = p_.distance.data() + static_cast<std::size_t>(from) * m;
      const double* now = p_.distance.data() + static_cast<std::size_t>(to) * m;
      for (int h = 0; h < m; ++h) row[h] += other.overhead * (now[h] - then[h]);
    }
  }
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  excess_ -= over(from) + over(to);
  shortage_ -= shortage(from) + shortage(to);
  for (int k = 0; k < p_.r; ++k) {
    const std::size_t ea = static_cast<std::size_t>(k) * m + from;
    const std::size_t eb = static_cast<std::size_t>(k) * m + to;
    if (p_.variance && p_.weight[k] > 0) {
      const double da = need[k] * p_.scale[ea], db = -need[k] * p_.scale[eb];
      sum_[k] += da + db;
      squares_[k] += da * (da + 2 * (left_[ea] * p_.scale[ea] - centre_[k])) +
                     db * (db + 2 * (left_[eb] * p_.scale[eb] - centre_[k]));
    }
    left_[ea] += need[k];
    left_[eb] -= need[k];
  }
  excess_ += over(from) + over(to);
  shortage_ += shortage(from) + shortage(to);
  if (!p_.bandwidth.empty()) over_links_ += shift_traffic(unit, to);
  auto& old = on_[from];
  old[spot_[unit]] = old.back();
  spot_[old.back()] = spot_[unit];
  old.pop_back();
  spot_[unit] = static_cast<std::int32_t>(on_[to].size());
  on_[to].push_back(unit);
  placed_[unit] = to;
}

void State::settle(int a, int b) {
  for (int k = 0; k < p_.r && !p_.variance; ++k) {
    if (p_.weight[k] <= 0) continue;
    bool stale = false;
    for (const int h : {a, b}) {
      const double share = left_[k * p_.m + h] * p_.scale[k * p_.m + h];
      stale |= share >= high_[k].value[2] || share <= low_[k].value[2];
      for (int i = 0; i < 3; ++i) {
        stale |= high_[k].computer[i] == h || low_[k].computer[i] == h;
      }
    }
    if (stale) find_extremes(k);
  }
  balance_ = balance_now();
  // Sums of many small steps must not keep a limit broken that holds again.
  if (std::fabs(excess_) < 1e-12) excess_ = 0;
  if (std::fabs(shortage_) < 1e-12) shortage_ = 0;
  if (overfull_ == 0) over_links_ = 0;
}

}  // namespace poise
