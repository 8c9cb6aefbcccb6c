// How long things may take from end to end, by where their parts run.
#pragma once

#include "lists.h"

namespace poise {

// A limit is about its runs, and about its hops where their ends are apart: see
// `TimeLimit` in ../problem/items.py.
struct TimeLimits {
  struct Run {
    std::int32_t unit, component;
    double seconds;    // at speed 1
    double least = 0;  // on the fastest computer where it may be
    double own = 0;    // what its component asks of the CPU
  };
  struct Hop {
    std::int32_t a, b;
    double seconds, crossings, size;
  };
  struct Limit {
    double limit, price, fixed;  // price 0: it must be kept
    int cpu;                     // the resource that its runs share, or -1
    std::vector<Run> runs;
    std::vector<Hop> hops;
  };
  // How runs wait for one of a computer's cores while others use a share u of them:
  // u^power / (cores (1 - u)), from `kBusiest` on its tangent.
  struct Queue {
    double cores;
    int power;
    double top, slope;  // of the tangent
  };
  static constexpr double kBusiest = 0.9;

  std::vector<Limit> limits;
  std::vector<double> speed;     // (m)
  std::vector<Queue> queues;     // (m)
  std::vector<double> latency;   // (m, m), or empty: 0
  std::vector<double> per_byte;  // (m, m), or empty: 0
  std::vector<int> cpus;         // the resources that runs of any limit share
  Lists<std::int32_t> of_unit;   // unit -> the limits that it has a part in
  Lists<std::int32_t> sharing;   // unit -> those of them where its runs share

  int size() const { return static_cast<int>(limits.size()); }

  // How many times as long a run takes on a computer where others use a share of the CPU.
  double slowdown(int computer, double use) const;
  // What F grows by when what limit i is about takes so long.
  double cost(int i, double seconds) const {
    const Limit& each = limits[i];
    return seconds > each.limit ? each.price * (seconds / each.limit - 1) : 0.0;
  }
  // Whether limit i must be kept, and is not.
  bool breaks(int i, double seconds) const;
  // Whether computers a and b are alike for all that is here.
  bool alike(int a, int b) const;

  // Set how many cores each computer has, and the power of its queue.
  void set_queues(const std::vector<int>& cores, const std::vector<int>& powers);
  // Take over what components ask for, (components, r).
  void set_own(const std::vector<double>& demand, int r);
  // Bring `cpus` and the lists of n units up to date with the limits.
  void list_units(int n);
  // The limits of a problem whose units are parts of this one's, unit -> part.
  TimeLimits joined(const std::vector<std::int32_t>& part) const;
};

}  // namespace poise
