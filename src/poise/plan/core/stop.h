// When a solver must stop, by clock, by count, or because the user says so; and its answer.
#pragma once

#include <time.h>

#include <chrono>
#include <cstdint>
#include <functional>

#include "problem.h"

namespace poise {

enum class Reason { kDone, kProven, kBudget, kInterrupted, kInfeasible };

// Counts steps (search moves tried, nodes opened) against a limit, and looks at the clock
// and at the user every now and then. With an infinite time it is deterministic. Time is
// that of the thread on a CPU; on a busy machine it takes at most `kBusy` times as long.
class Stop {
  using Clock = std::chrono::steady_clock;

 public:
  Stop(double seconds, std::int64_t steps, std::function<bool()> interrupted)
      : seconds_(seconds), limit_(steps), interrupted_(std::move(interrupted)) {}

  // Add `steps`; true when it is time to stop. Cheap: looks at the clock only when
  // about 2,000 steps have gone by.
  bool after(std::int64_t steps) {
    steps_ += steps;
    if (steps_ < next_look_) return stopped_;
    return look();
  }

  bool look() {
    next_look_ = steps_ + kStepsPerLook < limit_ ? steps_ + kStepsPerLook : limit_;
    if (stopped_) return true;
    if (steps_ >= limit_ || elapsed() >= seconds_) stop(Reason::kBudget);
    // Asking the interpreter takes its lock; often enough for a person is enough.
    if (!stopped_ && interrupted_ && elapsed() >= next_ask_) {
      next_ask_ = elapsed() + kSecondsPerAsk;
      if (interrupted_()) stop(Reason::kInterrupted);
    }
    return stopped_;
  }

  bool stopped() const { return stopped_; }
  Reason reason() const { return reason_; }
  std::int64_t steps() const { return steps_; }
  double elapsed() const {
    const double waited = std::chrono::duration<double>(Clock::now() - start_).count() / kBusy;
    const double worked = cpu_time() - cpu_start_;
    return worked > waited ? worked : waited;
  }

  // How many of the coming steps fit, at the pace so far; for choosing a chain's length.
  std::int64_t steps_left() const {
    std::int64_t left = limit_ - steps_;
    if (seconds_ < 1e9 && steps_ > 0) {
      const double pace = static_cast<double>(steps_) / (elapsed() + 1e-9);
      const double by_clock = pace * (seconds_ - elapsed());
      if (by_clock < static_cast<double>(left)) left = static_cast<std::int64_t>(by_clock);
    }
    return left > 0 ? left : 0;
  }

 private:
  static constexpr std::int64_t kStepsPerLook = 2048;
  static constexpr double kSecondsPerAsk = 0.01;
  static constexpr double kBusy = 4.0;

  static double cpu_time() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }

  void stop(Reason reason) {
    stopped_ = true;
    reason_ = reason;
  }

  Clock::time_point start_ = Clock::now();
  double cpu_start_ = cpu_time();
  double seconds_;
  std::int64_t limit_;
  std::function<bool()> interrupted_;
  std::int64_t steps_ = 0;
  std::int64_t next_look_ = 256;
  double next_ask_ = 0.005;
  bool stopped_ = false;
  Reason reason_ = Reason::kBudget;
};

// What a solver hands back.
struct Outcome {
  Placement placed;              // empty: none found
  double bound = -kInfinity;     // no placement has a lower F
  bool proven = false;           // nothing is better; nothing exists when none was found
  Reason reason = Reason::kDone;
  std::int64_t steps = 0;
};

}  // namespace poise
