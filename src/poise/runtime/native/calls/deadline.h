// The deadline of the call that a thread runs.
//
// A call's limit covers everything done in it: a call made within it has what is left, and the
// frame of a call says how long its caller still waits.
#pragma once

#include <algorithm>
#include <cstdint>

#include "chain.h"
#include "counters/cpu_share.h"

namespace poise {

using Moment = std::int64_t;  // as `wall_now` [ns]

// Nobody waits: the thread runs a timer or a message.
constexpr Moment never = INT64_MAX;

POISE_NEAR_THREAD_LOCAL Moment thread_deadline;

// What a call may take that begins now, with a limit of its own [s].
inline double time_left(double limit, Moment now) {
  if (thread_deadline == never) return limit;
  return std::min(limit, 1e-9 * static_cast<double>(thread_deadline - now));
}

// The moment `limit` [s] after `now`.
inline Moment moment_after(Moment now, double limit) {
  constexpr double longest = 1e9;  // [s]; no number of nanoseconds overflows
  return limit < longest ? now + static_cast<Moment>(1e9 * limit) : never;
}

// Sets the deadline of this thread, while it lives; an earlier one stays.
class Deadline {
 public:
  explicit Deadline(Moment until) : before_(thread_deadline) {
    thread_deadline = std::min(before_, until);
  }
  ~Deadline() { thread_deadline = before_; }
  Deadline(const Deadline&) = delete;
  Deadline& operator=(const Deadline&) = delete;

 private:
  Moment before_;
};

}  // namespace poise
