// When a timer is due, and whether it kept its deadline, as poise.runtime.execution.timers
// has it. tests/simulation/native/test_timers.py compares both.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "histogram.h"

namespace poise::simulation {

// A timer that is due at start + k * period for k = 1, 2, ...; all times in [s].
class Timer {
 public:
  Timer(std::string name, double period, std::optional<double> deadline)
      : name_(std::move(name)), period_(period), deadline_(deadline) {}

  const std::string& name() const { return name_; }
  double period() const { return period_; }
  const std::optional<double>& deadline() const { return deadline_; }
  const Histogram& lateness() const { return lateness_; }
  const Histogram& duration() const { return duration_; }

  // The next release.
  double due() const { return start_ + static_cast<double>(next_) * period_; }
  // Take the last release that is due at `now` and return it. Earlier ones that never
  // began are skipped, and missed.
  double begin(double now);
  // Count the run of `release` that lasted from `began` to `now`.
  void end(double release, double began, double now);
  // How many missed the deadline until `now`.
  std::int64_t missed(double now) const;
  // How often it was due until `now`.
  std::int64_t releases(double now) const { return earlier_ + passed(now); }

 private:
  friend class Timers;
  void restart(double start, double stopped);
  // How many have begun, or should have by `now`.
  std::int64_t passed(double now) const;

  std::string name_;
  double period_;
  std::optional<double> deadline_;
  double start_ = 0.0;
  std::int64_t next_ = 1, earlier_ = 0, missed_ = 0;
  Histogram lateness_, duration_;
};

// All timers of a component, in the order of their declaration.
class Timers {
 public:
  void declare(std::string name, double period, std::optional<double> deadline) {
    timers_.emplace_back(std::move(name), period, deadline);
  }

  // Those that were started; none before.
  std::vector<Timer>& all() { return has_started_ ? timers_ : nothing_; }

  // Let timers be due first at these moments: a move keeps their phases.
  void begin_at(std::map<std::string, double> first) { first_ = std::move(first); }
  // Start or go on at `now`; `elapsed` ago was a moment at which all are due.
  void start(double now, double elapsed);
  // Count no release after `now`.
  void stop(double now) { stopped_ = now; }
  // When a timer is due next; infinite: none is.
  double next_due();
  std::int64_t missed(double now);
  // The moment until which releases count at `now`.
  double until(double now) const { return stopped_.value_or(now); }

 private:
  std::vector<Timer> timers_, nothing_;
  bool has_started_ = false;
  std::optional<double> stopped_;
  std::map<std::string, double> first_;
};

}  // namespace poise::simulation
