#include "times.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace poise {

void TimeSum::add(const TimeSum& other, int sign) {
  paid += sign * other.paid;
  excess += sign * other.excess;
  broken += sign * other.broken;
}

double seconds(const Problem& p, int i, const Placement& placed,
               const std::vector<double>& left) {
  const TimeLimits& all = *p.time_limits;
  const TimeLimits::Limit& each = all.limits[i];
  double total = each.fixed;
  for (const TimeLimits::Run& run : each.runs) {
    const int h = placed[run.unit];
    if (h < 0) {
      total += run.least;
      continue;
    }
    double takes = run.seconds / all.speed[h];
    const std::size_t e = static_cast<std::size_t>(each.cpu) * p.m + h;
    if (each.cpu >= 0 && p.capacity[e] > 0) {
      takes *= all.slowdown(h, (p.capacity[e] - left[e] - run.own) / p.capacity[e]);
    }
    total += takes;
  }
  for (const TimeLimits::Hop& hop : each.hops) {
    const int a = placed[hop.a], b = placed[hop.b];
    if (a < 0 || b < 0 || a == b) continue;
    const std::size_t link = static_cast<std::size_t>(a) * p.m + b;
    total += hop.seconds;
    if (!all.latency.empty()) total += hop.crossings * all.latency[link];
    if (!all.per_byte.empty()) total += hop.size * all.per_byte[link];
  }
  return total;
}

// What limit i comes to alone.
static TimeSum sum_of(const TimeLimits& limits, int i, double seconds) {
  const double limit = limits.limits[i].limit;
  if (limits.breaks(i, seconds)) return {0, std::log(seconds / limit), 1};
  return {limits.cost(i, seconds), 0, 0};
}

TimeSum time_sum(const Problem& p, const Placement& placed, const std::vector<double>& left) {
  TimeSum sum;
  for (int i = 0; i < p.time_limits->size(); ++i) {
    sum.add(sum_of(*p.time_limits, i, seconds(p, i, placed, left)), 1);
  }
  return sum;
}

Times::Times(const Problem& problem)
    : p_(problem), limits_(*problem.time_limits), seconds_(limits_.limits.size()),
      on_(p_.m), seen_(limits_.limits.size(), 0) {}

const TimeSum& Times::reset(const Placement& placed) {
  placed_ = placed;
  left_ = residues(p_, placed);
  for (auto& units : on_) units.clear();
  for (int unit = 0; unit < p_.n; ++unit) {
    if (placed_[unit] >= 0 && limits_.sharing.of(unit).size() > 0) {
      on_[placed_[unit]].push_back(unit);
    }
  }
  for (int i = 0; i < limits_.size(); ++i) seconds_[i] = seconds(p_, i, placed_, left_);
  sum_ = time_sum(p_, placed_, left_);
  undo_.clear();
  old_seconds_.clear();
  old_left_.clear();
  return sum_;
}

// Whether all is as from nothing: looked at in builds with assertions.
bool Times::exact() const {
  const auto near = [](double a, double b) {
    return !std::isfinite(b) || std::fabs(a - b) <= 1e-9 * (1 + std::fabs(b));
  };
  const std::vector<double> left = residues(p_, placed_);
  bool all = near(sum_.paid, time_sum(p_, placed_, left).paid);
  for (int i = 0; i < limits_.size(); ++i) {
    all &= near(seconds_[i], seconds(p_, i, placed_, left));
  }
  return all;
}

// Find the limits in which a unit that moves has a part, and those whose runs share one of
// the two computers.
void Times::find_touched(const Shift& shift) {
  touched_.clear();
  ++shift_;
  const auto touch = [&](Span<std::int32_t> limits) {
    for (const std::int32_t i : limits) {
      if (seen_[i] == shift_) continue;
      seen_[i] = shift_;
      touched_.push_back(i);
    }
  };
  for (const std::int32_t unit : shift.out) touch(limits_.of_unit.of(unit));
  for (const std::int32_t unit : shift.back) touch(limits_.of_unit.of(unit));
  for (const int h : {shift.a, shift.b}) {
    if (h < 0) continue;
    for (const std::int32_t unit : on_[h]) touch(limits_.sharing.of(unit));
  }
}

void Times::move(const Shift& shift) {
  for (const std::int32_t unit : shift.out) place(unit, shift.b);
  for (const std::int32_t unit : shift.back) place(unit, shift.a);
}

void Times::place(std::int32_t unit, int computer) {
  const int from = placed_[unit];
  for (const int cpu : limits_.cpus) {
    const double need = p_.need(unit)[cpu];
    if (from >= 0) left(cpu, from) += need;
    if (computer >= 0) left(cpu, computer) -= need;
  }
  placed_[unit] = computer;
}

TimeSum Times::weigh(const Shift& shift) {
  find_touched(shift);
  TimeSum change;
  if (touched_.empty()) return change;
  before_.clear();
  for (const int cpu : limits_.cpus) {
    for (const int h : {shift.a, shift.b}) before_.push_back(h < 0 ? 0.0 : left(cpu, h));
  }
  move(shift);
  for (const std::int32_t i : touched_) {
    change.add(sum_of(limits_, i, seconds(p_, i, placed_, left_)), 1);
    change.add(sum_of(limits_, i, seconds_[i]), -1);
  }
  for (const std::int32_t unit : shift.out) placed_[unit] = shift.a;
  for (const std::int32_t unit : shift.back) placed_[unit] = shift.b;
  std::size_t next = 0;
  for (const int cpu : limits_.cpus) {
    for (const int h : {shift.a, shift.b}) {
      if (h >= 0) left(cpu, h) = before_[next];
      ++next;
    }
  }
  return change;
}

const TimeSum& Times::apply(const Shift& shift) {
  find_touched(shift);
  for (const auto* units : {&shift.out, &shift.back}) {
    for (const std::int32_t unit : *units) {
      if (limits_.sharing.of(unit).size() == 0) continue;
      auto& there = on_[placed_[unit]];
      there.erase(std::find(there.begin(), there.end(), unit));
      on_[units == &shift.out ? shift.b : shift.a].push_back(unit);
    }
  }
  move(shift);
  for (const std::int32_t i : touched_) seconds_[i] = seconds(p_, i, placed_, left_);
  // Anew, as a sum of many steps up and down would not be exact.
  sum_ = {};
  for (int i = 0; i < limits_.size(); ++i) sum_.add(sum_of(limits_, i, seconds_[i]), 1);
  assert(exact());
  return sum_;
}

TimeSum Times::weigh(std::int32_t unit, int computer) {
  return weigh({{&unit, &unit + 1}, {nullptr, nullptr}, -1, computer});
}

const TimeSum& Times::put(std::int32_t unit, int computer) {
  find_touched({{&unit, &unit + 1}, {nullptr, nullptr}, -1, computer});
  undo_.push_back({unit, computer, sum_, old_seconds_.size()});
  for (const std::int32_t i : touched_) old_seconds_.push_back({i, seconds_[i]});
  for (const int cpu : limits_.cpus) old_left_.push_back(left(cpu, computer));
  if (limits_.sharing.of(unit).size() > 0) on_[computer].push_back(unit);
  place(unit, computer);
  for (const std::int32_t i : touched_) {
    sum_.add(sum_of(limits_, i, seconds_[i]), -1);
    seconds_[i] = seconds(p_, i, placed_, left_);
    sum_.add(sum_of(limits_, i, seconds_[i]), 1);
  }
  assert(exact());
  return sum_;
}

const TimeSum& Times::take_back() {
  const Undo last = undo_.back();
  undo_.pop_back();
  placed_[last.unit] = -1;
  if (limits_.sharing.of(last.unit).size() > 0) on_[last.computer].pop_back();
  for (std::size_t i = limits_.cpus.size(); i-- > 0;) {
    left(limits_.cpus[i], last.computer) = old_left_.back();
    old_left_.pop_back();
  }
  while (old_seconds_.size() > last.limits) {
    const auto& [i, seconds] = old_seconds_.back();
    seconds_[i] = seconds;
    old_seconds_.pop_back();
  }
  sum_ = last.sum;
  return sum_;
}

}  // namespace poise
