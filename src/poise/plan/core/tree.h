// Branch and bound: the proven optimum, where that is quick.
#pragma once

#include <memory>

#include "stop.h"

namespace poise {

// Depth-first over the units, connected ones one after the other. A partial placement is
// given up when a bound of what it comes to is no better than the best placement known.
// What every tree keeps is the order of the units and the best placement so far. Prepared
// once, it may run many times.
class Tree {
 public:
  static constexpr int kMostUnits = 1024, kMostComputers = 64;
  static bool takes(const Problem& problem) {
    return problem.n <= kMostUnits && problem.m <= kMostComputers;
  }
  // The quickest tree for a problem.
  static std::unique_ptr<Tree> of(const Problem& problem);

  virtual ~Tree() = default;

  // `known` may be empty; else it must be feasible.
  Outcome run(const Placement& known, Stop& stop);

 protected:
  explicit Tree(const Problem& problem);

  // Go through the tree from its root; where `stop_` says so, leave it with the least
  // bound of what was not looked at in `open_bound_`.
  virtual void descend() = 0;

  void found();
  void set_best(double objective);

  const Problem& p_;
  Stop* stop_ = nullptr;
  int n_, m_, r_;
  std::vector<std::int32_t> order_;  // depth -> unit
  std::vector<std::int32_t> at_;     // (n) by depth: its computer
  bool possible_ = true;             // every unit may run somewhere
  double best_ = kInfinity, threshold_ = kInfinity, open_bound_ = kInfinity;
  Placement best_placed_;
};

}  // namespace poise
