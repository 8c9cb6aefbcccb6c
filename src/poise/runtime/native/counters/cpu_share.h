// The CPU time that calls took, without reading the CPU clock for every call.
#pragma once

#include <cstdint>

#include "../shared_number.h"

namespace poise {

std::int64_t wall_now();  // [ns]
std::int64_t cpu_now();   // of this thread [ns]

// Reading a thread's CPU clock is a system call of 0.2 to 0.6 us, as long as a whole
// call. A call is measured unless the last measured one began less than `spacing`
// before; so whatever takes longer is measured exactly. What lies between, bursts of
// short calls, is taken to use CPU in the same ratio to wall time as the measured ones.
class CpuShare {
 public:
  static constexpr std::int64_t spacing = 10'000;  // [ns]
  static constexpr std::int64_t served_spacing = 1'000'000;  // [ns]
  static constexpr std::int64_t long_call = 50'000;          // [ns]

  bool should_measure(std::int64_t now) const { return now - last_ >= spacing; }

  // Of a call from another container, where few come sooner than 50 us after each other: one
  // in a while is measured, and each that follows one which took long.
  bool should_measure_served(std::int64_t now) const {
    return now - last_ >= served_spacing || last_wall_ >= long_call;
  }

  void add(std::int64_t wall) { wall_.add(wall); }

  void add_measured(std::int64_t began, std::int64_t wall, std::int64_t cpu);

  double seconds() const;

 private:
  Shared<std::int64_t> wall_;
  Shared<std::int64_t> measured_wall_;
  Shared<std::int64_t> measured_cpu_;
  std::int64_t last_ = -served_spacing;
  std::int64_t last_wall_ = 0;
};

}  // namespace poise
