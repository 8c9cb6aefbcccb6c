// Until when somebody waits for what a thread does: the deadline of the call that it runs.
//
// A call's limit holds for all that is done in it. So a call that is made in another one has
// what is left of that, and the frame of a call says how long its caller waits.
#pragma once

#include <algorithm>
#include <cstdint>

#include "cpu_share.h"

namespace poise {

using Moment = std::int64_t;  // as `wall_now` [ns]

// Nobody waits: the thread runs a timer or a message.
constexpr Moment never = INT64_MAX;

extern thread_local Moment thread_deadline;

// What a call may take that begins now, with a limit of its own [s].
inline double time_left(double limit, Moment now) {
  if (thread_deadline == never) return limit;
  return std::min(limit, 1e-9 * static_cast<double>(thread_deadline - now));
}

// Lets somebody wait for what this thread does for `limit` [s] at most, while it lives.
class Deadline {
 public:
  Deadline(Moment now, double limit) : before_(thread_deadline) {
    constexpr double longest = 1e9;  // [s]; no number of nanoseconds overflows
    if (limit < longest)
      thread_deadline = std::min(before_, now + static_cast<Moment>(1e9 * limit));
  }
  ~Deadline() { thread_deadline = before_; }
  Deadline(const Deadline&) = delete;
  Deadline& operator=(const Deadline&) = delete;

 private:
  Moment before_;
};

}  // namespace poise
