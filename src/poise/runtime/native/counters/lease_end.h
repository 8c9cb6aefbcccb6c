// Until when the leased components of a container may act: its agent writes it, the container
// reads it before each handler, publication and call. It starts in the past.
#pragma once

#include <cmath>
#include <ctime>

#include "stats_page.h"

namespace poise {

class LeaseEnd {
 public:
  // `descriptor` is that of the container's stats page.
  explicit LeaseEnd(int descriptor) : memory_(descriptor, true) {}

  double at() const { return memory_.lease_end(); }  // [s, CLOCK_BOOTTIME]
  void set(double at) { memory_.set_lease_end(at); }

  // CLOCK_BOOTTIME goes on while the computer is suspended.
  bool is_past() const {
    const double at = memory_.lease_end();
    if (std::isinf(at)) return at < 0.0;
    timespec now{};
    clock_gettime(CLOCK_BOOTTIME, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec) >= at;
  }

 private:
  StatsMemory memory_;
};

}  // namespace poise
