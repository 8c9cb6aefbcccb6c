// How long things take on a placement that changes, kept up to date.
#pragma once

#include "problem.h"

namespace poise {

// Units that change their computer: `out` leaves `a` for `b`, `back` leaves `b` for `a`.
// -1 stands for no computer.
struct Shift {
  Span<std::int32_t> out, back;
  int a, b;
};

// What time limits come to, or what a shift changes of that.
struct TimeSum {
  double paid = 0;    // what F grows by
  double excess = 0;  // how far those are broken that must be kept, in logarithms
  int broken = 0;     // how many of these are broken

  void add(const TimeSum& other, int sign);
};

// How long what time limit i is about takes, with residues `left` (r, m); at least, while
// units have no computer: their hops take nothing, and their runs what they take on the
// fastest computer where they may be.
double seconds(const Problem& problem, int i, const Placement& placed,
               const std::vector<double>& left);

// What all limits come to, from nothing.
TimeSum time_sum(const Problem& problem, const Placement& placed,
                 const std::vector<double>& left);

// The problem must have time limits.
class Times {
 public:
  explicit Times(const Problem& problem);

  // Take a placement of all units, or of some.
  const TimeSum& reset(const Placement& placed);
  const TimeSum& sum() const { return sum_; }

  TimeSum weigh(const Shift& shift);
  const TimeSum& apply(const Shift& shift);

  // The same for a unit that has no computer; `take_back` undoes the last `put`, exactly.
  TimeSum weigh(std::int32_t unit, int computer);
  const TimeSum& put(std::int32_t unit, int computer);
  const TimeSum& take_back();

 private:
  bool exact() const;
  void find_touched(const Shift& shift);
  void move(const Shift& shift);
  void place(std::int32_t unit, int computer);
  double& left(int cpu, int computer) {
    return left_[static_cast<std::size_t>(cpu) * p_.m + computer];
  }

  struct Undo {
    std::int32_t unit;
    int computer;
    TimeSum sum;
    std::size_t limits;  // how many had been saved
  };

  const Problem& p_;
  const TimeLimits& limits_;
  Placement placed_;
  std::vector<double> left_;               // (r, m), up to date where runs share it
  std::vector<double> seconds_;            // by limit
  std::vector<std::vector<std::int32_t>> on_;  // computer -> its units whose runs share
  TimeSum sum_;
  std::vector<std::int32_t> touched_;      // limits that a shift changes
  std::vector<std::uint64_t> seen_;        // limit -> the last shift that touched it
  std::uint64_t shift_ = 0;
  std::vector<double> before_;             // what was left where a shift changes it
  std::vector<Undo> undo_;
  std::vector<std::pair<std::int32_t, double>> old_seconds_;  // of all in `undo_`
  std::vector<double> old_left_;                              // likewise, by `cpus`
};

}  // namespace poise
