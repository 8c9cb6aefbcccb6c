#include "cpu_share.h"

#include <ctime>

namespace poise {

static std::int64_t read_clock(clockid_t clock) {
  timespec now{};
  clock_gettime(clock, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

std::int64_t wall_now() { return read_clock(CLOCK_MONOTONIC); }

std::int64_t cpu_now() { return read_clock(CLOCK_THREAD_CPUTIME_ID); }

void CpuShare::add_measured(std::int64_t began, std::int64_t wall, std::int64_t cpu) {
  last_ = began;
  last_wall_ = wall;
  wall_.add(wall);
  measured_wall_.add(wall);
  measured_cpu_.add(cpu);
}

double CpuShare::seconds() const {
  const double measured = 1e-9 * static_cast<double>(measured_cpu_.get());
  const auto measured_wall = static_cast<double>(measured_wall_.get());
  if (measured_wall == 0.0) return measured;
  return measured * static_cast<double>(wall_.get()) / measured_wall;
}

}  // namespace poise
