#include "timers.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace poise::simulation {

double Timer::begin(double now) {
  const auto last = std::max(next_, static_cast<std::int64_t>((now - start_) / period_));
  if (deadline_) missed_ += last - next_;
  next_ = last + 1;
  const double release = start_ + static_cast<double>(last) * period_;
  lateness_.add(now - release);
  return release;
}

void Timer::end(double release, double began, double now) {
  duration_.add(now - began);
  if (deadline_ && now - release > *deadline_) ++missed_;
}

std::int64_t Timer::missed(double now) const {
  return deadline_ ? missed_ + passed(now) - (next_ - 1) : missed_;
}

std::int64_t Timer::passed(double now) const {
  return std::max(next_ - 1, static_cast<std::int64_t>((now - start_) / period_) - 1);
}

void Timer::restart(double start, double stopped) {
  missed_ = missed(stopped);
  earlier_ = releases(stopped);
  start_ = start;
  next_ = 1;
}

void Timers::start(double now, double elapsed) {
  const double stopped = until(now);
  stopped_.reset();
  for (Timer& timer : timers_) {
    const auto first = first_.find(timer.name());
    const double period = timer.period();
    const double passed = elapsed - std::floor(elapsed / period) * period;
    const double due = first == first_.end() ? now + period - passed : first->second;
    const double start = due - period;
    if (has_started_)
      timer.restart(start, stopped);
    else
      timer.start_ = start;
  }
  has_started_ = true;
}

double Timers::next_due() {
  double first = std::numeric_limits<double>::infinity();
  for (const Timer& timer : all()) first = std::min(first, timer.due());
  return first;
}

std::int64_t Timers::missed(double now) {
  std::int64_t sum = 0;
  for (const Timer& timer : all()) sum += timer.missed(until(now));
  return sum;
}

}  // namespace poise::simulation
